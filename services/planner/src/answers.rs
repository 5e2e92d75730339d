//! From accepted candidates to answers: ranked, distinct, each with its evidence.

use repose_geometry::transform;
use repose_proto::RigidTransform;
use repose_proto::place::Placement;

use crate::judge::Judge;
use crate::judged::Judged;
use crate::obstruction::exact_clearance_m;

/// The best candidates, no two closer than `min_separation_m`, at most `count`; of equals the first drawn.
pub fn distinct(accepted: &[Judged], count: usize, min_separation_m: f64) -> Vec<Judged> {
    let mut ranked: Vec<&Judged> = accepted.iter().collect();
    ranked.sort_by(|a, b| a.better(b));
    let mut chosen: Vec<Judged> = Vec::new();
    for j in ranked {
        if chosen.len() == count {
            break;
        }
        let at = j.candidate.centroid();
        if chosen.iter().all(|c| (c.candidate.centroid() - at).norm() >= min_separation_m) {
            chosen.push(j.clone());
        }
    }
    chosen
}

/// An answer with its evidence; `judged` must be complete ([`Judge::complete`]).
pub fn placement(judged: &Judged, judge: &Judge<'_>) -> Placement {
    let (candidate, query) = (&judged.candidate, judge.query);
    let checks = match &judged.checks {
        Some(checks) => checks.clone(),
        None => judge.rules.checks(query, candidate, &judge.settings.fixed.rules),
    };
    let by_rule = || checks.iter().map(|c| if c.holds { 1.0 } else { 0.0 }).collect();
    let footing = judged.footing.unwrap_or_else(|| judge.ground().footing(candidate));
    Placement {
        placed_from_observed: RigidTransform(transform::to_row_major(&candidate.placed_from_observed(&query.shape.centroid))),
        cost: judged.cost,
        realism: judged.realism.map_or(1.0, f64::from),
        relations: judged.relations.as_ref().map_or_else(by_rule, |p| p.iter().map(|p| f64::from(*p)).collect()),
        geometric: checks,
        support_m: footing.margin_m,
        clearance_m: exact_clearance_m(query, candidate, &judge.obstacles, &judge.settings.fixed.support),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate::Candidate;

    #[test]
    fn answers_keep_their_distance_and_their_rank() {
        let at = |x: f32, cost: f64| {
            let mut j = Judged::new(Candidate { centroid_m: [x, 0.0, 0.0], yaw_rad: 0.0 }, 0);
            j.cost = cost;
            j
        };
        let accepted = [at(0.0, 3.0), at(0.01, 1.0), at(0.02, 2.0), at(0.06, 4.0)];
        let chosen = distinct(&accepted, 5, 0.03);
        assert_eq!(chosen.iter().map(|j| j.cost).collect::<Vec<_>>(), [1.0, 4.0]);
        assert_eq!(distinct(&accepted, 1, 0.0).len(), 1);
    }
}
