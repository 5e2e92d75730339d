//! Frames as pictures to look at: for the live page and for recordings.

use jpeg_encoder::{ColorType, Encoder, EncodingError};
use repose_proto::{CallError, Frame};

/// Encodes a frame's colour, or its depth in grey where it has none, as JPEG of a quality of 1 to 100.
///
/// # Errors
/// `internal` when the encoder refuses.
pub fn jpeg(frame: &Frame, quality: u8) -> Result<Vec<u8>, CallError> {
    let (width, height) = (frame.camera.width as u16, frame.camera.height as u16);
    let mut bytes = Vec::new();
    let encoder = Encoder::new(&mut bytes, quality);
    let encoded = match &frame.color {
        Some(color) => encoder.encode(color.as_flattened(), width, height, ColorType::Rgb),
        None => encoder.encode(&grey(&frame.depth), width, height, ColorType::Luma),
    };
    encoded.map_err(|e: EncodingError| CallError::internal(format!("the picture could not be encoded: {e}")))?;
    Ok(bytes)
}

/// Depth as brightness, near is bright, no reading is black.
fn grey(depth: &[u16]) -> Vec<u8> {
    let seen = || depth.iter().copied().filter(|d| *d > 0);
    let (near, far) = (seen().min().unwrap_or(0), seen().max().unwrap_or(0));
    let span = f32::from(far - near).max(1.0);
    let level = |d: &u16| if *d == 0 { 0 } else { 255 - (f32::from(*d - near) / span * 200.0) as u8 };
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
        assert_eq!(grey(&[0, 500, 1000]), [0, 255, 55]);
    }
}
