//! How far a candidate keeps from everything that does not carry it, by distances between points.

use nalgebra::{Point3, Vector3};
use repose_geometry::{Aabb, cloud};

use crate::belief::shape::Shape;
use crate::scene::candidate::CandidatePose;
use crate::scene::prepared::PreparedScene;
use crate::scene::query::QueryObject;
use crate::settings::SupportSettings;

/// The scene's points without the query's (world frame), one per voxel.
pub fn obstacles(prepared: &PreparedScene, query: &QueryObject, voxel_m: f32) -> Vec<Point3<f32>> {
    let scene = &prepared.scene;
    let others = scene.points.iter().zip(&scene.labels).filter(|(_, label)| **label != query.id);
    let points: Vec<Point3<f32>> = others.map(|(p, _)| Point3::from(*p)).collect();
    cloud::voxel_downsampled(&points, voxel_m)
}

/// The least distance from the placed query's observed points to what is not beneath it, metres, 1 at most.
///
/// `obstacles` are the scene's points without the query's, thinned out; what is less than `same_support_m` above the query's bottom
/// counts as its support.
pub fn exact_clearance_m(query: &QueryObject, candidate: &CandidatePose, obstacles: &[Point3<f32>], support: &SupportSettings) -> f64 {
    let floor_m = query.bottom_of(candidate.centroid_m[2]) + support.same_support_m;
    least_distance_m(&placed(&query.cloud, query, candidate), obstacles, floor_m, 1.0)
}

/// What clearances wider than the cells around the query reach are measured with: completed shapes as points, world frame.
#[derive(Debug, Clone)]
pub struct WideClearance {
    /// The query where it was observed.
    query: Vec<Point3<f32>>,
    /// Everything else but what may be touched.
    obstacles: Vec<Point3<f32>>,
}

impl WideClearance {
    /// Points `voxel_m` apart. As for the cells, `touched` objects do not count.
    pub fn new(prepared: &PreparedScene, query: &QueryObject, touched: &[u16], voxel_m: f32) -> Self {
        let counts = |id: u16| id != query.id && !touched.contains(&id);
        let seen = prepared.scene.points.iter().zip(&prepared.scene.labels).filter(|(_, label)| counts(**label));
        let shapes = prepared.objects.iter().filter(|(id, _)| counts(**id)).filter_map(|(_, object)| object.shape.as_ref());
        let obstacles: Vec<Point3<f32>> = seen.map(|(p, _)| Point3::from(*p)).chain(shapes.flat_map(|s| sides(s, voxel_m))).collect();
        Self {
            query: query.cloud.iter().copied().chain(sides(&query.shape, voxel_m)).collect(),
            obstacles: cloud::voxel_downsampled(&obstacles, voxel_m),
        }
    }

    /// The least distance from the placed query to what does not carry it, metres, `most_m` at most.
    pub fn of(&self, query: &QueryObject, candidate: &CandidatePose, support: &SupportSettings, most_m: f64) -> f64 {
        let floor_m = query.bottom_of(candidate.centroid_m[2]) + support.tolerance_m;
        least_distance_m(&placed(&self.query, query, candidate), &self.obstacles, floor_m, most_m)
    }
}

/// Points over the sides of a completed shape, at most `step_m` apart, world frame.
fn sides(shape: &Shape, step_m: f32) -> Vec<Point3<f32>> {
    let mut points = Vec::new();
    for slab in &shape.slabs {
        let rises = ((slab.high_m - slab.low_m) / step_m).ceil().max(1.0);
        let corners = slab.outline.corners();
        for (a, b) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            let steps = ((b - a).norm() / step_m).ceil().max(1.0);
            for (step, rise) in (0..steps as usize).flat_map(|s| (0..=rises as usize).map(move |r| (s as f32, r as f32))) {
                let at = a + (b - a) * (step / steps);
                points.push(Point3::new(at.x, at.y, slab.low_m + (slab.high_m - slab.low_m) * (rise / rises)));
            }
        }
    }
    points
}

/// Points of the query where a candidate puts them.
fn placed(observed: &[Point3<f32>], query: &QueryObject, candidate: &CandidatePose) -> Vec<Point3<f32>> {
    let placed_from_observed = candidate.placed_from_observed(&query.shape.centroid).cast::<f32>();
    observed.iter().map(|p| placed_from_observed * p).collect()
}

/// The least distance from a point of `placed` to an obstacle above a height, metres, `most_m` at most.
fn least_distance_m(placed: &[Point3<f32>], obstacles: &[Point3<f32>], floor_m: f32, most_m: f64) -> f64 {
    let Some(bounds) = Aabb::of(placed) else { return most_m };
    let most = most_m as f32;
    let mut best = most;
    for obstacle in obstacles.iter().filter(|p| p.z > floor_m) {
        let gap = (bounds.min - obstacle).sup(&(obstacle - bounds.max)).sup(&Vector3::zeros());
        if gap.norm_squared() >= best * best {
            continue;
        }
        let nearest = placed.iter().map(|p| (p - obstacle).norm_squared()).fold(f32::INFINITY, f32::min);
        best = best.min(nearest.sqrt());
    }
    if best < most { f64::from(best) } else { most_m }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Fixed;
    use crate::tests::synthetic::{SceneBuilder, standing_at};

    #[test]
    fn the_clearance_of_an_answer_is_the_gap_to_the_next_thing() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.12]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let candidate = standing_at(&query, 0.13, 0.0, 0.0);
        let clearance_m = exact_clearance_m(&query, &candidate, &obstacles(&prepared, &query, 0.004), &fixed.support);
        assert!((clearance_m - 0.05).abs() < 0.006, "{clearance_m}");
    }
}
