//! Which places the camera saw to be empty.
//!
//! A place is known to be free where the camera saw something behind it; what lies behind a seen surface may be anything, the far half of the
//! object to be grasped above all. The cloud is entered into a picture taken from where the camera stood, nearest point a cell.

use nalgebra::{Isometry3, Point3, Vector3};
use repose_geometry::transform::look_at;

/// A coarse depth picture of the cloud.
#[derive(Debug, Clone)]
pub struct Sight {
    picture_from_world: Isometry3<f32>,
    low: [f32; 2],
    size: [usize; 2],
    /// Depth of the nearest point in each cell, metres; infinite where none fell in.
    nearest_m: Vec<f32>,
}

/// Edge of a cell, in units of tangent: 4 mm at one metre.
const CELL: f32 = 0.004;
/// How much further than a place what was seen behind it must be, metres.
const BEHIND_M: f32 = 0.008;
/// The widest picture, cells along each side.
const SIDE_MAX: usize = 1024;

impl Sight {
    /// What a camera at `eye` saw of `points`, both in the world frame. Without points nothing is known to be free.
    pub fn new(eye: &Point3<f64>, points: &[Point3<f32>]) -> Self {
        let middle = repose_geometry::cloud::centroid(points).unwrap_or_else(|| eye + Vector3::x());
        let forward = middle - eye;
        let up = if forward.xy().norm() < 1e-3 * forward.norm() { Vector3::x() } else { Vector3::z() };
        let middle = if forward.norm() < 1e-9 { eye + Vector3::x() } else { middle };
        let picture_from_world = look_at(eye, &middle, &up).inverse().cast::<f32>();
        let mut sight = Self { picture_from_world, low: [0.0; 2], size: [0; 2], nearest_m: Vec::new() };
        let seen: Vec<[f32; 3]> = points.iter().filter_map(|p| sight.project(p)).collect();
        for k in 0..2 {
            let low = seen.iter().map(|s| s[k]).fold(f32::INFINITY, f32::min);
            let high = seen.iter().map(|s| s[k]).fold(f32::NEG_INFINITY, f32::max);
            sight.low[k] = low;
            sight.size[k] = if low <= high { (((high - low) / CELL) as usize + 1).min(SIDE_MAX) } else { 0 };
        }
        sight.nearest_m = vec![f32::INFINITY; sight.size[0] * sight.size[1]];
        for s in seen {
            if let Some([u, v]) = sight.cell(&s) {
                let nearest = &mut sight.nearest_m[v * sight.size[0] + u];
                *nearest = nearest.min(s[2]);
            }
        }
        sight
    }

    /// Whether the camera saw past `place` (world frame).
    ///
    /// Cells in which nothing was seen (borders of objects are cleaned away) take the word of the nearest thing around them.
    pub fn is_free(&self, place: &Point3<f64>) -> bool {
        let Some(projected) = self.project(&place.cast::<f32>()) else { return false };
        let Some([u, v]) = self.cell(&projected) else { return false };
        for ring in 0..=2usize {
            let mut nearest = f32::INFINITY;
            for y in v.saturating_sub(ring)..=(v + ring).min(self.size[1] - 1) {
                for x in u.saturating_sub(ring)..=(u + ring).min(self.size[0] - 1) {
                    nearest = nearest.min(self.nearest_m[y * self.size[0] + x]);
                }
            }
            if nearest.is_finite() {
                return nearest > projected[2] + BEHIND_M;
            }
        }
        false
    }

    /// Tangents to the right and down, and depth; nothing for what is behind the camera.
    fn project(&self, point: &Point3<f32>) -> Option<[f32; 3]> {
        let p = self.picture_from_world * point;
        (p.z > 0.05).then(|| [p.x / p.z, p.y / p.z, p.z])
    }

    fn cell(&self, projected: &[f32; 3]) -> Option<[usize; 2]> {
        let mut cell = [0; 2];
        for k in 0..2 {
            let at = (projected[k] - self.low[k]) / CELL;
            if !(at >= 0.0 && at < self.size[k] as f32) {
                return None;
            }
            cell[k] = at as usize;
        }
        Some(cell)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    #[test]
    fn before_and_beside_an_object_is_free_and_behind_it_is_not_known() {
        let mut points = synthetic::table_points();
        points.extend(synthetic::seen_box([0.5, 0.0], [0.05, 0.05, 0.1], 0.0));
        let sight = Sight::new(&synthetic::CAMERA, &points);
        assert!(sight.is_free(&Point3::new(0.56, 0.0, 0.05)), "towards the camera");
        assert!(sight.is_free(&Point3::new(0.5, 0.06, 0.05)) && sight.is_free(&Point3::new(0.5, -0.06, 0.05)), "to both sides");
        assert!(!sight.is_free(&Point3::new(0.45, 0.0, 0.05)), "behind");
        assert!(!sight.is_free(&Point3::new(0.5, 0.0, 0.05)), "inside");
        assert!(!sight.is_free(&Point3::new(3.0, 0.0, 0.05)), "behind the camera");
    }

    #[test]
    fn without_points_nothing_is_known() {
        assert!(!Sight::new(&synthetic::CAMERA, &[]).is_free(&Point3::new(0.5, 0.0, 0.3)));
    }
}
