//! A camera's picture, and how it sees.

use foxglove::messages::{CameraCalibration, CompressedImage, FrameTransforms};
use repose_geometry::transform::from_row_major;
use repose_pictures::jpeg;
use repose_proto::{CallError, CameraModel, Frame};

use super::message::VisualMessage;
use super::types::{WORLD, instant, transform};

/// JPEG quality: what is looked at need not be measured in.
const QUALITY: u8 = 75;

/// The picture, the calibration and, where it is known, the pose.
pub fn looks(frame: &Frame) -> Result<Vec<VisualMessage>, CallError> {
    let (name, at_ns) = (&frame.camera_name, frame.stamp_ns);
    let (timestamp, frame_id) = (instant(at_ns), format!("{name}_optical"));
    let data = jpeg(frame, QUALITY)?.into();
    let image = CompressedImage { timestamp, frame_id: frame_id.clone(), data, format: "jpeg".to_owned() };
    let CameraModel { width, height, fx, fy, cx, cy, .. } = frame.camera;
    let calibration = CameraCalibration {
        timestamp,
        frame_id: frame_id.clone(),
        width: u32::try_from(width).unwrap_or_default(),
        height: u32::try_from(height).unwrap_or_default(),
        distortion_model: String::new(),
        d: Vec::new(),
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    };
    let mut looks = vec![
        VisualMessage::new(format!("/camera/{name}/image"), at_ns, &image),
        VisualMessage::new(format!("/camera/{name}/calibration"), at_ns, &calibration),
    ];
    if let Some(world_from_camera) = frame.camera.world_from_camera.and_then(|pose| from_row_major(&pose.0).ok()) {
        let transforms = vec![transform(timestamp, WORLD, frame_id, &world_from_camera)];
        looks.push(VisualMessage::new("/tf".to_owned(), at_ns, &FrameTransforms { transforms }));
    }
    Ok(looks.into_iter().flatten().collect())
}
