//! The viewer's frame: what "left" and "behind" mean.
//!
//! Right-handed: x right, y away from the viewer, z up, level. It is the world turned by `view_yaw_rad` about z; 0 looks along world +y,
//! positive is counter-clockwise seen from above. (The paper's appendix writes the same axes as a left-handed right/up/away.)
//! Only rotations matter to relations and networks, so the frame has no origin of its own.

use nalgebra::{Isometry3, Point3, Rotation3, Vector3};

/// How close to vertical a camera may look before its image's up direction stands in for "away".
const VERTICAL_LIMIT_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// A level viewing direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewerFrame {
    yaw_rad: f64,
}

impl ViewerFrame {
    /// The viewer turned by `view_yaw_rad` from looking along world +y.
    pub fn from_yaw(view_yaw_rad: f64) -> Self {
        Self { yaw_rad: view_yaw_rad }
    }

    /// The viewer at a camera: away is where the camera looks, levelled. Within 5° of vertical, the image's up is "away".
    pub fn from_camera(world_from_camera: &Isometry3<f64>) -> Self {
        let forward = world_from_camera * Vector3::z();
        let level = if forward.xy().norm() < VERTICAL_LIMIT_RAD.sin() { world_from_camera * -Vector3::y() } else { forward };
        Self { yaw_rad: (-level.x).atan2(level.y) }
    }

    /// The viewing direction as a yaw about world z, radians.
    pub fn yaw_rad(&self) -> f64 {
        self.yaw_rad
    }

    /// Turns viewer coordinates into world coordinates.
    pub fn world_from_viewer(&self) -> Rotation3<f64> {
        Rotation3::from_axis_angle(&Vector3::z_axis(), self.yaw_rad)
    }

    /// Turns world coordinates into viewer coordinates.
    pub fn viewer_from_world(&self) -> Rotation3<f64> {
        self.world_from_viewer().inverse()
    }

    /// World points in the viewer's axes.
    pub fn points_in_viewer(&self, points_in_world: &[Point3<f32>]) -> Vec<Point3<f32>> {
        let rotation = self.viewer_from_world().cast::<f32>();
        points_in_world.iter().map(|p| rotation * p).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transform::look_at;

    #[test]
    fn yaw_zero_looks_along_world_y() {
        let frame = ViewerFrame::from_yaw(0.0);
        let away = frame.world_from_viewer() * Vector3::y();
        assert!((away - Vector3::y()).norm() < 1e-12);
    }

    #[test]
    fn a_quarter_turn_counter_clockwise_looks_along_minus_x() {
        let frame = ViewerFrame::from_yaw(std::f64::consts::FRAC_PI_2);
        assert!((frame.world_from_viewer() * Vector3::y() + Vector3::x()).norm() < 1e-12);
        assert!((frame.world_from_viewer() * Vector3::x() - Vector3::y()).norm() < 1e-12, "right of it is world +y");
    }

    #[test]
    fn a_camera_sees_its_viewers_right_on_the_right() {
        for (x, y) in [(1.0, 0.2), (-0.7, 0.3), (0.1, -1.0), (0.4, 0.9)] {
            let world_from_camera = look_at(&Point3::new(x, y, 0.7), &Point3::origin(), &Vector3::z());
            let frame = ViewerFrame::from_camera(&world_from_camera);
            let right = Point3::from(frame.world_from_viewer() * Vector3::x() * 0.1);
            let away = Point3::from(frame.world_from_viewer() * Vector3::y() * 0.1);
            let camera_from_world = world_from_camera.inverse();
            assert!((camera_from_world * right).x > 0.09);
            assert!((camera_from_world * away).z > (camera_from_world * Point3::origin()).z);
        }
    }

    #[test]
    fn a_camera_that_looks_straight_down_takes_the_pictures_up_as_away() {
        let world_from_camera = look_at(&Point3::new(0.0, 0.0, 1.0), &Point3::origin(), &Vector3::x());
        let frame = ViewerFrame::from_camera(&world_from_camera);
        assert!((frame.world_from_viewer() * Vector3::y() - Vector3::x()).norm() < 1e-9);
    }
}
