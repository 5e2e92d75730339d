//! The viewer's frame: what "left" and "behind" mean.
//!
//! Right-handed: x right, y away from the viewer, z up, level. It is the world turned by `view_yaw_rad` about z; 0 looks along world +y,
//! positive is counter-clockwise seen from above. (The paper's appendix writes the same axes as a left-handed right/up/away.)
//! Only rotations matter to relations and networks, so the frame has no origin of its own. Which way a camera's viewer looks is decided in
//! one place, [`away_in_camera`].

use std::f64::consts::{FRAC_PI_4, FRAC_PI_6};

use nalgebra::{Isometry3, Point3, Rotation3, Vector3};

/// Up to this far from vertical the picture alone decides what is away …
const BY_PICTURE_RAD: f64 = FRAC_PI_6;
/// … and from here on the line of sight alone.
const BY_SIGHT_RAD: f64 = FRAC_PI_4;
/// Where its level part is shorter than this (5° from vertical), the line of sight's direction over the ground is inexact.
const LEAST_LEVEL: f64 = 0.087;
/// What poses with few digits leave of zero: a roll in radians, or a length.
const ROUNDING: f64 = 1e-6;

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

    /// The viewer at a camera: where it looks, levelled; for one that looks steeply down, what its picture shows ([`away_in_camera`]).
    pub fn from_camera(world_from_camera: &Isometry3<f64>) -> Self {
        let up_in_camera = world_from_camera.inverse_transform_vector(&Vector3::z());
        let away = world_from_camera * away_in_camera(&up_in_camera);
        Self { yaw_rad: (-away.x).atan2(away.y) }
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

/// The direction in the camera's frame whose level part is "away"; `up` is the unit vector against gravity in that frame.
///
/// For a camera that looks along the ground it is the line of sight, however the camera is rolled. Within 30° of vertical, users go by the
/// picture: turn the camera the shortest way until it looks straight down (or up), and the picture's up is away, its left is left. So a tilt to
/// any side changes nothing there, while the line of sight over the ground would swing round with it. Between 30° and 45° the two blend. For a
/// camera without roll they are the same at any steepness.
pub fn away_in_camera(up: &Vector3<f64>) -> Vector3<f64> {
    let sight = Vector3::z();
    let off_vertical_rad = up.z.abs().min(1.0).acos();
    let share = ((BY_SIGHT_RAD - off_vertical_rad) / (BY_SIGHT_RAD - BY_PICTURE_RAD)).clamp(0.0, 1.0);
    // Without roll both are one direction: the line of sight has it in the same digits at every steepness.
    let is_upright = up.y < -LEAST_LEVEL && up.x.abs() < ROUNDING * -up.y;
    if share <= 0.0 || is_upright {
        return sight;
    }
    // A quarter turn left of the picture's right, plus the picture's up (its down for a camera that looks up): the middle of the two.
    let picture = up.cross(&Vector3::x()) + Vector3::y() * up.z.signum();
    // Each over the length of its level part.
    let sight_length = off_vertical_rad.max(BY_PICTURE_RAD).sin();
    let away = sight * ((1.0 - share) / sight_length) + picture * (share / (1.0 + up.z.abs()));
    // For a camera held upside down the two are opposite, and at one steepness they cancel out.
    let level = away - up * up.dot(&away);
    if level.norm() < ROUNDING { sight } else { away }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::transform::{look_at, wrap_angle};

    /// A camera above the origin that looked straight down with world +y up in its picture: rolled about its line of sight, lifted towards
    /// +y until it looks so far off vertical, and turned about world z.
    fn held(turn_rad: f64, off_vertical_rad: f64, roll_rad: f64) -> Isometry3<f64> {
        let down = look_at(&Point3::new(0.0, 0.0, 1.0), &Point3::origin(), &Vector3::y());
        let lifted = Isometry3::rotation(Vector3::z() * turn_rad) * Isometry3::rotation(Vector3::x() * off_vertical_rad);
        lifted * down * Isometry3::rotation(Vector3::z() * roll_rad)
    }

    /// The camera that looks straight down with its picture turned, tilted towards a direction over the ground.
    fn tilted(turn_rad: f64, towards_rad: f64, tilt_rad: f64) -> Isometry3<f64> {
        Isometry3::rotation(Vector3::new(towards_rad.cos(), towards_rad.sin(), 0.0) * tilt_rad) * held(turn_rad, 0.0, 0.0)
    }

    fn yaw_rad(world_from_camera: &Isometry3<f64>) -> f64 {
        ViewerFrame::from_camera(world_from_camera).yaw_rad()
    }

    proptest! {
        #[test]
        fn a_tilt_to_any_side_does_not_turn_the_viewer_of_a_camera_that_looks_down(
            turn in -3.1..3.1f64, towards in -3.1..3.1f64, tilt in 0.0..0.52f64,
        ) {
            prop_assert!(wrap_angle(yaw_rad(&tilted(turn, towards, tilt)) - turn).abs() < 2.0 * ROUNDING);
        }

        #[test]
        fn a_roll_does_not_turn_the_viewer_of_a_camera_that_looks_along_the_ground(
            turn in -3.1..3.1f64, off_vertical in 0.79..2.3f64, roll in -3.1..3.1f64,
        ) {
            prop_assert!(wrap_angle(yaw_rad(&held(turn, off_vertical, roll)) - turn).abs() < 1e-9);
        }

        #[test]
        fn the_viewer_turns_steadily_as_a_rolled_camera_is_lifted(turn in -3.1..3.1f64, roll in -1.5..1.5f64) {
            let yaws: Vec<f64> = (0..1570).map(|k| yaw_rad(&held(turn, 1e-3 * f64::from(k), roll))).collect();
            prop_assert!(yaws.windows(2).all(|two| wrap_angle(two[1] - two[0]).abs() < 0.012));
        }

        #[test]
        fn the_viewer_turns_steadily_as_a_tilt_goes_round(turn in -3.1..3.1f64, tilt in 0.0..0.6f64) {
            let yaws: Vec<f64> = (0..630).map(|k| yaw_rad(&tilted(turn, 0.01 * f64::from(k), tilt))).collect();
            prop_assert!(yaws.windows(2).all(|two| wrap_angle(two[1] - two[0]).abs() < 0.02));
        }

        #[test]
        fn a_camera_that_is_not_rolled_has_exactly_the_yaw_of_its_line_of_sight(
            x in -1.0..1.0f64, y in -1.0..1.0f64, z in 0.05..3.0f64,
        ) {
            let world_from_camera = look_at(&Point3::new(x, y, z), &Point3::origin(), &Vector3::z());
            let sight = world_from_camera * Vector3::z();
            prop_assume!(sight.xy().norm() > LEAST_LEVEL + 1e-3);
            prop_assert_eq!(yaw_rad(&world_from_camera), (-sight.x).atan2(sight.y));
        }
    }

    #[test]
    fn a_camera_above_that_is_tilted_sideways_has_its_pictures_left_on_the_left() {
        for tilt_deg in [-25f64, -20.0, -10.0, 10.0, 20.0, 25.0] {
            let world_from_camera = held(0.7, 0.0, 0.0) * Isometry3::rotation(Vector3::y() * tilt_deg.to_radians());
            let world_from_viewer = ViewerFrame::from_camera(&world_from_camera).world_from_viewer();
            let in_picture = |in_viewer: Vector3<f64>| world_from_camera.inverse_transform_vector(&(world_from_viewer * in_viewer));
            let (left, away) = (in_picture(-Vector3::x()), in_picture(Vector3::y()));
            assert!(left.x < -0.9 && left.y.abs() < 1e-9, "{tilt_deg}: {left}");
            assert!((away + Vector3::y()).norm() < 1e-9, "{tilt_deg}: {away}");
        }
    }

    #[test]
    fn a_roll_of_20_degrees_does_not_turn_the_viewer_of_a_level_camera() {
        for roll_deg in [-20f64, 20.0] {
            let level = held(0.7, std::f64::consts::FRAC_PI_2, roll_deg.to_radians());
            assert!((yaw_rad(&level) - 0.7).abs() < 1e-12, "{roll_deg}");
        }
    }

    #[test]
    fn away_has_a_level_part_however_a_camera_is_held() {
        for (half_deg, roll_deg) in (0..=360).flat_map(|half_deg| [0, 90, 135, 180].map(|roll_deg| (half_deg, roll_deg))) {
            let camera = held(0.3, f64::from(half_deg).to_radians() / 2.0, f64::from(roll_deg).to_radians());
            let up = camera.inverse_transform_vector(&Vector3::z());
            let away = away_in_camera(&up);
            let level = away - up * up.dot(&away);
            assert!(level.norm() > 0.5 * ROUNDING, "{half_deg} halves of a degree off vertical, rolled by {roll_deg} degrees");
        }
    }

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
