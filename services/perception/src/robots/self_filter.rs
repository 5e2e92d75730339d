//! Takes the readings of robots out of a depth picture, and says how well the robots are where they are said to be.
//!
//! A reading belongs to a robot when it lies in one of the balls that its body fills, grown by a margin for errors of calibration and
//! noise. What lies behind the arm has no reading in those pixels then, and so is unseen, as behind anything else.

use nalgebra::Isometry3;
use repose_geometry::Pinhole;
use repose_proto::{RobotInView, SceneWarning};

use super::body::RobotBody;
use super::calibration;
use super::nearness::Nearness;
use crate::readings::depth::DepthMap;
use crate::settings::SelfFilterSettings;

/// What was found of the robots.
#[derive(Debug, Default, PartialEq)]
pub struct FilteredRobots {
    /// The robots whose shape is known.
    pub bodies: Vec<(RobotBody, Option<bool>)>,
    /// Pixels whose readings were taken out.
    pub pixels: Vec<usize>,
    /// What should be looked into.
    pub warnings: Vec<SceneWarning>,
}

/// Replaces the readings of `robots` by NaN. `world_from_camera` is the calibrated pose; without one nobody knows where the robots are.
pub fn remove(
    depth: &mut DepthMap,
    camera: &Pinhole,
    robots: &[RobotInView],
    world_from_camera: Option<&Isometry3<f64>>,
    settings: &SelfFilterSettings,
) -> FilteredRobots {
    let mut filtered = FilteredRobots::default();
    let Some(world_from_camera) = world_from_camera else {
        if !robots.is_empty() {
            let message = "without the camera's pose the robot cannot be taken out of the picture";
            filtered.warnings.push(SceneWarning { field: "world_from_camera".to_owned(), message: message.to_owned() });
        }
        return filtered;
    };
    let camera_from_world = world_from_camera.inverse();
    for (i, robot) in robots.iter().enumerate() {
        let body = match RobotBody::new(robot, &camera_from_world) {
            Ok(body) => body,
            Err(error) => {
                filtered.warnings.push(SceneWarning { field: format!("robots[{i}]"), message: error.to_string() });
                continue;
            }
        };
        let near = Nearness::new(depth, camera, &body.balls, settings.look_m);
        let offset_m = calibration::offset(&near, depth, camera, &body.balls, settings);
        if let Some(offset) = offset_m.filter(|offset| offset.norm() > settings.warn_m) {
            let [x, y, z] = (world_from_camera.rotation.cast::<f32>() * offset).into();
            let message = format!(
                "robot {} is seen {:.0} mm from where its state and the calibration put it (x {:+.0}, y {:+.0}, z {:+.0} mm)",
                robot.name,
                1e3 * offset.norm(),
                1e3 * x,
                1e3 * y,
                1e3 * z
            );
            filtered.warnings.push(SceneWarning { field: "world_from_camera".to_owned(), message });
        }
        // Where the robot is seen beside its place, its readings are there too.
        let margin_m = settings.margin_m + offset_m.map_or(0.0, |offset| offset.norm()).min(settings.look_m - settings.margin_m);
        for pixel in near.pixels.iter().filter(|pixel| pixel.distance_m <= margin_m) {
            // Two robots may be near.
            if !depth.depth_m().pixels()[pixel.index].is_nan() {
                depth.depth_m_mut().pixels_mut()[pixel.index] = f32::NAN;
                filtered.pixels.push(pixel.index);
            }
        }
        filtered.bodies.push((body, robot.holding));
    }
    filtered
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};
    use repose_geometry::transform::{look_at, to_row_major};
    use repose_proto::RigidTransform;

    use super::*;
    use crate::robots::body::Ball;

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };
    /// Depth of the wall behind the robot, metres.
    const WALL_M: f32 = 3.0;

    fn world_from_camera() -> Isometry3<f64> {
        look_at(&Point3::new(1.4, -1.0, 0.9), &Point3::new(0.2, 0.0, 0.4), &Vector3::z())
    }

    fn robot(shift_m: [f64; 3]) -> RobotInView {
        RobotInView {
            name: "left".to_owned(),
            model: "panda".to_owned(),
            joints_rad: repose_panda::READY,
            gripper_width_m: 0.04,
            holding: None,
            world_from_base: RigidTransform(to_row_major(&Isometry3::translation(shift_m[0], shift_m[1], shift_m[2]))),
        }
    }

    /// The robot's balls before a wall, and how many pixels they fill.
    fn seen(robot: &RobotInView) -> (DepthMap, usize) {
        let body = RobotBody::new(robot, &world_from_camera().inverse()).unwrap();
        let mut on_robot = 0;
        let counts: Vec<u16> = (0..CAMERA.width * CAMERA.height)
            .map(|i| {
                let ray = CAMERA.unproject((i % CAMERA.width) as f64, (i / CAMERA.width) as f64, 1.0).coords.cast::<f32>();
                let hit = |ball: &Ball| {
                    let (a, b) = (ray.norm_squared(), ray.dot(&ball.center.coords));
                    let rest = b * b - a * (ball.center.coords.norm_squared() - ball.radius_m * ball.radius_m);
                    (rest >= 0.0).then(|| (b - rest.sqrt()) / a)
                };
                let nearest = body.balls.iter().filter_map(hit).fold(f32::INFINITY, f32::min);
                on_robot += usize::from(nearest < WALL_M);
                (nearest.min(WALL_M) * 1000.0).round() as u16
            })
            .collect();
        (DepthMap::new(&counts, 0.001, &CAMERA, 4.0), on_robot)
    }

    #[test]
    fn a_robot_where_it_says_leaves_the_picture_and_nothing_else_does() {
        let (mut depth, on_robot) = seen(&robot([0.0; 3]));
        let pose = world_from_camera();
        let filtered = remove(&mut depth, &CAMERA, &[robot([0.0; 3])], Some(&pose), &SelfFilterSettings::default());
        assert!(on_robot > 1500 && filtered.pixels.len() == on_robot, "{} of {on_robot}", filtered.pixels.len());
        assert!(filtered.warnings.is_empty(), "{:?}", filtered.warnings);
        assert_eq!(depth.readings(), CAMERA.width * CAMERA.height - on_robot);
    }

    #[test]
    fn a_robot_beside_its_place_is_told_and_taken_out_all_the_same() {
        let (mut depth, on_robot) = seen(&robot([0.0, 0.03, 0.0]));
        let pose = world_from_camera();
        let filtered = remove(&mut depth, &CAMERA, &[robot([0.0; 3])], Some(&pose), &SelfFilterSettings::default());
        assert_eq!(filtered.warnings.len(), 1);
        assert_eq!(filtered.warnings[0].field, "world_from_camera");
        assert!(filtered.pixels.len() * 100 >= on_robot * 97, "{} of {on_robot}", filtered.pixels.len());
    }

    #[test]
    fn without_the_cameras_pose_or_for_an_unknown_robot_the_filter_says_that_it_cannot() {
        let (depth, _) = seen(&robot([0.0; 3]));
        let pose = world_from_camera();
        let unknown = RobotInView { model: "other".to_owned(), ..robot([0.0; 3]) };
        for (robot, pose, field) in [(robot([0.0; 3]), None, "world_from_camera"), (unknown, Some(&pose), "robots[0]")] {
            let mut left = depth.clone();
            let filtered = remove(&mut left, &CAMERA, &[robot], pose, &SelfFilterSettings::default());
            assert_eq!((filtered.pixels.len(), filtered.warnings[0].field.as_str()), (0, field));
        }
    }
}
