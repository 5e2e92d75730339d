//! Handles of cups and pots: loops in the xz plane whose ends disappear in a wall.

use nalgebra::{Point3, Vector3};

use super::super::bar::BarSection;
use super::super::body::Body;
use super::super::outline::{ProfilePoint, radius_at};
use super::draw::Draw;

/// A loop's form: points of (share of the reach, share of the height), from below upwards.
type Form = &'static [[f32; 2]];

const ROUND: Form = &[[0.45, 0.06], [0.8, 0.2], [1.0, 0.5], [0.8, 0.8], [0.45, 0.94]];
const SQUARE: Form = &[[0.85, 0.02], [1.0, 0.15], [1.0, 0.85], [0.85, 0.98]];
const EAR: Form = &[[0.35, 0.22], [0.7, 0.45], [0.97, 0.68], [0.93, 0.88], [0.6, 0.98]];
const D: Form = &[[0.35, 0.12], [0.7, 0.32], [0.93, 0.6], [0.97, 0.85], [0.8, 0.97]];
const DROP: Form = &[[0.6, 0.04], [0.95, 0.18], [0.97, 0.35], [0.7, 0.6], [0.35, 0.82]];

/// Adds one handle, or two across from each other, to a wall of the given outer profile.
pub fn add_handles(body: &mut Body, outer: &[ProfilePoint], wall: f32, count: usize, draw: &mut Draw) {
    let height = outer[outer.len() - 1][1];
    let form = draw.pick(&[ROUND, ROUND, SQUARE, EAR, D, DROP]);
    let (low, high) = (height * draw.between(0.12, 0.25), height * draw.between(0.74, 0.9));
    let reach = draw.between(0.3, 0.5) * (high - low);
    let thickness = draw.thickness(0.003, 0.0048);
    let section = match draw.whole(0, 2) {
        0 => BarSection::round(thickness),
        1 => BarSection::oval(thickness * draw.between(1.2, 1.9), thickness * 0.85),
        _ => BarSection::flat(thickness * draw.between(1.2, 2.0), thickness * 0.75),
    };
    for turned in 0..count {
        let side = if turned == 0 { 1.0 } else { -1.0 };
        let at = |x: f32, z: f32| Point3::new(side * x, 0.0, z);
        let wall_at = |z: f32| radius_at(outer, z);
        // The stubs are level, so that the ends neither show inside the cup nor leave a gap.
        let stub = thickness * 0.9;
        let mut path = vec![at(wall_at(low) - wall * 0.5, low), at(wall_at(low) + stub, low)];
        for &[out, up] in form {
            let z = low + (high - low) * up;
            // A bulging wall must not swallow the loop.
            path.push(at(wall_at(z).max(wall_at(low).min(wall_at(high))) + stub + (reach - stub).max(stub) * out, z));
        }
        path.extend([at(wall_at(high) + stub, high), at(wall_at(high) - wall * 0.5, high)]);
        body.bar(&path, Vector3::y_axis(), &section);
    }
}
