//! Whether a problem has an answer at all: a search with the whole truth in hand.
//!
//! Random positions around the anchor, set down on every height at which something could carry the object, tested by rule and overlap
//! first and by a release then. A problem counts as feasible when one of them is a joint success in the camera's view.

use nalgebra::{Isometry3, Point3, Translation3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use repose_relations::{TrueObject, ground_truth};
use repose_simulator::release::{ReleaseSettings, penetration_of};

use crate::Problem;
use crate::outcome::{PENETRATION_M, judge};

/// How hard the truth is searched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeasibleSettings {
    /// Positions drawn.
    pub draws: usize,
    /// Releases tried.
    pub releases: usize,
    /// How far from the anchor positions are drawn, metres.
    pub reach_m: f64,
}

impl Default for FeasibleSettings {
    fn default() -> Self {
        Self { draws: 600, releases: 12, reach_m: 0.45 }
    }
}

/// A placement that succeeds, if the search finds one: `placed_from_observed`.
pub fn true_answer(problem: &Problem, settings: &FeasibleSettings, release: &ReleaseSettings) -> Option<Isometry3<f64>> {
    let (query, anchor) = (problem.index_of(problem.query)?, problem.index_of(problem.goal.anchor)?);
    let scene = &problem.truth;
    let (moved, fixed) = (&scene.objects[query], &scene.objects[anchor]);
    let bounds = moved.shape.bounds(&moved.world_from_object);
    let anchor_bounds = fixed.shape.bounds(&fixed.world_from_object);
    let bottom_m = bounds.corners().iter().map(|c| c.z).fold(f64::INFINITY, f64::min);
    let mut heights: Vec<f64> = scene.surfaces.iter().map(repose_simulator::scene::SupportSurface::height_m).collect();
    let tops = scene.objects.iter().filter(|o| o.id != problem.query).map(|o| o.shape.bounds(&o.world_from_object));
    heights.extend(tops.map(|b| b.corners().iter().map(|c| c.z).fold(f64::NEG_INFINITY, f64::max)));
    let camera_from_world = problem.world_from_camera.inverse();
    let mut rng = Pcg64::seed_from_u64(problem.seed ^ 0xfea5);
    let mut releases = 0;
    for _ in 0..settings.draws {
        let mut offset = || rng.random_range(-settings.reach_m..settings.reach_m);
        let target = anchor_bounds.center() + nalgebra::Vector3::new(offset(), offset(), 0.0);
        let height_m = heights[rng.random_range(0..heights.len())];
        // A millimetre of air: the release lets it down.
        let rise = height_m - bottom_m + 0.001;
        let shift = target - bounds.center();
        let placed_from_observed = Isometry3::from_parts(Translation3::new(shift.x, shift.y, rise), nalgebra::UnitQuaternion::identity());
        let there = bounds.transformed(&placed_from_observed);
        let seen = problem.camera.pixel_of(&(camera_from_world * Point3::from(there.center().coords)));
        let gap_m = 1.0; // Directions do not ask for the distance; the release below judges everything.
        let holds = ground_truth(&TrueObject { bounds: there }, &TrueObject { bounds: anchor_bounds }, gap_m, &problem.viewer);
        if seen.is_none() || holds[problem.goal.relation.index()] != problem.goal.holds {
            continue;
        }
        if penetration_of(scene, query, &(placed_from_observed * moved.world_from_object)) > PENETRATION_M {
            continue;
        }
        releases += 1;
        if judge(problem, &placed_from_observed, release).is_some_and(|j| j.joint()) {
            return Some(placed_from_observed);
        }
        if releases >= settings.releases {
            break;
        }
    }
    None
}
