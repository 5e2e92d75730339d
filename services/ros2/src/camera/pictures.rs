//! Pictures as cameras send them: plain, or packed as PNG by image_transport.

use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use repose_proto::limits::MAX_IMAGE_SIDE;
use repose_ros_messages::frames::{DEPTH_UNIT_M, color_of, depth_of_image};
use repose_ros_messages::{CompressedImage, MessageError, RosImage};

/// Metres per count of integer depth (REP 118).
const INTEGER_UNIT_M: f64 = 1e-3;
/// Bytes before the PNG of packed depth: the kind, and two numbers by which floats were made integers.
const DEPTH_HEADER: usize = 12;

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
    whole(image.width, image.height, counts.len())?;
    Ok(Depth { width: image.width as usize, height: image.height as usize, unit_m, counts })
}

/// Color of a plain image.
///
/// # Errors
/// [`MessageError`] for what is not color.
pub fn color(image: &RosImage) -> Result<Color, MessageError> {
    let pixels = color_of(image)?;
    whole(image.width, image.height, pixels.len())?;
    Ok(Color { width: image.width as usize, height: image.height as usize, pixels })
}

fn whole(width: u32, height: u32, got: usize) -> Result<(), MessageError> {
    let expected = usize::try_from(u64::from(width) * u64::from(height)).unwrap_or(usize::MAX);
    if expected == got { Ok(()) } else { Err(MessageError::Short { message: "sensor_msgs/msg/Image", expected, got }) }
}

/// Depth as image_transport's `compressedDepth` packs it.
///
/// # Errors
/// [`MessageError`] for what is not PNG, as RVL is not.
pub fn packed_depth(message: &CompressedImage) -> Result<Depth, MessageError> {
    let unsupported = |got: String| MessageError::Unsupported { field: "format", got, expected: "16UC1 or 32FC1, compressedDepth png" };
    let (encoding, packing) = message.format.split_once(';').unwrap_or((&message.format, ""));
    if packing.contains("rvl") || !packing.contains("compressedDepth") {
        return Err(unsupported(message.format.clone()));
    }
    let Some((header, png)) = message.data.split_at_checked(DEPTH_HEADER) else {
        return Err(MessageError::Short { message: "sensor_msgs/msg/CompressedImage", expected: DEPTH_HEADER, got: message.data.len() });
    };
    let picture = match decoded(png, ImageFormat::Png)? {
        DynamicImage::ImageLuma16(picture) => picture,
        other => return Err(unsupported(format!("a PNG of {:?}", other.color()))),
    };
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let raw = picture.into_raw();
    match encoding.trim() {
        "16UC1" | "mono16" => Ok(Depth { width, height, unit_m: INTEGER_UNIT_M, counts: raw }),
        "32FC1" => {
            let number = |at: usize| f32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
            let (a, b) = (f64::from(number(4)), f64::from(number(8)));
            let count = |inverse: u16| {
                let depth_m = a / (f64::from(inverse) - b);
                let counts = (depth_m / DEPTH_UNIT_M).round();
                if inverse > 0 && counts >= 1.0 && counts <= f64::from(u16::MAX) { counts as u16 } else { 0 }
            };
            Ok(Depth { width, height, unit_m: DEPTH_UNIT_M, counts: raw.into_iter().map(count).collect() })
        }
        other => Err(unsupported(other.to_owned())),
    }
}

/// Color as image_transport's `compressed` packs it as PNG.
///
/// # Errors
/// [`MessageError`] for JPEG, which is not read here, and for what is no picture.
pub fn packed_color(message: &CompressedImage) -> Result<Color, MessageError> {
    if !message.format.contains("png") {
        let (got, expected) = (message.format.clone(), "png (image_transport's parameter `format`), or the topic of plain images");
        return Err(MessageError::Unsupported { field: "format", got, expected });
    }
    let picture = decoded(&message.data, ImageFormat::Png)?.into_rgb8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    Ok(Color { width, height, pixels: picture.into_raw().as_chunks::<3>().0.to_vec() })
}

fn decoded(bytes: &[u8], format: ImageFormat) -> Result<DynamicImage, MessageError> {
    let mut reader = ImageReader::with_format(std::io::Cursor::new(bytes), format);
    let mut bounds = Limits::default();
    bounds.max_image_width = Some(MAX_IMAGE_SIDE as u32);
    bounds.max_image_height = Some(MAX_IMAGE_SIDE as u32);
    reader.limits(bounds);
    let broken = |e: image::ImageError| MessageError::Body { message: "sensor_msgs/msg/CompressedImage", reason: e.to_string() };
    reader.decode().map_err(broken)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use image::{ImageBuffer, Luma, Rgb};
    use serde_bytes::ByteBuf;

    use super::*;

    fn png(picture: &DynamicImage) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        picture.write_to(&mut bytes, ImageFormat::Png).expect("a PNG");
        bytes.into_inner()
    }

    fn message(format: &str, data: Vec<u8>) -> CompressedImage {
        CompressedImage { format: format.to_owned(), data: ByteBuf::from(data), ..CompressedImage::default() }
    }

    #[test]
    fn packed_depth_is_read_as_integers_and_as_inverse_floats() {
        let counts = ImageBuffer::<Luma<u16>, _>::from_raw(2, 2, vec![0u16, 1000, 2000, 65535]).expect("a picture");
        let png = png(&DynamicImage::ImageLuma16(counts));
        let with = |a: f32, b: f32| [&0i32.to_le_bytes()[..], &a.to_le_bytes(), &b.to_le_bytes(), &png].concat();
        let integers = packed_depth(&message("16UC1; compressedDepth png", with(0.0, 0.0))).expect("depth");
        assert_eq!((integers.counts.as_slice(), integers.unit_m), ([0, 1000, 2000, 65535].as_slice(), 1e-3));
        // Quantised as 1000 / depth + 0: 1000 is 1 m, 2000 half a metre.
        let floats = packed_depth(&message("32FC1; compressedDepth", with(1000.0, 0.0))).expect("depth");
        assert_eq!((floats.counts[..3].to_vec(), floats.unit_m), (vec![0, 10_000, 5_000], 1e-4));
        for format in ["16UC1; compressedDepth rvl", "16UC1", "8UC1; compressedDepth png"] {
            assert!(matches!(packed_depth(&message(format, with(0.0, 0.0))), Err(MessageError::Unsupported { .. })), "{format}");
        }
        assert!(packed_depth(&message("16UC1; compressedDepth png", vec![0; 5])).is_err());
    }

    #[test]
    fn packed_color_is_png_and_jpeg_is_refused_with_what_helps() {
        let picture = ImageBuffer::<Rgb<u8>, _>::from_raw(1, 2, vec![1u8, 2, 3, 4, 5, 6]).expect("a picture");
        let read = packed_color(&message("bgr8; png compressed bgr8", png(&DynamicImage::ImageRgb8(picture)))).expect("color");
        assert_eq!((read.width, read.pixels), (1, vec![[1, 2, 3], [4, 5, 6]]));
        let error = packed_color(&message("bgr8; jpeg compressed bgr8", vec![0xff, 0xd8])).unwrap_err();
        assert!(error.to_string().contains("png"), "{error}");
    }
}
