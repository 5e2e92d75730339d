//! Takes the readings of robots out of a depth picture, and says how well the robots are where they are said to be.
//!
//! A reading belongs to a robot when it lies in one of the balls that its body fills, grown by a margin for errors of calibration and
//! noise. What lies behind the arm has no reading in those pixels then, and so is unseen, as behind anything else.

use nalgebra::{Isometry3, Vector3};
use repose_geometry::Pinhole;
use repose_proto::{RobotInView, SceneWarning};

use super::body::{Ball, Body};
use super::calibration;
use crate::readings::depth::DepthMap;
use crate::settings::SelfFilterSettings;

/// What was found of the robots.
#[derive(Debug, Default, PartialEq)]
pub struct FilteredRobots {
    /// The robots whose shape is known.
    pub bodies: Vec<(Body, Option<bool>)>,
    /// Readings taken out.
    pub readings: usize,
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
            let message = "without the camera's pose nobody can tell what shows of the robot from the rest of the picture";
            filtered.warnings.push(SceneWarning { field: "world_from_camera".to_owned(), message: message.to_owned() });
        }
        return filtered;
    };
    let camera_from_world = world_from_camera.inverse();
    for (i, robot) in robots.iter().enumerate() {
        let body = match Body::new(robot, &camera_from_world) {
            Ok(body) => body,
            Err(error) => {
                filtered.warnings.push(SceneWarning { field: format!("robots[{i}]"), message: error.to_string() });
                continue;
            }
        };
        let near = Nearness::new(depth, camera, &body.balls, settings.look_m);
        let offset_m = calibration::offset(&near, settings);
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
            let z = &mut depth.depth_m_mut().pixels_mut()[pixel.index];
            filtered.readings += usize::from(!z.is_nan());
            *z = f32::NAN;
        }
        filtered.bodies.push((body, robot.holding));
    }
    filtered
}

/// A reading near a robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearPixel {
    /// Its place in the picture, row by row.
    pub index: usize,
    /// How far outside the nearest ball it lies, metres; negative inside.
    pub distance_m: f32,
    /// From that ball's centre to the reading, length 1, camera frame.
    pub outward: Vector3<f32>,
}

/// The readings within some distance of a robot's balls.
#[derive(Debug, Clone, PartialEq)]
pub struct Nearness {
    /// In the picture's order.
    pub pixels: Vec<NearPixel>,
    /// Pixels whose rays meet a ball.
    pub expected: usize,
    /// Those of them with a reading near a ball, or without a reading.
    pub met: usize,
}

impl Nearness {
    /// Looks at the part of the picture that each ball, grown by `reach_m`, can cover.
    pub fn new(depth: &DepthMap, camera: &Pinhole, balls: &[Ball], reach_m: f32) -> Self {
        let (width, height) = (depth.width(), depth.height());
        let mut nearest: Vec<(f32, u32)> = vec![(f32::INFINITY, 0); width * height];
        let mut is_expected = vec![false; width * height];
        for (k, ball) in balls.iter().enumerate() {
            let Some([columns, rows]) = covered(camera, ball, ball.radius_m + reach_m) else { continue };
            for v in rows {
                for u in columns.clone() {
                    let distance = (depth.point(u, v) - ball.center).norm() - ball.radius_m;
                    let ray = Vector3::new(depth.slope_x()[u], depth.slope_y()[v], 1.0);
                    let along = ray.dot(&ball.center.coords);
                    let beside = ball.center.coords.norm_squared() - along * along / ray.norm_squared();
                    is_expected[v * width + u] |= along > 0.0 && beside < ball.radius_m * ball.radius_m;
                    let slot = &mut nearest[v * width + u];
                    // False without a reading.
                    if distance < slot.0 {
                        *slot = (distance, k as u32);
                    }
                }
            }
        }
        let near = nearest.iter().enumerate().filter(|(_, (distance_m, _))| *distance_m <= reach_m);
        let pixels = near.map(|(index, (distance_m, k))| NearPixel {
            index,
            distance_m: *distance_m,
            outward: (depth.point(index % width, index / width) - balls[*k as usize].center).normalize(),
        });
        let pixels: Vec<NearPixel> = pixels.collect();
        let expected = is_expected.iter().filter(|expected| **expected).count();
        let without = is_expected.iter().zip(depth.depth_m().pixels()).filter(|(expected, z)| **expected && z.is_nan()).count();
        let met = without + pixels.iter().filter(|pixel| is_expected[pixel.index]).count();
        Self { pixels, expected, met }
    }
}

/// Columns and rows of the picture in which something within `reach_m` of a ball's centre can show.
fn covered(camera: &Pinhole, ball: &Ball, reach_m: f32) -> Option<[std::ops::Range<usize>; 2]> {
    /// Nearer than this a ball may show anywhere, metres.
    const NEAR_M: f32 = 0.05;
    let center = &ball.center;
    if center.z + reach_m <= 0.0 {
        return None;
    }
    let depths = [(center.z - reach_m).max(NEAR_M), center.z + reach_m];
    let range = |middle: f32, focal: f64, offset: f64, pixels: usize| {
        let ends = [middle - reach_m, middle + reach_m].map(|at| depths.map(|z| f64::from(at / z) * focal + offset));
        let low = ends.as_flattened().iter().copied().fold(f64::INFINITY, f64::min).floor().clamp(0.0, pixels as f64);
        let high = ends.as_flattened().iter().copied().fold(f64::NEG_INFINITY, f64::max).ceil().clamp(-1.0, pixels as f64 - 1.0);
        low as usize..(high + 1.0) as usize
    };
    let ranges = [range(center.x, camera.fx, camera.cx, camera.width), range(center.y, camera.fy, camera.cy, camera.height)];
    ranges.iter().all(|range| !range.is_empty()).then_some(ranges)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use repose_geometry::transform::{look_at, to_row_major};
    use repose_proto::RigidTransform;

    use super::*;

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
        let body = Body::new(robot, &world_from_camera().inverse()).unwrap();
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
        assert!(on_robot > 3000 && filtered.readings == on_robot, "{} of {on_robot}", filtered.readings);
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
        assert!(filtered.readings * 100 >= on_robot * 97, "{} of {on_robot}", filtered.readings);
    }

    #[test]
    fn without_the_cameras_pose_or_for_an_unknown_robot_the_filter_says_that_it_cannot() {
        let (depth, _) = seen(&robot([0.0; 3]));
        let pose = world_from_camera();
        let unknown = RobotInView { model: "other".to_owned(), ..robot([0.0; 3]) };
        for (robot, pose, field) in [(robot([0.0; 3]), None, "world_from_camera"), (unknown, Some(&pose), "robots[0]")] {
            let mut left = depth.clone();
            let filtered = remove(&mut left, &CAMERA, &[robot], pose, &SelfFilterSettings::default());
            assert_eq!((filtered.readings, filtered.warnings[0].field.as_str()), (0, field));
        }
    }
}
