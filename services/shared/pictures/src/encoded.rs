//! Pictures as JPEG.

use jpeg_encoder::{ColorType, Encoder};
use repose_geometry::Image;
use repose_proto::{CallError, Frame};

use crate::Rgb;

/// Encodes a frame's colour, or its depth in grey where it has none, as JPEG of a quality of 1 to 100.
///
/// # Errors
/// `internal` when the encoder refuses.
pub fn jpeg(frame: &Frame, quality: u8) -> Result<Vec<u8>, CallError> {
    let size = (frame.camera.width, frame.camera.height);
    match &frame.color {
        Some(color) => encoded(color.as_flattened(), size, ColorType::Rgb, quality),
        None => encoded(&grey(&frame.depth), size, ColorType::Luma, quality),
    }
}

/// Encodes a picture as JPEG of a quality of 1 to 100.
///
/// # Errors
/// `internal` when the encoder refuses, as it does of pictures without a pixel, or with more of them in a row or a column than JPEG has.
pub fn jpeg_of(picture: &Image<Rgb>, quality: u8) -> Result<Vec<u8>, CallError> {
    encoded(picture.pixels().as_flattened(), (picture.width(), picture.height()), ColorType::Rgb, quality)
}

fn encoded(pixels: &[u8], (width, height): (usize, usize), color: ColorType, quality: u8) -> Result<Vec<u8>, CallError> {
    let failed = |why: &dyn std::fmt::Display| CallError::internal(format!("the picture could not be encoded: {why}"));
    let (Ok(columns), Ok(rows)) = (u16::try_from(width), u16::try_from(height)) else {
        return Err(failed(&format_args!("JPEG has {} pixels a side at most, and it has {width} x {height}", u16::MAX)));
    };
    let mut bytes = Vec::new();
    Encoder::new(&mut bytes, quality).encode(pixels, columns, rows, color).map_err(|e| failed(&e))?;
    Ok(bytes)
}

/// Depth as brightness, near is bright, no reading is black.
fn grey(depth: &[u16]) -> Vec<u8> {
    let seen = || depth.iter().copied().filter(|d| Frame::is_reading(*d));
    let (near, far) = (seen().min().unwrap_or(0), seen().max().unwrap_or(0));
    let span = f32::from(far - near).max(1.0);
    let level = |d: &u16| if Frame::is_reading(*d) { 255 - (f32::from(*d - near) / span * 200.0) as u8 } else { 0 };
    depth.iter().map(level).collect()
}

#[cfg(test)]
mod tests {
    use repose_proto::CameraModel;

    use super::*;

    #[test]
    fn a_frame_without_color_is_shown_by_its_depth() {
        let camera =
            CameraModel { width: 16, height: 8, fx: 10.0, fy: 10.0, cx: 8.0, cy: 4.0, depth_unit_m: 1e-3, world_from_camera: None };
        let depth = (0..128).map(|i| if i % 7 == 0 { 0 } else { 500 + i }).collect();
        let mut frame = Frame::new("front".to_owned(), 1, camera, depth);
        let starts_as_jpeg = |frame: &Frame| jpeg(frame, 80).expect("encoded").starts_with(&[0xff, 0xd8, 0xff]);
        assert!(starts_as_jpeg(&frame));
        frame.color = Some(vec![[10, 200, 30]; 128]);
        assert!(starts_as_jpeg(&frame));
        assert_eq!(grey(&[0, 500, 1000, u16::MAX]), [0, 255, 55, 0]);
    }

    #[test]
    fn a_drawn_picture_is_encoded_and_an_empty_one_refused() {
        assert!(jpeg_of(&Image::filled(16, 8, [10, 200, 30]), 80).expect("encoded").starts_with(&[0xff, 0xd8, 0xff]));
        assert!(jpeg_of(&Image::filled(0, 0, [0; 3]), 80).is_err());
    }

    #[test]
    fn a_picture_that_is_too_wide_or_too_high_for_jpeg_is_refused_and_not_cut_to_a_strip() {
        let side = usize::from(u16::MAX) + 1 + 16;
        for (width, height) in [(side, 8), (8, side)] {
            let refused = jpeg_of(&Image::filled(width, height, [10, 200, 30]), 80).expect_err("more than JPEG has").to_string();
            assert!(refused.contains(&format!("{width} x {height}")), "{refused}");
        }
    }
}
