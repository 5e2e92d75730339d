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
}

impl Nearness {
    /// Looks at the part of the picture that each ball, grown by `reach_m`, can cover.
    pub fn new(depth: &DepthMap, camera: &Pinhole, balls: &[Ball], reach_m: f32) -> Self {
        let (width, height) = (depth.width(), depth.height());
        let mut nearest: Vec<(f32, u32)> = vec![(f32::INFINITY, 0); width * height];
        for (k, ball) in balls.iter().enumerate() {
            let Some([columns, rows]) = covered(camera, ball, ball.radius_m + reach_m) else { continue };
            for v in rows {
                for u in columns.clone() {
                    let distance = (depth.point(u, v) - ball.center).norm() - ball.radius_m;
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
        Self { pixels: pixels.collect() }
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
