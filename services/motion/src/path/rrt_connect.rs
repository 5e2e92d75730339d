//! RRT-Connect: two trees that grow towards random places and towards each other (Kuffner and LaValle, 2000; the paper's section 3 uses it).
//!
//! One tree is rooted at the start, one at the goals. The smaller one grows next, and a node that failed to grow is asked only by places near it
//! (dynamic domains: Yershova and others, 2005; here a domain grows again with every place that it refuses). Bounded in counts, seeded, and exhaustive in what it says on failure.

use rand::RngExt;
use rand_pcg::Pcg64;
use repose_panda::{JOINT_COUNT, Joints};

use crate::path::joint_path::{FreeSpace, between, distance};

/// How the search goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RrtSettings {
    /// Longest new edge, radians (Euclidean). Longer crosses free space in fewer edges, shorter finds narrow ways. Default 1.0.
    pub range_rad: f64,
    /// How near a place must be to a node that failed to grow before, radians. Smaller keeps trees away from walls; infinite turns it off.
    /// Default 4.0.
    pub domain_rad: f64,
    /// By how much the square of that distance grows with each place that it refuses. Default 1.02.
    pub domain_growth: f32,
    /// Failures in a row of the smaller tree after which the other one has a turn: the way in may be found from the other side only.
    /// Default 64.
    pub patience: usize,
    /// Random places drawn before giving up; most are refused at once. Default 200,000.
    pub iterations: usize,
    /// Nodes in both trees before giving up. Default 50,000.
    pub nodes: usize,
}

impl Default for RrtSettings {
    fn default() -> Self {
        Self { range_rad: 1.0, domain_rad: 4.0, domain_growth: 1.02, patience: 64, iterations: 200_000, nodes: 50_000 }
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
    /// It was told to stop.
    #[error("stopped before a path was found")]
    Stopped,
}

/// Iterations between two looks at whether to stop.
const LOOK: usize = 32;

struct Tree {
    nodes: Vec<Joints>,
    /// The nodes again, in single precision and joint by joint: the search for the nearest runs through them.
    columns: [Vec<f32>; JOINT_COUNT],
    parents: Vec<usize>,
    /// The square of how far a place may be from each node.
    domains: Vec<f32>,
}

impl Tree {
    fn rooted(roots: &[Joints]) -> Self {
        let mut tree = Self { nodes: Vec::new(), columns: Default::default(), parents: Vec::new(), domains: Vec::new() };
        for (index, root) in roots.iter().enumerate() {
            tree.push(*root, index);
        }
        tree
    }

    fn push(&mut self, node: Joints, parent: usize) -> usize {
        self.nodes.push(node);
        self.parents.push(parent);
        self.domains.push(f32::INFINITY);
        for (column, angle) in self.columns.iter_mut().zip(node) {
            column.push(angle as f32);
        }
        self.nodes.len() - 1
    }

    /// The nearest node and the square of its distance. Runs of nodes at a time, so that the compiler can use vectors.
    fn nearest(&self, place: &Joints) -> (usize, f32) {
        const RUN: usize = 16;
        let place = place.map(|v| v as f32);
        let mut best = (0, f32::INFINITY);
        for first in (0..self.nodes.len()).step_by(RUN) {
            let count = RUN.min(self.nodes.len() - first);
            let mut squared = [0.0f32; RUN];
            for (column, angle) in self.columns.iter().zip(place) {
                for (sum, value) in squared.iter_mut().zip(&column[first..first + count]) {
                    *sum += (value - angle) * (value - angle);
                }
            }
            for (k, squared) in squared[..count].iter().enumerate() {
                if *squared < best.1 {
                    best = (first + k, *squared);
                }
            }
        }
        best
    }

    /// Grows from `from` by at most one range towards `place`. The new node and whether it is at `place`.
    fn extend(&mut self, from: usize, place: &Joints, settings: &RrtSettings, space: &impl FreeSpace) -> Option<(usize, bool)> {
        let gap = distance(&self.nodes[from], place);
        let arrives = gap <= settings.range_rad;
        let next = if arrives { *place } else { between(&self.nodes[from], place, settings.range_rad / gap) };
        if space.edge_is_free(&self.nodes[from], &next) {
            return Some((self.push(next, from), arrives));
        }
        self.domains[from] = (settings.domain_rad * settings.domain_rad) as f32;
        None
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

/// A free path from `start` to one of `goals`: corners, `start` and the goal included. `should_stop` is asked now and then, and changes nothing
/// but when the search ends.
///
/// # Errors
/// [`RrtError`] when an end is not free, the budget ends first, or the search is to stop.
pub fn rrt_connect(
    start: &Joints,
    goals: &[Joints],
    space: &impl FreeSpace,
    settings: &RrtSettings,
    rng: &mut Pcg64,
    should_stop: &dyn Fn() -> bool,
) -> Result<Vec<Joints>, RrtError> {
    if !space.is_free(start) {
        return Err(RrtError::StartBlocked);
    }
    let goals: Vec<Joints> = goals.iter().filter(|g| space.is_free(g)).copied().collect();
    if goals.is_empty() {
        return Err(RrtError::GoalBlocked);
    }
    if let Some(goal) = goals.iter().find(|g| space.edge_is_free(start, g)) {
        return Ok(vec![*start, *goal]);
    }
    // The start's tree and the goals'.
    let mut trees = [Tree::rooted(&[*start]), Tree::rooted(&goals)];
    let mut failures = 0;
    for iteration in 0..settings.iterations {
        let count = trees[0].nodes.len() + trees[1].nodes.len();
        if count >= settings.nodes {
            return Err(RrtError::Exhausted { iterations: iteration, nodes: count });
        }
        if iteration % LOOK == 0 && should_stop() {
            return Err(RrtError::Stopped);
        }
        // Trees of like size meet sooner than a large and a small one.
        let smaller = usize::from(trees[1].nodes.len() < trees[0].nodes.len());
        failures += 1;
        let growing = if failures % (settings.patience + 1) == 0 { 1 - smaller } else { smaller };
        let place = space.limits().between(&std::array::from_fn(|_| rng.random_range(0.0..1.0)));
        let (nearest, squared) = trees[growing].nearest(&place);
        if squared > trees[growing].domains[nearest] {
            trees[growing].domains[nearest] *= settings.domain_growth;
            continue;
        }
        let Some((new, _)) = trees[growing].extend(nearest, &place, settings, space) else { continue };
        failures = 0;
        let target = trees[growing].nodes[new];
        let other = &mut trees[1 - growing];
        let (mut from, _) = other.nearest(&target);
        while let Some((node, arrived)) = other.extend(from, &target, settings, space) {
            if arrived {
                let (start_node, goal_node) = if growing == 0 { (new, node) } else { (node, new) };
                let mut path = trees[0].branch(start_node);
                path.reverse();
                // Both branches end in the meeting place: once is enough.
                path.extend_from_slice(&trees[1].branch(goal_node)[1..]);
                return Ok(path);
            }
            from = node;
        }
    }
    Err(RrtError::Exhausted { iterations: settings.iterations, nodes: trees[0].nodes.len() + trees[1].nodes.len() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::joint_path::Sampled;
    use rand::SeedableRng;
    use repose_panda::{LIMITS, READY};

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
            let path =
                rrt_connect(&start, &[goal], &Sampled(wall), &RrtSettings::default(), &mut Pcg64::seed_from_u64(seed), &|| false).unwrap();
            assert_eq!((path.first(), path.last()), (Some(&start), Some(&goal)));
            assert!(path.windows(2).all(|w| Sampled(wall).edge_is_free(&w[0], &w[1])));
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_path() {
        let (start, goal) = ends();
        let find = || rrt_connect(&start, &[goal], &Sampled(wall), &RrtSettings::default(), &mut Pcg64::seed_from_u64(3), &|| false);
        assert_eq!(find(), find());
    }

    #[test]
    fn the_nearest_node_is_the_one_that_a_plain_search_finds() {
        let mut rng = Pcg64::seed_from_u64(5);
        let mut draw = || LIMITS.between(&std::array::from_fn(|_| rng.random_range(0.0..1.0)));
        let mut tree = Tree::rooted(&[READY]);
        for count in 1..60 {
            let place = draw();
            let plain = (0..count).min_by(|a, b| distance(&tree.nodes[*a], &place).total_cmp(&distance(&tree.nodes[*b], &place)));
            assert_eq!(Some(tree.nearest(&place).0), plain);
            tree.push(draw(), 0);
        }
    }

    #[test]
    fn it_says_what_ended_it() {
        let (start, goal) = ends();
        let mut rng = Pcg64::seed_from_u64(1);
        let settings = RrtSettings { iterations: 50, ..RrtSettings::default() };
        let closed = Sampled(|q: &Joints| !(0.4..0.6).contains(&q[0]));
        assert!(matches!(
            rrt_connect(&start, &[goal], &closed, &settings, &mut rng, &|| false),
            Err(RrtError::Exhausted { iterations: 50, .. })
        ));
        let nowhere = Sampled(|_: &Joints| false);
        assert_eq!(rrt_connect(&start, &[goal], &nowhere, &settings, &mut rng, &|| false), Err(RrtError::StartBlocked));
        assert_eq!(rrt_connect(&start, &[goal], &closed, &settings, &mut rng, &|| true), Err(RrtError::Stopped));
        let near = Sampled(|q: &Joints| q[0] < 1.0);
        assert_eq!(rrt_connect(&start, &[goal], &near, &settings, &mut rng, &|| false), Err(RrtError::GoalBlocked));
    }
}
