//! RRT-Connect: two trees that grow towards random places and towards each other (Kuffner and LaValle, 2000; the paper's section 3 uses it).
//!
//! One tree is rooted at the start, one at the goals. Bounded in counts, seeded, and exhaustive in what it says on failure.

use rand::RngExt;
use rand_pcg::Pcg64;
use repose_panda::{Joints, LIMITS};

use crate::joint_path::{between, distance, edge_is_free};

/// How the search goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RrtSettings {
    /// Longest new edge, radians (Euclidean). Longer crosses free space in fewer edges, shorter finds narrow ways. Default 1.0.
    pub range_rad: f64,
    /// Between two questions along an edge no point of the robot moves further than this, metres. Default 0.03.
    pub resolution_m: f64,
    /// Random places drawn before giving up. Default 1500.
    pub iterations: usize,
    /// Nodes in both trees before giving up. Default 4000.
    pub nodes: usize,
}

impl Default for RrtSettings {
    fn default() -> Self {
        Self { range_rad: 1.0, resolution_m: 0.03, iterations: 1500, nodes: 4000 }
    }
}

/// Why there is no path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RrtError {
    /// The start is not free.
    #[error("the start is not free")]
    StartBlocked,
    /// No goal is free.
    #[error("no goal is free")]
    GoalBlocked,
    /// The budget ended first.
    #[error("no path after {iterations} iterations and {nodes} nodes")]
    Exhausted {
        /// Iterations made.
        iterations: usize,
        /// Nodes in both trees.
        nodes: usize,
    },
}

struct Tree {
    nodes: Vec<Joints>,
    parents: Vec<usize>,
}

impl Tree {
    fn rooted(roots: Vec<Joints>) -> Self {
        Self { parents: (0..roots.len()).collect(), nodes: roots }
    }

    fn nearest(&self, place: &Joints) -> usize {
        let squared = |q: &Joints| q.iter().zip(place).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
        let mut best = (0, f64::INFINITY);
        for (i, q) in self.nodes.iter().enumerate() {
            let d = squared(q);
            if d < best.1 {
                best = (i, d);
            }
        }
        best.0
    }

    /// Grows from the nearest node by at most one range towards `place`. The new node and whether it is at `place`.
    fn extend(&mut self, from: usize, place: &Joints, settings: &RrtSettings, is_free: &impl Fn(&Joints) -> bool) -> Option<(usize, bool)> {
        let gap = distance(&self.nodes[from], place);
        let arrives = gap <= settings.range_rad;
        let next = if arrives { *place } else { between(&self.nodes[from], place, settings.range_rad / gap) };
        if !edge_is_free(&self.nodes[from], &next, settings.resolution_m, is_free) {
            return None;
        }
        self.nodes.push(next);
        self.parents.push(from);
        Some((self.nodes.len() - 1, arrives))
    }

    /// Nodes from `node` to its root.
    fn branch(&self, mut node: usize) -> Vec<Joints> {
        let mut branch = vec![self.nodes[node]];
        while self.parents[node] != node {
            node = self.parents[node];
            branch.push(self.nodes[node]);
        }
        branch
    }
}

/// A free path from `start` to one of `goals`: corners, `start` and the goal included.
///
/// # Errors
/// [`RrtError`] when an end is not free or the budget ends first.
pub fn rrt_connect(
    start: &Joints,
    goals: &[Joints],
    is_free: &impl Fn(&Joints) -> bool,
    settings: &RrtSettings,
    rng: &mut Pcg64,
) -> Result<Vec<Joints>, RrtError> {
    if !is_free(start) {
        return Err(RrtError::StartBlocked);
    }
    let goals: Vec<Joints> = goals.iter().filter(|g| is_free(g)).copied().collect();
    if goals.is_empty() {
        return Err(RrtError::GoalBlocked);
    }
    if let Some(goal) = goals.iter().find(|g| edge_is_free(start, g, settings.resolution_m, is_free)) {
        return Ok(vec![*start, *goal]);
    }
    let (mut growing, mut other) = (Tree::rooted(vec![*start]), Tree::rooted(goals));
    let mut growing_is_start = true;
    let mut iterations = 0;
    while iterations < settings.iterations && growing.nodes.len() + other.nodes.len() < settings.nodes {
        iterations += 1;
        let place = LIMITS.between(&std::array::from_fn(|_| rng.random_range(0.0..1.0)));
        let nearest = growing.nearest(&place);
        if let Some((new, _)) = growing.extend(nearest, &place, settings, is_free) {
            let target = growing.nodes[new];
            let mut from = other.nearest(&target);
            while let Some((node, arrived)) = other.extend(from, &target, settings, is_free) {
                if arrived {
                    let (start_side, goal_side) = if growing_is_start { (&growing, &other) } else { (&other, &growing) };
                    let (start_node, goal_node) = if growing_is_start { (new, node) } else { (node, new) };
                    let mut path = start_side.branch(start_node);
                    path.reverse();
                    // Both branches end in the meeting place: once is enough.
                    path.extend_from_slice(&goal_side.branch(goal_node)[1..]);
                    return Ok(path);
                }
                from = node;
            }
        }
        std::mem::swap(&mut growing, &mut other);
        growing_is_start = !growing_is_start;
    }
    Err(RrtError::Exhausted { iterations, nodes: growing.nodes.len() + other.nodes.len() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joint_path::path_is_free;
    use rand::SeedableRng;
    use repose_panda::READY;

    /// A wall across joint 1 with a gap where joint 2 is low.
    fn wall(q: &Joints) -> bool {
        LIMITS.contains(q, 0.0) && (!(0.4..0.6).contains(&q[0]) || q[1] < -1.0)
    }

    fn ends() -> (Joints, Joints) {
        let mut goal = READY;
        goal[0] = 1.2;
        (READY, goal)
    }

    #[test]
    fn it_finds_the_way_around_a_wall_and_the_way_is_free() {
        let (start, goal) = ends();
        for seed in 0..10 {
            let path = rrt_connect(&start, &[goal], &wall, &RrtSettings::default(), &mut Pcg64::seed_from_u64(seed)).unwrap();
            assert_eq!((path.first(), path.last()), (Some(&start), Some(&goal)));
            assert!(path_is_free(&path, 0.03, &wall));
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_path() {
        let (start, goal) = ends();
        let find = || rrt_connect(&start, &[goal], &wall, &RrtSettings::default(), &mut Pcg64::seed_from_u64(3));
        assert_eq!(find(), find());
    }

    #[test]
    fn it_says_what_ended_it() {
        let (start, goal) = ends();
        let mut rng = Pcg64::seed_from_u64(1);
        let settings = RrtSettings { iterations: 50, ..RrtSettings::default() };
        let closed = |q: &Joints| !(0.4..0.6).contains(&q[0]);
        assert!(matches!(rrt_connect(&start, &[goal], &closed, &settings, &mut rng), Err(RrtError::Exhausted { iterations: 50, .. })));
        assert_eq!(rrt_connect(&start, &[goal], &|_: &Joints| false, &settings, &mut rng), Err(RrtError::StartBlocked));
        assert_eq!(rrt_connect(&start, &[goal], &|q: &Joints| q[0] < 1.0, &settings, &mut rng), Err(RrtError::GoalBlocked));
    }
}
