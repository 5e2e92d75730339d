//! A camera's picture, and how it sees.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use repose_geometry::transform::from_row_major;
use repose_pictures::jpeg;
use repose_proto::{CallError, CameraModel, Frame};
use serde::Serialize;

use super::message::Look;
use super::schema::Kind;
use super::types::{FrameTransform, FrameTransforms, Time, WORLD};

/// JPEG quality: what is looked at need not be measured in.
const QUALITY: u8 = 75;

#[derive(Serialize)]
struct CompressedImage {
    timestamp: Time,
    frame_id: String,
    data: String,
    format: &'static str,
}

#[derive(Serialize)]
struct CameraCalibration {
    timestamp: Time,
    frame_id: String,
    width: usize,
    height: usize,
    distortion_model: &'static str,
    #[serde(rename = "D")]
    distortion: [f64; 0],
    #[serde(rename = "K")]
    intrinsics: [f64; 9],
    #[serde(rename = "R")]
    rectification: [f64; 9],
    #[serde(rename = "P")]
    projection: [f64; 12],
}

/// The picture, the calibration and, where it is known, the pose.
pub fn looks(frame: &Frame) -> Result<Vec<Look>, CallError> {
    let (name, at_ns) = (&frame.camera_name, frame.stamp_ns);
    let (timestamp, frame_id) = (Time::of_ns(at_ns), format!("{name}_optical"));
    let data = STANDARD.encode(jpeg(frame, QUALITY)?);
    let image = CompressedImage { timestamp, frame_id: frame_id.clone(), data, format: "jpeg" };
    let CameraModel { width, height, fx, fy, cx, cy, .. } = frame.camera;
    let calibration = CameraCalibration {
        timestamp,
        frame_id: frame_id.clone(),
        width,
        height,
        distortion_model: "",
        distortion: [],
        intrinsics: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        rectification: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        projection: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    };
    let mut looks = vec![
        Look::new(format!("/camera/{name}/image"), Kind::CompressedImage, at_ns, &image),
        Look::new(format!("/camera/{name}/calibration"), Kind::CameraCalibration, at_ns, &calibration),
    ];
    if let Some(world_from_camera) = frame.camera.world_from_camera.and_then(|pose| from_row_major(&pose.0).ok()) {
        let transforms = vec![FrameTransform::new(timestamp, WORLD, frame_id, &world_from_camera)];
        looks.push(Look::new("/tf".to_owned(), Kind::FrameTransforms, at_ns, &FrameTransforms { transforms }));
    }
    Ok(looks)
}
