//! Fused forward kernels with the instruction set chosen at run time.
//!
//! A candidate is computed as one unit, by one thread, in one fixed order of operations, so its bytes depend on the [`Kernel`] and on
//! nothing else. Training's forward and backward passes run on the same kernels.

mod linear;
pub(crate) mod packed;
mod pair_mlp;
mod pair_mlp_backward;
mod simd;
mod tile;

pub use packed::PackedLinear;
pub use pair_mlp::PairMlp;
pub use pair_mlp_backward::{PairMlpGradients, RawLayers};

/// Which instruction set the kernels use. Results of different kernels differ in their last bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kernel {
    /// Sixteen floats at once, fused multiply-add.
    Avx512,
    /// Eight floats at once, fused multiply-add.
    Avx2,
    /// What the target has without asking; separate multiply and add.
    Plain,
}

impl Kernel {
    /// The fastest that this machine has.
    pub fn detect() -> Self {
        Self::available()[0]
    }

    /// All that this machine has, fastest first.
    pub fn available() -> Vec<Self> {
        [Self::Avx512, Self::Avx2, Self::Plain].into_iter().filter(|k| k.is_available()).collect()
    }

    /// The name that travels with results. The number rises when an algorithm's order of operations changes.
    pub const fn id(self) -> &'static str {
        match self {
            Self::Avx512 => "avx512-1",
            Self::Avx2 => "avx2-1",
            Self::Plain => "plain-1",
        }
    }

    fn is_available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512dq")
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            Self::Plain => true,
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }

    /// `count` rows `[count, inputs]` through a layer (and ReLU) into `out` `[count, padded outputs]`.
    pub(crate) fn linear(self, layer: &PackedLinear, rows: &[f32], count: usize, relu: bool, out: &mut [f32]) {
        // SAFETY: a `Kernel` value other than `Plain` is only made by `available`, which detected its instruction set.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => linear_avx512(layer, rows, count, relu, out),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => linear_avx2(layer, rows, count, relu, out),
                _ => linear::linear::<simd::Plain, 2>(layer, rows, count, relu, out),
            }
        }
    }

    /// Gather, MLP and max ([`PairMlp`]) into `out` `[centroids, padded outputs]`.
    pub(crate) fn pair_mlp(self, op: &PairMlp<'_>, out: &mut [f32], scratch: &mut Vec<f32>) {
        // SAFETY: as in `linear`.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => pair_avx512::<false>(op, out, &mut [], scratch),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => pair_avx2::<false>(op, out, &mut [], scratch),
                _ => pair_mlp::forward::<simd::Plain, 2, false>(op, out, &mut [], scratch),
            }
        }
    }

    /// The same, and which neighbour each maximum came from, for the backward pass.
    pub(crate) fn pair_mlp_with_winners(self, op: &PairMlp<'_>, out: &mut [f32], winners: &mut [u16], scratch: &mut Vec<f32>) {
        // SAFETY: as in `linear`.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => pair_avx512::<true>(op, out, winners, scratch),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => pair_avx2::<true>(op, out, winners, scratch),
                _ => pair_mlp::forward::<simd::Plain, 2, true>(op, out, winners, scratch),
            }
        }
    }

    /// The gradient of [`Kernel::pair_mlp_with_winners`].
    pub(crate) fn pair_mlp_backward(self, op: &PairMlp<'_>, raw: &RawLayers<'_>, winners: &[u16], grad_out: &[f32]) -> PairMlpGradients {
        // SAFETY: as in `linear`.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => backward_avx512(op, raw, winners, grad_out),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => backward_avx2(op, raw, winners, grad_out),
                _ => pair_mlp_backward::backward::<simd::Plain, 2>(op, raw, winners, grad_out),
            }
        }
    }

    /// Appends to `found` the indices below `points.len()` of up to `most` points within `radius` of `center`, lowest first.
    pub(crate) fn within(self, points: &PointColumns, center: [f32; 3], radius: f32, most: usize, found: &mut Vec<u32>) {
        // SAFETY: as in `linear`.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => within_avx512(points, center, radius, most, found),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => within_avx2(points, center, radius, most, found),
                _ => within(points, center, radius, most, found),
            }
        }
    }
}

/// Coordinates in columns, padded to whole blocks with points that are near nothing.
#[derive(Debug, Clone)]
pub(crate) struct PointColumns {
    columns: [Vec<f32>; 3],
}

/// Points examined at a time.
const BLOCK: usize = 32;

impl PointColumns {
    pub(crate) fn new(points: &[[f32; 3]]) -> Self {
        let padded = points.len().next_multiple_of(BLOCK);
        Self {
            columns: std::array::from_fn(|k| {
                let mut column: Vec<f32> = points.iter().map(|p| p[k]).collect();
                column.resize(padded, f32::INFINITY);
                column
            }),
        }
    }
}

#[inline(always)]
fn within(points: &PointColumns, center: [f32; 3], radius: f32, most: usize, found: &mut Vec<u32>) {
    let limit = radius * radius;
    let enough = found.len() + most;
    let [x, y, z] = &points.columns;
    for (b, ((x, y), z)) in x.chunks_exact(BLOCK).zip(y.chunks_exact(BLOCK)).zip(z.chunks_exact(BLOCK)).enumerate() {
        let mut near = [false; BLOCK];
        for l in 0..BLOCK {
            let (dx, dy, dz) = (x[l] - center[0], y[l] - center[1], z[l] - center[2]);
            near[l] = dx * dx + dy * dy + dz * dz <= limit;
        }
        let mut bits = near.iter().enumerate().fold(0u32, |bits, (l, near)| bits | u32::from(*near) << l);
        while bits != 0 {
            found.push((b * BLOCK) as u32 + bits.trailing_zeros());
            if found.len() == enough {
                return;
            }
            bits &= bits - 1;
        }
    }
}

/// The same functions, compiled for each instruction set.
#[cfg(target_arch = "x86_64")]
mod entry {
    use super::{simd::*, *};

    macro_rules! entry_points {
        ($features:literal, $simd:ty, $vectors:literal, $linear:ident, $pair:ident, $backward:ident, $within:ident) => {
            #[target_feature(enable = $features)]
            pub(super) fn $linear(layer: &PackedLinear, rows: &[f32], count: usize, relu: bool, out: &mut [f32]) {
                // SAFETY: this function is only entered where its features are.
                unsafe { linear::linear::<$simd, $vectors>(layer, rows, count, relu, out) }
            }
            #[target_feature(enable = $features)]
            pub(super) fn $pair<const WINNERS: bool>(op: &PairMlp<'_>, out: &mut [f32], winners: &mut [u16], scratch: &mut Vec<f32>) {
                // SAFETY: this function is only entered where its features are.
                unsafe { pair_mlp::forward::<$simd, $vectors, WINNERS>(op, out, winners, scratch) }
            }
            #[target_feature(enable = $features)]
            pub(super) fn $backward(op: &PairMlp<'_>, raw: &RawLayers<'_>, winners: &[u16], grad_out: &[f32]) -> PairMlpGradients {
                // SAFETY: this function is only entered where its features are.
                unsafe { pair_mlp_backward::backward::<$simd, $vectors>(op, raw, winners, grad_out) }
            }
            #[target_feature(enable = $features)]
            pub(super) fn $within(points: &PointColumns, center: [f32; 3], radius: f32, most: usize, found: &mut Vec<u32>) {
                within(points, center, radius, most, found);
            }
        };
    }

    entry_points!("avx512f,avx512bw,avx512vl,avx512dq,avx2,fma", Avx512, 4, linear_avx512, pair_avx512, backward_avx512, within_avx512);
    entry_points!("avx2,fma", Avx2, 2, linear_avx2, pair_avx2, backward_avx2, within_avx2);
}
#[cfg(target_arch = "x86_64")]
use entry::*;
