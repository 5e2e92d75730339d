//! One answer with its evidence.

use nalgebra::Point3;
use repose_geometry::transform;
use repose_proto::RigidTransform;
use repose_proto::place::Placement;

use crate::checks::clearance::{exact_clearance_m, obstacles};
use crate::judge::judged::JudgedCandidate;
use crate::judge::problem::PlacementProblem;

/// Says of candidates what an answer says of itself.
#[derive(Debug)]
pub struct Evidence<'a> {
    problem: PlacementProblem<'a>,
    /// The scene's points without the query's, thinned out.
    obstacles: Vec<Point3<f32>>,
}

impl<'a> Evidence<'a> {
    /// Evidence for one problem's answers.
    pub fn new(problem: PlacementProblem<'a>) -> Self {
        let obstacles = obstacles(problem.prepared, problem.query, problem.settings.fixed.clearance.voxel_m);
        Self { problem, obstacles }
    }

    /// The answer that a candidate makes.
    pub fn placement(&self, judged: &JudgedCandidate) -> Placement {
        let PlacementProblem { query, rules, settings, .. } = self.problem;
        let candidate = &judged.candidate;
        let checks = judged.checks.clone().unwrap_or_else(|| rules.checks(query, candidate, &settings.fixed.rules));
        let by_rule = || checks.iter().map(|c| if c.holds { 1.0 } else { 0.0 }).collect();
        let footing = judged.footing.unwrap_or_else(|| self.problem.ground().footing(candidate));
        Placement {
            placed_from_observed: RigidTransform(transform::to_row_major(&candidate.placed_from_observed(&query.shape.centroid))),
            cost: judged.cost,
            realism: judged.realism.map_or(1.0, f64::from),
            relations: judged.relations.as_ref().map_or_else(by_rule, |p| p.iter().map(|p| f64::from(*p)).collect()),
            geometric: checks,
            support_m: footing.margin_m,
            clearance_m: exact_clearance_m(query, candidate, &self.obstacles, &settings.fixed.support),
        }
    }
}
