//! Cameras as a robot's hand or a tripod would hold them.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};
use repose_geometry::Pinhole;
use repose_geometry::transform::look_at;

use crate::furniture::Focus;

/// The range of random viewpoints.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewpointSettings {
    /// Columns of the picture.
    pub width: usize,
    /// Rows of the picture.
    pub height: usize,
    /// Focal length in picture widths, lowest and highest: 0.82 is a Kinect, 0.96 a RealSense D415.
    pub focal_widths: [f64; 2],
    /// How far the line of sight may pass the middle of the objects, metres.
    pub aim_error_m: f64,
    /// How far the camera may be turned about its line of sight, radians.
    pub roll_rad: f64,
}

impl Default for ViewpointSettings {
    fn default() -> Self {
        Self { width: 320, height: 240, focal_widths: [0.82, 0.97], aim_error_m: 0.08, roll_rad: 0.05 }
    }
}

/// A random camera that looks at `focus` from where it can be seen: intrinsics and `world_from_camera`.
pub fn random_viewpoint(focus: &Focus, settings: &ViewpointSettings, rng: &mut impl Rng) -> (Pinhole, Isometry3<f64>) {
    let mut between = |[low, high]: [f64; 2]| rng.random_range(low..=high);
    let focal = between(settings.focal_widths) * settings.width as f64;
    let (distance, elevation) = (between(focus.distance_m), between(focus.elevation_rad));
    let azimuth = between(focus.azimuth_rad);
    let roll = between([-settings.roll_rad, settings.roll_rad]);
    let aim = Vector3::from_fn(|_, _| between([-settings.aim_error_m, settings.aim_error_m]));
    let aimed = focus.target + aim;
    let outward = Vector3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
    let level = look_at(&(aimed + outward * distance), &aimed, &Vector3::z());
    let world_from_camera = level * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
    let (width, height) = (settings.width, settings.height);
    let camera = Pinhole { width, height, fx: focal, fy: focal, cx: (width as f64 - 1.0) / 2.0, cy: (height as f64 - 1.0) / 2.0 };
    (camera, world_from_camera)
}
