//! Random orientations.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};

/// A rotation turned further about world z by a random angle.
pub fn yawed(rotation: UnitQuaternion<f64>, rng: &mut impl Rng) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(-std::f64::consts::PI..std::f64::consts::PI)) * rotation
}

/// Onto one of the sides, or upside down if that is `turned_over`: nobody stands a bottle on its cap.
pub fn lying(turned_over: bool, rng: &mut impl Rng) -> UnitQuaternion<f64> {
    const QUARTER: f64 = std::f64::consts::FRAC_PI_2;
    match rng.random_range(if turned_over { 0..5 } else { 1..5 }) {
        0 => UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
        1 | 2 => UnitQuaternion::from_axis_angle(&Vector3::x_axis(), QUARTER),
        _ => UnitQuaternion::from_axis_angle(&Vector3::y_axis(), QUARTER),
    }
}

/// Uniform over all rotations (Shoemake: a random unit quaternion).
pub fn any(rng: &mut impl Rng) -> UnitQuaternion<f64> {
    let (u, a, b) =
        (rng.random_range(0.0..1.0f64), rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(0.0..std::f64::consts::TAU));
    let (p, q) = ((1.0 - u).sqrt(), u.sqrt());
    UnitQuaternion::new_normalize(Quaternion::new(q * b.cos(), p * a.sin(), p * a.cos(), q * b.sin()))
}
