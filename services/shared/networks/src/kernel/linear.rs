//! Rows through a linear layer, optionally through ReLU.

use repose_simd::{Lanes, Work};

use super::{
    packed::PackedLinear,
    tile::{ROWS, product, vectors_at_once},
};

/// [`super::Kernel::linear`].
pub(super) struct Linear<'a> {
    pub layer: &'a PackedLinear,
    pub rows: &'a [f32],
    pub count: usize,
    pub relu: bool,
    pub out: &'a mut [f32],
}

impl Work for Linear<'_> {
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
    let (inputs, padded) = (layer.inputs(), layer.padded());
    assert!(rows.len() >= count * inputs && out.len() >= count * padded);
    for (start, width, panel) in layer.panels() {
        let mut column = 0;
        while column < width {
            let vectors = ((width - column) / S::COUNT).min(vectors_at_once::<S>());
            let job = Job { rows, inputs, panel: &panel[column..], width, bias: &layer.bias()[start + column..], padded, relu };
            let out = &mut out[start + column..];
            // SAFETY: the job's slices cover `count` rows by the assertion above and `vectors` whole vectors of the panel.
            unsafe {
                match vectors {
                    4.. => job.run::<S, 4>(count, out),
                    3 => job.run::<S, 3>(count, out),
                    2 => job.run::<S, 2>(count, out),
                    _ => job.run::<S, 1>(count, out),
                }
            }
            column += vectors.clamp(1, 4) * S::COUNT;
        }
    }
}

struct Job<'a> {
    rows: &'a [f32],
    inputs: usize,
    panel: &'a [f32],
    width: usize,
    bias: &'a [f32],
    padded: usize,
    relu: bool,
}

impl Job<'_> {
    #[inline(always)]
    unsafe fn run<S: Lanes, const C: usize>(&self, count: usize, out: &mut [f32]) {
        let mut r = 0;
        // SAFETY: `linear` chose `C` and `count` so that every tile lies in the slices.
        unsafe {
            while r + ROWS <= count {
                self.tile::<S, ROWS, C>(r, out);
                r += ROWS;
            }
            while r < count {
                self.tile::<S, 1, C>(r, out);
                r += 1;
            }
        }
    }

    #[inline(always)]
    unsafe fn tile<S: Lanes, const R: usize, const C: usize>(&self, first: usize, out: &mut [f32]) {
        // SAFETY: as in `run`.
        unsafe {
            let acc =
                product::<S, R, C>(self.rows.as_ptr().add(first * self.inputs), self.inputs, self.inputs, self.panel.as_ptr(), self.width);
            for (r, acc) in acc.iter().enumerate() {
                for (c, sum) in acc.iter().enumerate() {
                    let y = S::add(*sum, S::load(self.bias.as_ptr().add(c * S::COUNT)));
                    let y = if self.relu { S::max(y, S::splat(0.0)) } else { y };
                    S::store(out.as_mut_ptr().add((first + r) * self.padded + c * S::COUNT), y);
                }
            }
        }
    }
}
