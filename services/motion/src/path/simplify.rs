//! Shortens a path: corners are dropped and cut off in turn until little is gained.
//!
//! Dropping corners removes the trees' zigzag; cutting corners off (the refinement step of a quadratic B-spline) pulls what is left taut around
//! obstacles and offers new corners to drop. Shortcuts between random places were tried beside them: they gain half a percent of length for
//! a third more time.

use repose_panda::Joints;

use crate::path::joint_path::{FreeSpace, between, length};

/// How hard to shorten.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimplifySettings {
    /// Rounds of cutting corners off and dropping them. More makes the path shorter and costs time. Default 6.
    pub rounds: usize,
    /// A round that gains less than this share of the length is the last. Default 0.004.
    pub least_gain: f64,
}

impl Default for SimplifySettings {
    fn default() -> Self {
        Self { rounds: 6, least_gain: 0.004 }
    }
}

/// A shorter free path between the same ends.
pub fn simplified(path: &[Joints], settings: &SimplifySettings, space: &impl FreeSpace) -> Vec<Joints> {
    let mut path = reduced(path, space);
    let mut shortest = length(&path);
    for _ in 0..settings.rounds {
        if path.len() < 3 {
            break;
        }
        path = reduced(&without_corners(&path, space), space);
        let shorter = length(&path);
        if shorter > shortest * (1.0 - settings.least_gain) {
            break;
        }
        shortest = shorter;
    }
    path
}

/// Drops corners: from each corner the edge to the furthest corner that is free.
fn reduced(path: &[Joints], space: &impl FreeSpace) -> Vec<Joints> {
    let Some(first) = path.first() else { return Vec::new() };
    let (mut kept, mut at) = (vec![*first], 0);
    while at + 1 < path.len() {
        let next = (at + 2..path.len()).rev().find(|next| space.edge_is_free(&path[at], &path[*next])).unwrap_or(at + 1);
        kept.push(path[next]);
        at = next;
    }
    kept
}

/// Cuts every corner off where that is free: half-way to its neighbours, or else a quarter of the way.
fn without_corners(path: &[Joints], space: &impl FreeSpace) -> Vec<Joints> {
    let mut cut = vec![path[0]];
    for k in 1..path.len() - 1 {
        // From the last place kept, so that cuts of neighbouring corners do not overlap.
        let (before, corner, after) = (cut[cut.len() - 1], path[k], path[k + 1]);
        let offered = [0.5, 0.2].map(|share| (between(&corner, &before, share), between(&corner, &after, share)));
        match offered.iter().find(|(a, b)| space.edge_is_free(a, b)) {
            Some((a, b)) => cut.extend([*a, *b]),
            None => cut.push(corner),
        }
    }
    cut.push(path[path.len() - 1]);
    cut
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::joint_path::Sampled;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;
    use repose_panda::READY;

    #[test]
    fn a_detour_is_cut_where_it_is_free_and_the_ends_stay() {
        let mut corner = READY;
        corner[0] = 1.0;
        let mut end = READY;
        (end[0], end[1]) = (1.0, 0.5);
        let path = vec![READY, corner, end];
        let free = Sampled(|q: &Joints| q[0] > 0.5 || q[1] < READY[1] + 0.05);
        let shorter = simplified(&path, &SimplifySettings::default(), &free);
        assert!(length(&shorter) < length(&path) - 0.1);
        assert_eq!((shorter.first(), shorter.last()), (Some(&READY), Some(&end)));
        assert!(shorter.windows(2).all(|w| free.edge_is_free(&w[0], &w[1])));
    }

    #[test]
    fn a_path_in_the_open_becomes_a_straight_line() {
        let mut rng = Pcg64::seed_from_u64(4);
        let path: Vec<Joints> =
            (0..6).map(|_| repose_panda::LIMITS.between(&std::array::from_fn(|_| rng.random_range(0.0..1.0)))).collect();
        let straight = simplified(&path, &SimplifySettings::default(), &Sampled(|_: &Joints| true));
        assert_eq!(straight, [path[0], path[5]]);
    }
}
