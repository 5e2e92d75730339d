//! A 3 × 3 convolution over a picture whose pixels hold their channels side by side.
//!
//! With a rim of zeros around the picture, the three pixels that a row of the kernel covers lie one after another in memory, so that each
//! output is three products of `3 · inputs` numbers in a row: nothing is gathered or copied first.

use repose_simd::{Lanes, Work};

use super::{
    packed::PackedLinear,
    tile::{TileInputs, extended, outputs},
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
        assert_eq!(layer.inputs(), 9 * channels, "a layer for {channels} channels");
        assert!(count == 0 || ((count - 1) * stride + 3) * channels <= row && rows.len() >= 3 * row);
        // SAFETY: the rows cover the surroundings of `count` pixels.
        unsafe { outputs::<S, PIXELS>(&Surroundings { rows, row, channels, stride }, layer, count, relu, out) }
    }
}

/// The 3 × 3 input pixels around each of a row of output pixels.
struct Surroundings<'a> {
    rows: &'a [f32],
    row: usize,
    channels: usize,
    stride: usize,
}

impl TileInputs for Surroundings<'_> {
    #[inline(always)]
    unsafe fn product<S: Lanes, const R: usize, const C: usize>(&self, first: usize, panel: *const f32, width: usize) -> [[S::V; C]; R] {
        let (step, inputs) = (self.stride * self.channels, 3 * self.channels);
        // SAFETY: the same contract.
        unsafe {
            let mut sums = [[S::splat(0.0); C]; R];
            for y in 0..3 {
                let row = self.rows.as_ptr().add(y * self.row + first * step);
                sums = extended::<S, R, C>(sums, row, step, inputs, panel.add(y * inputs * width), width);
            }
            sums
        }
    }
}
