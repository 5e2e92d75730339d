//! Pictures as cameras send them plain.

use crate::cdr::MessageError;
use crate::frames::{color_of, depth_of_image};
use crate::sensor::RosImage;

/// Depth counts, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Depth {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Metres per count.
    pub unit_m: f64,
    /// Counts, 0 = no reading.
    pub counts: Vec<u16>,
}

/// Colors, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Color {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green and blue.
    pub pixels: Vec<[u8; 3]>,
}

/// Depth of a plain image.
///
/// # Errors
/// [`MessageError`] for what is not depth.
pub fn depth(image: &RosImage) -> Result<Depth, MessageError> {
    let (counts, unit_m) = depth_of_image(image)?;
    Ok(Depth { width: image.width as usize, height: image.height as usize, unit_m, counts })
}

/// Color of a plain image.
///
/// # Errors
/// [`MessageError`] for what is not color.
pub fn color(image: &RosImage) -> Result<Color, MessageError> {
    Ok(Color { width: image.width as usize, height: image.height as usize, pixels: color_of(image)? })
}
