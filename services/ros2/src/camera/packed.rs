//! Pictures as image_transport packs them: JPEG or PNG under `…/compressed`, PNG or RVL under `…/compressedDepth`.
//!
//! The forms are those of image_transport_plugins: what its own subscribers show is what is read here.

use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use repose_proto::limits::MAX_IMAGE_SIDE;
use repose_ros_messages::frames::counts_of;
use repose_ros_messages::pictures::{Color, Depth};
use repose_ros_messages::{CompressedImage, MessageError};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::rvl;

const MESSAGE: &str = "sensor_msgs/msg/CompressedImage";
/// Metres per count of integer depth (REP 118).
const INTEGER_UNIT_M: f64 = 1e-3;
/// Bytes before packed depth: the kind, and two numbers by which floats were made integers.
const DEPTH_HEADER: usize = 12;
/// Bytes before the runs of RVL: columns and rows.
const RVL_HEADER: usize = 8;
/// How far before its last byte a JPEG's end may be marked: some cameras fill their buffers up.
const MOST_PADDING: usize = 4096;

/// How depth is packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Packing {
    /// PNG after a header, `compressedDepth png`; older drivers name no packing.
    Png,
    /// RVL after a header, `compressedDepth rvl`.
    Rvl,
    /// PNG and nothing else, `png compressed`: what is packed as if it were color.
    BarePng,
}

/// Depth of a packed image.
///
/// # Errors
/// [`MessageError`] for what is not depth, is packed with loss, or is broken.
pub fn depth(message: &CompressedImage) -> Result<Depth, MessageError> {
    let (encoding, packing) = message.format.split_once(';').unwrap_or((&message.format, ""));
    let packing = match packing.trim() {
        "" | "compressedDepth" | "compressedDepth png" => Packing::Png,
        "compressedDepth rvl" => Packing::Rvl,
        bare if bare.starts_with("png compressed") => Packing::BarePng,
        _ => return Err(unsupported(&message.format)),
    };
    let header = if packing == Packing::BarePng { 0 } else { DEPTH_HEADER };
    let (header, packed) = split(&message.data, header)?;
    let (width, height, counts) = if packing == Packing::Rvl { rvl_counts(packed)? } else { png_counts(packed)? };
    match encoding.trim() {
        "16UC1" | "mono16" => Ok(Depth { width, height, unit_m: INTEGER_UNIT_M, counts }),
        "32FC1" if !header.is_empty() => {
            let (a, b) = (f64::from(f32::from_bits(word(header, 4))), f64::from(f32::from_bits(word(header, 8))));
            if !(a > 0.0 && a.is_finite() && b.is_finite()) {
                let expected = "a positive depthQuantA and a finite depthQuantB in the header of 32FC1";
                return Err(MessageError::Unsupported { field: "data", got: format!("{a} and {b}"), expected });
            }
            let (counts, unit_m) = counts_of(counts.iter().map(|inverse| depth_m_of(*inverse, a, b)));
            Ok(Depth { width, height, unit_m, counts })
        }
        _ => Err(unsupported(&message.format)),
    }
}

/// The depth of a number that stands for its inverse, `a / depth + b`, metres; NaN for 0, which is no reading.
fn depth_m_of(inverse: u16, a: f64, b: f64) -> f64 {
    if inverse > 0 { a / (f64::from(inverse) - b) } else { f64::NAN }
}

fn png_counts(png: &[u8]) -> Result<(usize, usize, Vec<u16>), MessageError> {
    match read_png(png)? {
        DynamicImage::ImageLuma16(picture) => Ok((picture.width() as usize, picture.height() as usize, picture.into_raw())),
        other => Err(unsupported(&format!("a PNG of {:?}", other.color()))),
    }
}

fn rvl_counts(packed: &[u8]) -> Result<(usize, usize, Vec<u16>), MessageError> {
    let (sizes, runs) = split(packed, RVL_HEADER)?;
    let (width, height) = (word(sizes, 0) as usize, word(sizes, 4) as usize);
    if !(1..=MAX_IMAGE_SIDE).contains(&width) || !(1..=MAX_IMAGE_SIDE).contains(&height) {
        return Err(broken(format!("RVL of {width} x {height} pixels; sides of 1 to {MAX_IMAGE_SIDE} are read")));
    }
    let counts = rvl::unpack(runs, width * height).map_err(|error| broken(format!("RVL: {error}")))?;
    Ok((width, height, counts))
}

/// Color of a packed image. What it is packed as is told by its first bytes: drivers have many words for it.
///
/// # Errors
/// [`MessageError`] for what is neither JPEG nor PNG, and for what is broken.
pub fn color(message: &CompressedImage) -> Result<Color, MessageError> {
    let mut color = match message.data.as_slice() {
        [0xff, 0xd8, ..] => read_jpeg(&message.data)?,
        [0x89, b'P', b'N', b'G', ..] => {
            let picture = read_png(&message.data)?.into_rgb8();
            let (width, height) = (picture.width() as usize, picture.height() as usize);
            Color { width, height, pixels: picture.into_raw().as_chunks::<3>().0.to_vec() }
        }
        _ => return Err(MessageError::Unsupported { field: "format", got: message.format.clone(), expected: "jpeg or png" }),
    };
    if has_red_for_blue(&message.format) {
        color.pixels.iter_mut().for_each(|pixel| pixel.reverse());
    }
    Ok(color)
}

/// Whether red and blue were packed in each other's place: image_transport turns colors before it packs them, and says `compressed bgr8` then. Where
/// it does not say so, a picture of red, green and blue was packed as if it were one of blue, green and red.
fn has_red_for_blue(format: &str) -> bool {
    let Some((encoding, packing)) = format.split_once(';') else { return false };
    let is_color = ["rgb", "bgr"].iter().any(|order| encoding.trim().starts_with(order));
    is_color && !packing.contains("compressed bgr")
}

/// A JPEG, whole: what a broken one leaves is no picture.
fn read_jpeg(bytes: &[u8]) -> Result<Color, MessageError> {
    let tail = &bytes[bytes.len().saturating_sub(MOST_PADDING)..];
    if !tail.windows(2).any(|marker| marker == [0xff, 0xd9]) {
        return Err(broken(format!("JPEG: {} bytes without its end", bytes.len())));
    }
    let options = DecoderOptions::default().set_strict_mode(true).set_max_width(MAX_IMAGE_SIDE).set_max_height(MAX_IMAGE_SIDE);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options.jpeg_set_out_colorspace(ColorSpace::RGB));
    let samples = decoder.decode().map_err(|error| broken(format!("JPEG: {error:?}")))?;
    let (width, height) = decoder.dimensions().ok_or_else(|| broken("JPEG: without a size".to_owned()))?;
    let pixels = samples.as_chunks::<3>().0.to_vec();
    if pixels.len() != width * height {
        return Err(broken(format!("JPEG: {} pixels of {width} x {height}", pixels.len())));
    }
    Ok(Color { width, height, pixels })
}

fn read_png(bytes: &[u8]) -> Result<DynamicImage, MessageError> {
    let mut reader = ImageReader::with_format(std::io::Cursor::new(bytes), ImageFormat::Png);
    let mut bounds = Limits::default();
    bounds.max_image_width = Some(MAX_IMAGE_SIDE as u32);
    bounds.max_image_height = Some(MAX_IMAGE_SIDE as u32);
    reader.limits(bounds);
    reader.decode().map_err(|error| broken(format!("PNG: {error}")))
}

fn split(bytes: &[u8], header: usize) -> Result<(&[u8], &[u8]), MessageError> {
    bytes.split_at_checked(header).ok_or(MessageError::Short { message: MESSAGE, expected: header, got: bytes.len() })
}

/// A little-endian word of a header that is long enough.
fn word(header: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]])
}

fn broken(reason: String) -> MessageError {
    MessageError::Body { message: MESSAGE, reason }
}

fn unsupported(got: &str) -> MessageError {
    let expected = "16UC1, mono16 or 32FC1; compressedDepth png or rvl, or 16UC1; png compressed";
    MessageError::Unsupported { field: "format", got: got.to_owned(), expected }
}

#[cfg(test)]
mod tests;
