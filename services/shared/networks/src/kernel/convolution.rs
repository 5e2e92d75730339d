//! A 3 × 3 convolution over a picture whose pixels hold their channels side by side.
//!
//! With a rim of zeros around the picture, the three pixels that a row of the kernel covers lie one after another in memory, so that each
//! output is three products of `3 · inputs` numbers in a row: nothing is gathered or copied first.

use repose_simd::{Lanes, Work};

use super::{
    packed::PackedLinear,
    tile::{extended, vectors_at_once},
};

/// Output pixels of the main tile: pictures are 20, 40, 80 and 160 wide most often.
const PIXELS: usize = 5;

/// [`super::Kernel::convolution`].
pub(super) struct Convolution<'a> {
    pub layer: &'a PackedLinear,
    /// Three rows of the rimmed input, each of [`Self::row`] floats, from the one above the output's row on.
    pub rows: &'a [f32],
    /// Floats in a rimmed input row.
    pub row: usize,
    /// Channels of the input.
    pub channels: usize,
    /// Input pixels from one output pixel to the next.
    pub stride: usize,
    /// Output pixels of the row.
    pub count: usize,
    pub relu: bool,
    pub out: &'a mut [f32],
}

impl Work for Convolution<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<S: Lanes>(self) {
        let Self { layer, rows, row, channels, stride, count, relu, out } = self;
        let padded = layer.padded();
        assert_eq!(layer.inputs(), 9 * channels, "a layer for {channels} channels");
        assert!(count == 0 || ((count - 1) * stride + 3) * channels <= row && rows.len() >= 3 * row && out.len() >= count * padded);
        for (start, width, panel) in layer.panels() {
            let mut column = 0;
            while column < width {
                let vectors = ((width - column) / S::COUNT).min(vectors_at_once::<S>());
                let bias = &layer.bias()[start + column..];
                let job = Job { rows, row, channels, stride, panel: &panel[column..], width, bias, padded, relu };
                let out = &mut out[start + column..];
                // SAFETY: the slices cover `count` pixels by the assertion above and `vectors` whole vectors of the panel.
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
}

struct Job<'a> {
    rows: &'a [f32],
    row: usize,
    channels: usize,
    stride: usize,
    panel: &'a [f32],
    width: usize,
    bias: &'a [f32],
    padded: usize,
    relu: bool,
}

impl Job<'_> {
    #[inline(always)]
    unsafe fn run<S: Lanes, const C: usize>(&self, count: usize, out: &mut [f32]) {
        let mut pixel = 0;
        // SAFETY: `Convolution::run` chose `C` and `count` so that every tile lies in the slices.
        unsafe {
            while pixel + PIXELS <= count {
                self.tile::<S, PIXELS, C>(pixel, out);
                pixel += PIXELS;
            }
            while pixel < count {
                self.tile::<S, 1, C>(pixel, out);
                pixel += 1;
            }
        }
    }

    #[inline(always)]
    unsafe fn tile<S: Lanes, const R: usize, const C: usize>(&self, first: usize, out: &mut [f32]) {
        let (step, inputs) = (self.stride * self.channels, 3 * self.channels);
        // SAFETY: as in `run`.
        unsafe {
            let mut acc = [[S::splat(0.0); C]; R];
            for y in 0..3 {
                let row = self.rows.as_ptr().add(y * self.row + first * step);
                acc = extended::<S, R, C>(acc, row, step, inputs, self.panel.as_ptr().add(y * inputs * self.width), self.width);
            }
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
