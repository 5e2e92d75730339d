//! One answer with its evidence.

use repose_geometry::transform;
use repose_proto::place::Placement;
use repose_proto::{Relation, RigidTransform};

use crate::checks::clearance::Clearance;
use crate::judge::judged::JudgedCandidate;
use crate::judge::problem::PlacementProblem;

/// Gathers what an answer says of itself.
#[derive(Debug)]
pub struct Evidence<'a> {
    problem: PlacementProblem<'a>,
    clearance: Clearance<'a>,
}

impl<'a> Evidence<'a> {
    /// Evidence for one problem's answers.
    pub fn new(problem: PlacementProblem<'a>) -> Self {
        let touched = problem.anchors_of(&[Relation::Touching]);
        Self { problem, clearance: Clearance::new(problem.prepared, problem.query, &problem.settings.fixed, touched) }
    }

    /// The answer that a candidate makes.
    pub fn placement(&self, judged: &JudgedCandidate) -> Placement {
        let PlacementProblem { query, rules, .. } = self.problem;
        let candidate = &judged.candidate;
        let let_go = self.problem.let_go(candidate);
        let checks = judged.checks.clone().unwrap_or_else(|| rules.checks(candidate));
        let by_rule = || checks.iter().map(|c| if c.holds { 1.0 } else { 0.0 }).collect();
        let footing = judged.footing.unwrap_or_else(|| self.problem.ground().footing(candidate));
        Placement {
            placed_from_observed: RigidTransform(transform::to_row_major(&let_go.placed_from_observed(&query.shape.centroid))),
            cost: judged.cost,
            realism: judged.realism.map(f64::from),
            success: judged.success,
            relations: judged.relations.as_ref().map_or_else(by_rule, |p| p.iter().map(|p| f64::from(*p)).collect()),
            geometric: checks,
            support_m: footing.margin_m,
            clearance_m: self.clearance.of(candidate),
        }
    }
}
