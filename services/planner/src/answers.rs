//! From accepted candidates to answers: ranked, distinct, each with its evidence.

use repose_geometry::transform;
use repose_proto::RigidTransform;
use repose_proto::place::Placement;

use crate::judge::Judge;
use crate::judged::Judged;
use crate::obstruction::exact_clearance_m;

/// The best candidates, no two closer than `min_separation_m`, at most `count`; of equals the first drawn.
///
/// Where several are wanted, half of them may be the best of other levels of support than the first's, so that both the table and the
/// box are among them; they are in the order of their cost all the same.
pub fn distinct(accepted: &[Judged], count: usize, min_separation_m: f64, level_gap_m: f32) -> Vec<Judged> {
    let levels = by_level(accepted, level_gap_m);
    let best_of_levels = levels.iter().map(|level| level[0]).take(1 + count / 2);
    let mut ranked: Vec<usize> = (0..accepted.len()).collect();
    ranked.sort_by(|a, b| accepted[*a].better(&accepted[*b]));
    let mut chosen: Vec<&Judged> = Vec::new();
    for j in best_of_levels.chain(ranked).map(|i| &accepted[i]) {
        if chosen.len() == count {
            break;
        }
        let at = j.candidate.centroid();
        if chosen.iter().all(|c| (c.candidate.centroid() - at).norm() >= min_separation_m) {
            chosen.push(j);
        }
    }
    chosen.sort_by(|a, b| a.better(b));
    chosen.into_iter().cloned().collect()
}

/// Candidates by level of support, by position: heights with gaps larger than `gap_m` between them are levels. Levels and what is on
/// them come best first, of equals the first drawn.
pub fn by_level(candidates: &[Judged], gap_m: f32) -> Vec<Vec<usize>> {
    let height = |i: usize| candidates[i].candidate.centroid_m[2];
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    order.sort_by(|a, b| height(*a).total_cmp(&height(*b)).then(a.cmp(b)));
    let mut levels: Vec<Vec<usize>> = Vec::new();
    for i in order {
        match levels.last_mut() {
            Some(level) if level.last().is_some_and(|last| height(i) - height(*last) <= gap_m) => level.push(i),
            _ => levels.push(vec![i]),
        }
    }
    let better = |a: &usize, b: &usize| candidates[*a].better(&candidates[*b]).then(a.cmp(b));
    for level in &mut levels {
        level.sort_by(better);
    }
    levels.sort_by(|a, b| better(&a[0], &b[0]));
    levels
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
        let chosen = distinct(&accepted, 5, 0.03, 0.025);
        assert_eq!(chosen.iter().map(|j| j.cost).collect::<Vec<_>>(), [1.0, 4.0]);
        assert_eq!(distinct(&accepted, 1, 0.0, 0.025).len(), 1);
    }

    #[test]
    fn of_two_answers_one_is_from_the_other_level() {
        let at = |x: f32, z: f32, cost: f64| {
            let mut j = Judged::new(Candidate { centroid_m: [x, 0.0, z], yaw_rad: 0.0 }, 0);
            j.cost = cost;
            j
        };
        let accepted = [at(0.0, 0.0, 1.0), at(0.1, 0.01, 2.0), at(0.2, 0.0, 3.0), at(0.0, 0.2, 4.0), at(0.1, 0.2, 5.0)];
        assert_eq!(by_level(&accepted, 0.025), [vec![0, 1, 2], vec![3, 4]]);
        let costs = |count: usize| distinct(&accepted, count, 0.03, 0.025).iter().map(|j| j.cost).collect::<Vec<_>>();
        assert_eq!(costs(1), [1.0]);
        assert_eq!(costs(2), [1.0, 4.0]);
        assert_eq!(costs(3), [1.0, 2.0, 4.0]);
    }
}
