//! A picture of features: channels side by side in each pixel, a rim of zeros around the picture.

use rayon::prelude::*;

use crate::kernel::{Kernel, PackedLinear};

/// `[rows + 2, columns + 2, channels]`, the rim zero: a convolution then needs no cases at the border.
#[derive(Debug, Clone)]
pub(crate) struct FeatureMap {
    pub rows: usize,
    pub columns: usize,
    pub channels: usize,
    values: Vec<f32>,
}

impl FeatureMap {
    pub fn zeros(rows: usize, columns: usize, channels: usize) -> Self {
        Self { rows, columns, channels, values: vec![0.0; (rows + 2) * (columns + 2) * channels] }
    }

    /// Floats in a rimmed row.
    fn row(&self) -> usize {
        (self.columns + 2) * self.channels
    }

    /// A row's pixels without the rim, `[columns, channels]`.
    pub fn inside(&self, row: usize) -> &[f32] {
        &self.values[(row + 1) * self.row() + self.channels..][..self.columns * self.channels]
    }

    /// The same, to be written.
    pub fn inside_mut(&mut self, row: usize) -> &mut [f32] {
        let at = (row + 1) * self.row() + self.channels;
        let inside = self.columns * self.channels;
        &mut self.values[at..][..inside]
    }

    /// All rows without the rim, from the top, for many threads.
    pub fn rows_mut(&mut self) -> impl IndexedParallelIterator<Item = &mut [f32]> {
        let (row, rows, channels, inside) = (self.row(), self.rows, self.channels, self.columns * self.channels);
        self.values.par_chunks_exact_mut(row).skip(1).take(rows).map(move |r| &mut r[channels..channels + inside])
    }

    /// Each pixel's channels summed up over the picture, over their number.
    pub fn mean(&self) -> Vec<f32> {
        let mut sums = vec![0f32; self.channels];
        for row in 0..self.rows {
            for pixel in self.inside(row).chunks_exact(self.channels) {
                sums.iter_mut().zip(pixel).for_each(|(sum, x)| *sum += x);
            }
        }
        let pixels = (self.rows * self.columns) as f32;
        sums.iter().map(|sum| sum / pixels).collect()
    }

    /// The largest of each channel over the picture.
    pub fn most(&self) -> Vec<f32> {
        let mut most = vec![f32::NEG_INFINITY; self.channels];
        for row in 0..self.rows {
            for pixel in self.inside(row).chunks_exact(self.channels) {
                most.iter_mut().zip(pixel).for_each(|(most, x)| *most = most.max(*x));
            }
        }
        most
    }

    /// A 3 × 3 convolution with ReLU at every `stride`-th pixel: `[rows / stride, columns / stride, outputs]`.
    pub fn convolved(&self, kernel: Kernel, layer: &PackedLinear, stride: usize) -> Self {
        let mut out = Self::zeros(self.rows / stride, self.columns / stride, layer.padded());
        let (row, count) = (self.row(), out.columns);
        out.rows_mut().enumerate().for_each(|(y, out)| {
            let rows = &self.values[y * stride * row..][..3 * row];
            kernel.convolution(layer, rows, row, self.channels, stride, count, true, out);
        });
        out
    }

    /// The same layer on every pixel, without ReLU.
    pub fn projected(&self, kernel: Kernel, layer: &PackedLinear) -> Self {
        let mut out = Self::zeros(self.rows, self.columns, layer.padded());
        out.rows_mut().enumerate().for_each(|(y, out)| kernel.linear(layer, self.inside(y), self.columns, false, out));
        out
    }

    /// Itself plus another of its size.
    pub fn plus(mut self, other: &Self) -> Self {
        self.rows_mut().enumerate().for_each(|(y, row)| row.iter_mut().zip(other.inside(y)).for_each(|(x, more)| *x += more));
        self
    }

    /// Itself plus a vector `[channels]` in every pixel.
    pub fn plus_everywhere(mut self, vector: &[f32]) -> Self {
        let add = |pixel: &mut [f32]| pixel.iter_mut().zip(vector).for_each(|(x, more)| *x += more);
        self.rows_mut().for_each(|row| row.chunks_exact_mut(vector.len()).for_each(add));
        self
    }

    /// ReLU of itself plus another of half its size, each of whose pixels counts for four.
    pub fn plus_twice_as_large(mut self, half: &Self) -> Self {
        let channels = self.channels;
        self.rows_mut().enumerate().for_each(|(y, row)| {
            for (two, more) in row.chunks_exact_mut(2 * channels).zip(half.inside(y / 2).chunks_exact(channels)) {
                for pixel in two.chunks_exact_mut(channels) {
                    pixel.iter_mut().zip(more).for_each(|(x, more)| *x = (*x + more).max(0.0));
                }
            }
        });
        self
    }
}
