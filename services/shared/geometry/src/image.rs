//! A dense, row-major raster of anything: depth in metres, instance labels, colors.

/// An image of `T`, row-major, first row at the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Image<T> {
    width: usize,
    height: usize,
    pixels: Vec<T>,
}

/// A raster whose buffer does not have `width * height` pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected} pixels ({width} x {height}), got {got}")]
pub struct SizeMismatch {
    /// Columns asked for.
    pub width: usize,
    /// Rows asked for.
    pub height: usize,
    /// Pixels that this needs.
    pub expected: usize,
    /// Pixels that came.
    pub got: usize,
}

impl<T: Clone> Image<T> {
    /// An image with every pixel set to `value`.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self { width, height, pixels: vec![value; width * height] }
    }
}

impl<T> Image<T> {
    /// An image from its pixels, row by row.
    ///
    /// # Errors
    /// [`SizeMismatch`] when `pixels.len() != width * height`.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<T>) -> Result<Self, SizeMismatch> {
        if pixels.len() != width * height {
            return Err(SizeMismatch { width, height, expected: width * height, got: pixels.len() });
        }
        Ok(Self { width, height, pixels })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> &[T] {
        &self.pixels
    }

    /// All pixels, row by row, to write.
    pub fn pixels_mut(&mut self) -> &mut [T] {
        &mut self.pixels
    }

    /// The pixels, given away.
    pub fn into_pixels(self) -> Vec<T> {
        self.pixels
    }

    /// The pixel at column `u`, row `v`, or `None` outside.
    pub fn get(&self, u: usize, v: usize) -> Option<&T> {
        (u < self.width && v < self.height).then(|| &self.pixels[v * self.width + u])
    }

    /// An image of the same size with `f` applied to every pixel.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Image<U> {
        Image { width: self.width, height: self.height, pixels: self.pixels.iter().map(f).collect() }
    }
}

impl<T> std::ops::Index<(usize, usize)> for Image<T> {
    type Output = T;

    /// The pixel at (column, row).
    fn index(&self, (u, v): (usize, usize)) -> &T {
        assert!(u < self.width, "column {u} of {}", self.width);
        &self.pixels[v * self.width + u]
    }
}

impl<T> std::ops::IndexMut<(usize, usize)> for Image<T> {
    fn index_mut(&mut self, (u, v): (usize, usize)) -> &mut T {
        assert!(u < self.width, "column {u} of {}", self.width);
        &mut self.pixels[v * self.width + u]
    }
}
