//! Fused kernels on the instruction set that was detected.
//!
//! A candidate is computed as one unit, by one thread, in one fixed order of operations, so its bytes depend on the [`Kernel`] and on
//! nothing else. Training's forward and backward passes run on the same kernels.

mod ball;
mod convolution;
mod linear;
pub(crate) mod packed;
mod pair_mlp;
mod pair_mlp_backward;
mod tile;

use repose_simd::{InstructionSet, SimdLevel};

pub use packed::PackedLinear;
pub use pair_mlp::PairMlp;
pub use pair_mlp_backward::{PairMlpGradients, RawLayers};

pub(crate) use ball::PointColumns;

/// The kernels of one instruction set of this machine. Results of different kernels differ in their last bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Kernel(InstructionSet);

impl Kernel {
    /// The fastest kernel of this machine.
    pub fn detect() -> Self {
        Self(InstructionSet::detect())
    }

    /// All kernels of this machine, fastest first.
    pub fn available() -> Vec<Self> {
        InstructionSet::available().into_iter().map(Self).collect()
    }

    /// The name that travels with results. Its number rises when an algorithm's order of operations changes.
    pub fn id(self) -> &'static str {
        match self.0.family() {
            SimdLevel::Avx512 => "avx512-1",
            SimdLevel::Avx2 => "avx2-1",
            SimdLevel::Plain => "plain-1",
        }
    }

    /// `count` rows `[count, inputs]` through a layer (and ReLU) into `out` `[count, padded outputs]`.
    pub(crate) fn linear(self, layer: &PackedLinear, rows: &[f32], count: usize, relu: bool, out: &mut [f32]) {
        self.0.run(linear::LinearPass { layer, rows, count, relu, out });
    }

    /// A row of `count` pixels `[count, padded outputs]` of a 3 × 3 convolution (and ReLU).
    ///
    /// `rows` are the three input rows around it, `[3, row / channels, channels]` with a rim of one pixel; `layer` reads
    /// `[3 rows, 3 columns, channels]`.
    #[allow(clippy::too_many_arguments, reason = "a convolution's shape, named one by one")]
    pub(crate) fn convolution(
        self,
        layer: &PackedLinear,
        rows: &[f32],
        row: usize,
        channels: usize,
        stride: usize,
        count: usize,
        relu: bool,
        out: &mut [f32],
    ) {
        self.0.run(convolution::Convolution { layer, rows, row, channels, stride, count, relu, out });
    }

    /// Gather, MLP and max ([`PairMlp`]) into `out` `[centroids, padded outputs]`.
    pub(crate) fn pair_mlp(self, op: &PairMlp<'_>, out: &mut [f32], scratch: &mut Vec<f32>) {
        self.0.run(pair_mlp::Forward::<false> { op, out, winners: &mut [], scratch });
    }

    /// The same, and which neighbour each maximum came from, for the backward pass.
    pub(crate) fn pair_mlp_with_winners(self, op: &PairMlp<'_>, out: &mut [f32], winners: &mut [u16], scratch: &mut Vec<f32>) {
        self.0.run(pair_mlp::Forward::<true> { op, out, winners, scratch });
    }

    /// The gradient of [`Kernel::pair_mlp_with_winners`].
    pub(crate) fn pair_mlp_backward(self, op: &PairMlp<'_>, raw: &RawLayers<'_>, winners: &[u16], grad_out: &[f32]) -> PairMlpGradients {
        self.0.run(pair_mlp_backward::Backward { op, raw, winners, grad_out })
    }

    /// Appends to `found` the indices of up to `most` points within `radius` of `center`, lowest first.
    pub(crate) fn within(self, points: &PointColumns, center: [f32; 3], radius: f32, most: usize, found: &mut Vec<u32>) {
        self.0.run(ball::Within { points, center, radius, most, found });
    }
}
