//! The register tile that all products are made of: `R` rows times `C` vectors of outputs, summed over the inputs in order.
//!
//! Every output element is one chain of fused multiply-adds over its inputs, first to last, whatever tile it falls in; that is why a
//! row's bytes do not depend on how many rows there are.

use repose_simd::Lanes;

use super::packed::PackedLinear;

/// Rows of the main tile. Its sums fill three quarters of the registers: 6 rows of [`vectors_at_once`] vectors.
pub(super) const ROWS: usize = 6;

/// The inputs of a layer, tile by tile: for each output, those that a tile multiplies with the layer's weights.
pub(super) trait TileInputs {
    /// Sums of the inputs of `R` outputs from the `first` on, times `C` vectors of columns of `panel`, whose rows are `width` floats apart.
    ///
    /// # Safety
    /// The instruction set must be present, the outputs among those that the inputs are for, and the panel that of a layer for such inputs.
    unsafe fn product<S: Lanes, const R: usize, const C: usize>(&self, first: usize, panel: *const f32, width: usize) -> [[S::V; C]; R];
}

/// `out[i, ..] = (relu)(sums of input i + bias)` for `count` inputs, `R` at once where so many are left; `out` has rows of
/// `layer.padded()` floats.
///
/// # Safety
/// The instruction set must be present; `inputs` must be for `count` outputs of such a layer. The length of `out` is asserted.
#[inline(always)]
pub(super) unsafe fn outputs<S: Lanes, const R: usize>(
    inputs: &impl TileInputs,
    layer: &PackedLinear,
    count: usize,
    relu: bool,
    out: &mut [f32],
) {
    assert!(out.len() >= count * layer.padded());
    for (start, width, panel) in layer.panels() {
        let mut column = 0;
        while column < width {
            let vectors = ((width - column) / S::COUNT).min(vectors_at_once::<S>());
            let bias = &layer.bias()[start + column..];
            let columns = Columns { inputs, panel: &panel[column..], width, bias, padded: layer.padded(), relu };
            let out = &mut out[start + column..];
            // SAFETY: the slices cover `count` rows by the assertion above and `vectors` whole vectors of the panel.
            unsafe {
                match vectors {
                    4.. => columns.all::<S, R, 4>(count, out),
                    3 => columns.all::<S, R, 3>(count, out),
                    2 => columns.all::<S, R, 2>(count, out),
                    _ => columns.all::<S, R, 1>(count, out),
                }
            }
            column += vectors.clamp(1, 4) * S::COUNT;
        }
    }
}

/// Columns of a layer's panel, and what goes through them.
struct Columns<'a, I> {
    inputs: &'a I,
    panel: &'a [f32],
    width: usize,
    bias: &'a [f32],
    padded: usize,
    relu: bool,
}

impl<I: TileInputs> Columns<'_, I> {
    #[inline(always)]
    unsafe fn all<S: Lanes, const R: usize, const C: usize>(&self, count: usize, out: &mut [f32]) {
        let mut first = 0;
        // SAFETY: `outputs` chose `C` and `count` so that every tile lies in the slices.
        unsafe {
            while first + R <= count {
                self.tile::<S, R, C>(first, out);
                first += R;
            }
            while first < count {
                self.tile::<S, 1, C>(first, out);
                first += 1;
            }
        }
    }

    #[inline(always)]
    unsafe fn tile<S: Lanes, const R: usize, const C: usize>(&self, first: usize, out: &mut [f32]) {
        // SAFETY: as in `all`.
        unsafe {
            let sums = self.inputs.product::<S, R, C>(first, self.panel.as_ptr(), self.width);
            for (r, sums) in sums.iter().enumerate() {
                for (c, sum) in sums.iter().enumerate() {
                    let y = S::add(*sum, S::load(self.bias.as_ptr().add(c * S::COUNT)));
                    let y = if self.relu { S::max(y, S::splat(0.0)) } else { y };
                    S::store(out.as_mut_ptr().add((first + r) * self.padded + c * S::COUNT), y);
                }
            }
        }
    }
}

/// Vectors of outputs that a tile computes at once: four of AVX-512's 32 registers a row, two of the 16 that the others have.
#[inline(always)]
pub(super) const fn vectors_at_once<S: Lanes>() -> usize {
    if S::REGISTERS >= 32 { 4 } else { 2 }
}

/// `acc[r][c] = Σ_k rows[r, k] · panel[k, c]` (starting from 0).
///
/// # Safety
/// The instruction set must be present; `rows` readable for `R` rows of `inputs` floats at `stride`; `panel` for `inputs` rows of `width`
/// floats, of which `C` vectors are read.
#[inline(always)]
pub(super) unsafe fn product<S: Lanes, const R: usize, const C: usize>(
    rows: *const f32,
    stride: usize,
    inputs: usize,
    panel: *const f32,
    width: usize,
) -> [[S::V; C]; R] {
    // SAFETY: the same contract.
    unsafe { extended::<S, R, C>([[S::splat(0.0); C]; R], rows, stride, inputs, panel, width) }
}

/// [`product`], starting from `acc`.
///
/// # Safety
/// As [`product`].
#[inline(always)]
pub(super) unsafe fn extended<S: Lanes, const R: usize, const C: usize>(
    mut acc: [[S::V; C]; R],
    rows: *const f32,
    stride: usize,
    inputs: usize,
    panel: *const f32,
    width: usize,
) -> [[S::V; C]; R] {
    // SAFETY: by the function's contract all addresses lie in the two arrays.
    unsafe {
        for k in 0..inputs {
            let mut w = [S::splat(0.0); C];
            for (c, w) in w.iter_mut().enumerate() {
                *w = S::load(panel.add(k * width + c * S::COUNT));
            }
            for (r, acc) in acc.iter_mut().enumerate() {
                let x = S::splat(*rows.add(r * stride + k));
                for (acc, w) in acc.iter_mut().zip(&w) {
                    *acc = S::fma(x, *w, *acc);
                }
            }
        }
        acc
    }
}
