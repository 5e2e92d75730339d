//! The readings of a picture that lie near a robot's body.

use nalgebra::Vector3;
use repose_geometry::Pinhole;

use super::body::Ball;
use crate::readings::depth::DepthMap;

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
