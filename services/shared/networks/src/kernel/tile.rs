//! The register tile that all products are made of: `R` rows times `C` vectors of outputs, summed over the inputs in order.
//!
//! Every output element is one chain of fused multiply-adds over its inputs, first to last, whatever tile it falls in; that is why a
//! row's bytes do not depend on how many rows there are.

use repose_simd::Lanes;

/// Rows of the main tile. Its sums fill three quarters of the registers: 6 rows of [`vectors_at_once`] vectors.
pub(super) const ROWS: usize = 6;

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
