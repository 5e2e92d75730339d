//! Rows through a linear layer, optionally through ReLU.

use repose_simd::{Lanes, Work};

use super::{
    packed::PackedLinear,
    tile::{ROWS, TileInputs, outputs, product},
};

/// [`super::Kernel::linear`].
pub(super) struct LinearPass<'a> {
    pub layer: &'a PackedLinear,
    pub rows: &'a [f32],
    pub count: usize,
    pub relu: bool,
    pub out: &'a mut [f32],
}

impl Work for LinearPass<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<S: Lanes>(self) {
        // SAFETY: the instruction set is present by this function's contract.
        unsafe { linear::<S>(self.layer, self.rows, self.count, self.relu, self.out) }
    }
}

/// `out[r, ..] = (relu)(W rows[r, ..] + b)` for `count` rows; `out` has rows of `layer.padded()` floats.
///
/// # Safety
/// The instruction set must be present. Lengths are asserted.
#[inline(always)]
pub(super) unsafe fn linear<S: Lanes>(layer: &PackedLinear, rows: &[f32], count: usize, relu: bool, out: &mut [f32]) {
    assert!(rows.len() >= count * layer.inputs());
    // SAFETY: there are `count` rows of the layer's inputs.
    unsafe { outputs::<S, ROWS>(&Rows { rows, inputs: layer.inputs() }, layer, count, relu, out) }
}

/// Rows of `inputs` floats.
struct Rows<'a> {
    rows: &'a [f32],
    inputs: usize,
}

impl TileInputs for Rows<'_> {
    #[inline(always)]
    unsafe fn product<S: Lanes, const R: usize, const C: usize>(&self, first: usize, panel: *const f32, width: usize) -> [[S::V; C]; R] {
        // SAFETY: the same contract.
        unsafe { product::<S, R, C>(self.rows.as_ptr().add(first * self.inputs), self.inputs, self.inputs, panel, width) }
    }
}
