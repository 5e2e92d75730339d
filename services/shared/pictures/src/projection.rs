//! Where things are seen: from the world to a camera's pixels.

use nalgebra::{Isometry3, Point2, Point3};
use repose_geometry::Pinhole;
use repose_geometry::transform::from_row_major;
use repose_proto::{CameraModel, Scene};

/// The intrinsics of a camera message.
pub fn pinhole(camera: &CameraModel) -> Pinhole {
    Pinhole { width: camera.width, height: camera.height, fx: camera.fx, fy: camera.fy, cx: camera.cx, cy: camera.cy }
}

/// The world as a scene's camera has it; none where its pose is not known or not rigid.
pub fn camera_from_world(scene: &Scene) -> Option<Isometry3<f64>> {
    Some(from_row_major(&scene.meta.camera.world_from_camera?.0).ok()?.inverse())
}

/// Where an object's centroid falls in its camera's picture.
pub fn pixel_of_object(scene: &Scene, id: u16) -> Option<(i64, i64)> {
    pixel_of(scene, &scene.object(id)?.centroid_m.into())
}

/// Where a point of the world falls in a scene's picture, as [`nearest_pixel`] tells it.
pub fn pixel_of(scene: &Scene, point_in_world: &Point3<f64>) -> Option<(i64, i64)> {
    let place = pinhole(&scene.meta.camera).project(&(camera_from_world(scene)? * point_in_world))?;
    Some(nearest_pixel(&place))
}

/// The pixel at a place of a picture, column and row. What is so far outside that it fits 32 bits no more is at their end, so that nothing that is
/// drawn around it overflows.
pub fn nearest_pixel(place: &Point2<f64>) -> (i64, i64) {
    (i64::from(place.x.round() as i32), i64::from(place.y.round() as i32))
}
