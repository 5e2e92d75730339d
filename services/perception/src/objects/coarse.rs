//! The picture on which objects are told apart.

use repose_geometry::Image;

use crate::readings::point_map::PointMap;

/// A picture coarse enough to be searched, with its points in both frames.
pub struct CoarseView<'a> {
    /// Points in the camera frame.
    pub in_camera: &'a PointMap,
    /// The same points in the world.
    pub in_world: &'a PointMap,
    /// Which of them face up.
    pub faces_up: &'a Image<bool>,
    /// Focal length of this picture, pixels.
    pub focal_px: f32,
    /// The camera's height in the world, metres.
    pub camera_m: f32,
}
