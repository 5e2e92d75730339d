//! How far a robot is seen from where its state and the camera's calibration put it.
//!
//! The readings near the robot are laid onto the balls of its body by a shift: least squares of their distances to the balls, with
//! weights that let far ones go (Cauchy), as in iterative closest point. The balls are a little larger than the body, so that a common
//! distance is fitted too, held near zero: from one side a larger body and one nearer to the camera look alike. Along a link a shift shows at
//! its ends only, where readings are first taken for another ball's; so a shift that is found is applied and the rest of it looked for.

use nalgebra::{Matrix4, Vector3, Vector4};
use repose_geometry::Pinhole;

use super::body::Ball;
use super::nearness::Nearness;
use crate::readings::depth::DepthMap;
use crate::settings::SelfFilterSettings;

/// Fewer readings near the robot say nothing of where it is.
const LEAST_READINGS: usize = 400;
/// Rounds of least squares; the last changes the shift by less than a tenth of a millimetre.
const ROUNDS: usize = 8;
/// Distance at which a reading counts half, metres.
const HALF_WEIGHT_M: f32 = 0.015;
/// How firmly the common distance is held near zero, as so many readings' worth of 1.
const HOLD: f32 = 0.3;

/// Times that the rest of a shift is looked for, and the rest that is none, metres: a good calibration costs no further look.
const LOOKS: usize = 4;
const NO_REST_M: f32 = 0.003;

/// The shift of the seen robot from where it should be, camera frame, metres; `None` where too little of it is seen. `near` are the readings
/// near `balls`.
pub fn offset(near: &Nearness, depth: &DepthMap, camera: &Pinhole, balls: &[Ball], settings: &SelfFilterSettings) -> Option<Vector3<f32>> {
    let mut rest = fitted(near, settings)?;
    let mut offset = rest;
    for _ in 0..LOOKS {
        if rest.norm() <= NO_REST_M {
            break;
        }
        let moved: Vec<Ball> = balls.iter().map(|ball| Ball { center: ball.center + offset, ..*ball }).collect();
        let Some(found) = fitted(&Nearness::new(depth, camera, &moved, settings.look_m), settings) else { break };
        rest = found;
        offset += rest;
    }
    Some(offset)
}

/// The shift by which readings fit the balls that they are nearest to.
fn fitted(near: &Nearness, settings: &SelfFilterSettings) -> Option<Vector3<f32>> {
    let pixels = || near.pixels.iter().filter(|pixel| pixel.distance_m.abs() <= settings.look_m);
    let count = pixels().count();
    // A camera that leaves the robot out sees what is behind it; the little that is near its place is something else.
    if count < LEAST_READINGS || near.met < near.expected / 2 {
        return None;
    }
    // Shift, then the common distance.
    let mut fitted = Vector4::<f32>::zeros();
    for _ in 0..ROUNDS {
        let mut normal = Matrix4::<f32>::zeros();
        let mut right = Vector4::<f32>::zeros();
        for pixel in pixels() {
            let row = pixel.outward.push(1.0);
            let residual = pixel.distance_m - row.dot(&fitted);
            let weight = 1.0 / (1.0 + (residual / HALF_WEIGHT_M).powi(2));
            normal += row * row.transpose() * weight;
            right += row * (pixel.distance_m * weight);
        }
        normal[(3, 3)] += HOLD * count as f32;
        fitted = normal.try_inverse()? * right;
    }
    Some(fitted.xyz())
}
