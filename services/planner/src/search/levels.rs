//! Levels of support: groups of candidates at about one height.

use crate::judge::judged::JudgedCandidate;

/// Sorts candidates into levels: heights with gaps larger than `gap_m` between them.
pub fn assign_levels(judged: &mut [JudgedCandidate], gap_m: f32) {
    let mut order: Vec<usize> = (0..judged.len()).collect();
    let height = |j: &JudgedCandidate| j.candidate.centroid_m[2];
    order.sort_by(|a, b| height(&judged[*a]).total_cmp(&height(&judged[*b])).then(a.cmp(b)));
    let mut level = 0;
    let mut last = f32::NEG_INFINITY;
    for i in order {
        let at = height(&judged[i]);
        if last.is_finite() && at - last > gap_m {
            level += 1;
        }
        judged[i].mode = level;
        last = at;
    }
}

/// Candidates by level of support, by position: heights with gaps larger than `gap_m` between them are levels. Levels and what is on
/// them come best first, of equals the first drawn.
pub fn by_level(candidates: &[JudgedCandidate], gap_m: f32) -> Vec<Vec<usize>> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::candidate::CandidatePose;

    fn at(x: f32, z: f32, cost: f64) -> JudgedCandidate {
        let mut j = JudgedCandidate::new(CandidatePose { centroid_m: [x, 0.0, z], yaw_rad: 0.0 }, 0);
        j.cost = cost;
        j
    }

    #[test]
    fn heights_with_a_gap_between_them_are_levels() {
        let mut judged = vec![at(0.0, 0.30, 0.0), at(0.0, 0.02, 0.0), at(0.0, 0.03, 0.0), at(0.0, 0.31, 0.0)];
        assign_levels(&mut judged, 0.025);
        assert_eq!(judged.iter().map(|j| j.mode).collect::<Vec<_>>(), [1, 0, 0, 1]);
    }

    #[test]
    fn levels_and_their_members_come_best_first() {
        let candidates = [at(0.0, 0.0, 1.0), at(0.1, 0.01, 2.0), at(0.2, 0.0, 3.0), at(0.0, 0.2, 4.0), at(0.1, 0.2, 5.0)];
        assert_eq!(by_level(&candidates, 0.025), [vec![0, 1, 2], vec![3, 4]]);
    }
}
