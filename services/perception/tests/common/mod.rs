//! A small frame that gives a scene quickly, and the configuration that it needs.

use repose_geometry::Isometry3;
use repose_geometry::transform::to_row_major;
use repose_perception::PerceptionConfig;
use repose_proto::{CameraModel, Frame, Payload, RigidTransform};

/// A camera 1 m above a table, looking straight down at a box of 10 cm in the middle of the view.
pub fn frame(camera_name: &str, stamp_ns: u64) -> Frame {
    frame_of(camera_name, stamp_ns, 1)
}

/// The same with `scale` times as many columns and rows.
pub fn frame_of(camera_name: &str, stamp_ns: u64, scale: usize) -> Frame {
    let down = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::x_axis(), std::f64::consts::PI);
    let world_from_camera = Isometry3::from_parts(nalgebra::Translation3::new(0.0, 0.0, 1.0), down);
    let (width, height) = (160 * scale, 120 * scale);
    let camera = CameraModel {
        width,
        height,
        fx: 140.0 * scale as f64,
        fy: 140.0 * scale as f64,
        cx: (width - 1) as f64 / 2.0,
        cy: (height - 1) as f64 / 2.0,
        depth_unit_m: 0.001,
        world_from_camera: Some(RigidTransform(to_row_major(&world_from_camera))),
    };
    let on_box = |i: usize| (70..90).contains(&(i % width / scale)) && (50..70).contains(&(i / width / scale));
    let depth = (0..width * height).map(|i| if on_box(i) { 900 } else { 1000 }).collect();
    Frame::new(camera_name.to_owned(), stamp_ns, camera, depth)
}

/// The frame as a camera puts it.
pub fn encoded(frame: &Frame) -> Payload {
    Payload::bulk(Frame::SCHEMA, &frame.to_bulk()).unwrap()
}

/// A configuration for pictures this small: few pixels are on the box.
pub fn config() -> PerceptionConfig {
    // A frame that waits a second for a core is not late here, and becomes a scene whoever asks.
    let mut config = PerceptionConfig { frame_timeout_ms: 20_000, idle_period_ms: 0, ..PerceptionConfig::default() };
    config.segmentation.coarse_columns = 160;
    config.segmentation.components.min_pixels = 50;
    config
}
