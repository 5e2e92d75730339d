//! What is not seen of an object: its middle, and its far side.
//!
//! One camera sees the near half. Most things that people set down look alike from opposite sides, so the far half is taken to be what was seen,
//! turned by half a turn about the vertical through the middle: right for boxes, cans and bowls, and within the same bounds for anything else.

use nalgebra::{Point3, Vector3};
use repose_geometry::Aabb;

/// Where the middle of what was seen within `bounds` is taken to be: `hidden_m` further from the camera, on the level.
pub fn middle(bounds: &Aabb, camera_in_world: &Point3<f64>, hidden_m: f64) -> Point3<f64> {
    let seen = bounds.center().cast::<f64>();
    let away = seen - camera_in_world;
    seen + Vector3::new(away.x, away.y, 0.0).try_normalize(1e-9).unwrap_or_else(Vector3::zeros) * hidden_m
}

/// The points and, after them, their likenesses on the far side of the vertical through `middle`.
pub fn completed(points: &[Point3<f32>], middle: &Point3<f64>) -> Vec<Point3<f32>> {
    let [x, y] = [2.0 * middle.x as f32, 2.0 * middle.y as f32];
    points.iter().copied().chain(points.iter().map(|p| Point3::new(x - p.x, y - p.y, p.z))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    #[test]
    fn the_far_side_of_a_box_is_where_it_was_not_seen() {
        let points = synthetic::seen_box([0.5, 0.1], [0.12, 0.05, 0.10], 0.4);
        let bounds = Aabb::of(&points).expect("points");
        let whole = completed(&points, &middle(&bounds, &synthetic::CAMERA, 0.0));
        // The middles of the four upright faces of a box of that size, turned by 0.4 rad.
        let (sin, cos) = 0.4f64.sin_cos();
        for (u, v) in [(0.06, 0.0), (-0.06, 0.0), (0.0, 0.025), (0.0, -0.025)] {
            let face = Point3::new(0.5 + cos * u - sin * v, 0.1 + sin * u + cos * v, 0.05).cast::<f32>();
            let near = |cloud: &[Point3<f32>]| cloud.iter().any(|p| (p - face).norm() < 0.012);
            assert!(near(&whole), "face at {u}, {v}; seen {}", near(&points));
        }
        assert_eq!(whole.len(), 2 * points.len());
    }
}
