//! The answers among what passed: ranked, and apart from each other.

use crate::judge::judged::JudgedCandidate;
use crate::search::levels::by_level;
use crate::search::ranking::are_apart;

/// The best candidates, no two closer than `min_separation_m` nor the same, at most `count`; of equals the first drawn.
///
/// Where several are wanted, half of them may be the best of other levels of support than the first's, so that both the table and the
/// box are among them; they are in the order of their cost all the same.
pub fn distinct(accepted: &[JudgedCandidate], count: usize, min_separation_m: f64, level_gap_m: f32) -> Vec<JudgedCandidate> {
    distinct_places(accepted, count, min_separation_m, level_gap_m).into_iter().map(|i| accepted[i].clone()).collect()
}

/// [`distinct`], by position.
pub fn distinct_places(accepted: &[JudgedCandidate], count: usize, min_separation_m: f64, level_gap_m: f32) -> Vec<usize> {
    let levels = by_level(accepted, level_gap_m);
    let best_of_levels = levels.iter().map(|level| level[0]).take(1 + count / 2);
    let mut ranked: Vec<usize> = (0..accepted.len()).collect();
    ranked.sort_by(|a, b| accepted[*a].better(&accepted[*b]));
    let mut chosen: Vec<usize> = Vec::new();
    for i in best_of_levels.chain(ranked) {
        if chosen.len() == count {
            break;
        }
        if chosen.iter().all(|c| are_apart(&accepted[*c].candidate, &accepted[i].candidate, min_separation_m)) {
            chosen.push(i);
        }
    }
    chosen.sort_by(|a, b| accepted[*a].better(&accepted[*b]));
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::candidate::CandidatePose;

    #[test]
    fn answers_keep_their_distance_and_their_rank() {
        let at = |x: f32, cost: f64| {
            let mut j = JudgedCandidate::new(CandidatePose { centroid_m: [x, 0.0, 0.0], yaw_rad: 0.0 }, 0);
            j.cost = cost;
            j
        };
        let accepted = [at(0.0, 3.0), at(0.01, 1.0), at(0.02, 2.0), at(0.06, 4.0)];
        let chosen = distinct(&accepted, 5, 0.03, 0.025);
        assert_eq!(chosen.iter().map(|j| j.cost).collect::<Vec<_>>(), [1.0, 4.0]);
        assert_eq!(distinct(&accepted, 1, 0.0, 0.025).len(), 1);
    }

    #[test]
    fn answers_that_may_be_as_close_as_they_like_are_not_the_same() {
        let at = |x: f32, yaw_rad: f32, cost: f64| {
            let mut j = JudgedCandidate::new(CandidatePose { centroid_m: [x, 0.0, 0.0], yaw_rad }, 0);
            j.cost = cost;
            j
        };
        // The first was drawn twice, and once more turned.
        let accepted = [at(0.0, 0.0, 1.0), at(0.0, 0.0, 1.0), at(0.0, 0.5, 2.0), at(0.001, 0.0, 3.0)];
        let chosen = distinct(&accepted, 4, 0.0, 0.025);
        assert_eq!(chosen.iter().map(|j| j.cost).collect::<Vec<_>>(), [1.0, 2.0, 3.0]);
    }

    #[test]
    fn of_two_answers_one_is_from_the_other_level() {
        let at = |x: f32, z: f32, cost: f64| {
            let mut j = JudgedCandidate::new(CandidatePose { centroid_m: [x, 0.0, z], yaw_rad: 0.0 }, 0);
            j.cost = cost;
            j
        };
        let accepted = [at(0.0, 0.0, 1.0), at(0.1, 0.01, 2.0), at(0.2, 0.0, 3.0), at(0.0, 0.2, 4.0), at(0.1, 0.2, 5.0)];
        let costs = |count: usize| distinct(&accepted, count, 0.03, 0.025).iter().map(|j| j.cost).collect::<Vec<_>>();
        assert_eq!(costs(1), [1.0]);
        assert_eq!(costs(2), [1.0, 4.0]);
        assert_eq!(costs(3), [1.0, 2.0, 4.0]);
    }
}
