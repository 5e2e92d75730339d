//! Shortens a path by cutting corners: random pairs of places on it are joined by a straight edge where that is free and shorter.

use rand::RngExt;
use rand_pcg::Pcg64;
use repose_panda::Joints;

use crate::joint_path::{between, distance, edge_is_free};

/// How hard to shorten.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimplifySettings {
    /// Pairs of places tried; more makes the path shorter and costs time. Default 60.
    pub attempts: usize,
    /// Between two questions along an edge no point of the robot moves further than this, metres. Default 0.03.
    pub resolution_m: f64,
}

impl Default for SimplifySettings {
    fn default() -> Self {
        Self { attempts: 60, resolution_m: 0.03 }
    }
}

/// A shorter free path between the same ends.
pub fn simplified(mut path: Vec<Joints>, settings: &SimplifySettings, is_free: &impl Fn(&Joints) -> bool, rng: &mut Pcg64) -> Vec<Joints> {
    for _ in 0..settings.attempts {
        if path.len() < 3 {
            break;
        }
        let total: f64 = path.windows(2).map(|w| distance(&w[0], &w[1])).sum();
        let (a, b) = (rng.random_range(0.0..total), rng.random_range(0.0..total));
        let (from, to) = (place_at(&path, a.min(b)), place_at(&path, a.max(b)));
        if from.edge == to.edge || !edge_is_free(&from.joints, &to.joints, settings.resolution_m, is_free) {
            continue;
        }
        let mut shorter = path[..=from.edge].to_vec();
        shorter.extend([from.joints, to.joints]);
        shorter.extend_from_slice(&path[to.edge + 1..]);
        path = shorter;
        path.dedup_by(|a, b| distance(a, b) < 1e-9);
    }
    straightened(&path)
}

struct Place {
    edge: usize,
    joints: Joints,
}

fn place_at(path: &[Joints], mut along: f64) -> Place {
    for (edge, w) in path.windows(2).enumerate() {
        let length = distance(&w[0], &w[1]);
        if along <= length {
            return Place { edge, joints: between(&w[0], &w[1], if length > 0.0 { along / length } else { 0.0 }) };
        }
        along -= length;
    }
    Place { edge: path.len() - 2, joints: path[path.len() - 1] }
}

/// Drops corners that lie on the straight line between their neighbours.
fn straightened(path: &[Joints]) -> Vec<Joints> {
    let mut kept: Vec<Joints> = Vec::with_capacity(path.len());
    for (i, corner) in path.iter().enumerate() {
        let on_line = match (kept.last(), path.get(i + 1)) {
            (Some(before), Some(after)) => distance(before, corner) + distance(corner, after) - distance(before, after) < 1e-9,
            _ => false,
        };
        if !on_line {
            kept.push(*corner);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joint_path::{length, path_is_free};
    use rand::SeedableRng;
    use repose_panda::READY;

    #[test]
    fn a_detour_is_cut_where_it_is_free_and_the_ends_stay() {
        let mut corner = READY;
        corner[0] = 1.0;
        let mut end = READY;
        (end[0], end[1]) = (1.0, 0.5);
        let path = vec![READY, corner, end];
        let free = |q: &Joints| q[0] > 0.5 || q[1] < READY[1] + 0.05;
        let shorter =
            simplified(path.clone(), &SimplifySettings { attempts: 100, resolution_m: 0.01 }, &free, &mut Pcg64::seed_from_u64(1));
        assert!(length(&shorter) < length(&path) - 0.1);
        assert_eq!((shorter.first(), shorter.last()), (Some(&READY), Some(&end)));
        // Asked at other places than while it was made: by half a step more lenient.
        let nearly_free = |q: &Joints| q[0] > 0.49 || q[1] < READY[1] + 0.06;
        assert!(path_is_free(&shorter, 0.003, &nearly_free));
    }
}
