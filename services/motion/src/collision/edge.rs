//! Whether a straight edge in joint space is free all along, not only where it is sampled.
//!
//! The edge is cut into stretches. A stretch whose middle keeps every sphere further from everything than the sphere can move on half of it is
//! free; one whose middle touches something blocks the edge; the others are cut again. Sixteen stretches are asked at once, and the first
//! sixteen are spread over the whole edge, so that a blocked edge is most often found out by one question.

use repose_panda::{JOINT_COUNT, Joints};

use super::CollisionChecker;
use super::block::{BLOCK, CollisionQuery, Configurations, Near, ask};

/// Where the cutting of stretches ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeSettings {
    /// A stretch on which nothing moves this far and that is still undecided counts as blocked, metres. Smaller allows for tighter passages
    /// and takes longer along them. Default 1e-4.
    pub tightest_m: f32,
    /// Stretches undecided at a time at which the edge counts as blocked: it runs along something. Default 256.
    pub undecided: usize,
}

impl Default for EdgeSettings {
    fn default() -> Self {
        Self { tightest_m: 1e-4, undecided: 256 }
    }
}

/// Lanes in the order in which every prefix is spread over the block, for instruction sets that take fewer lanes at a time.
const SPREAD: [usize; BLOCK] = [0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15];

impl CollisionChecker<'_> {
    /// Whether the whole straight edge is free, both ends included.
    ///
    /// The ends must be within the joint limits: the edge then is too.
    pub fn edge_is_free(&self, from: &Joints, to: &Joints) -> bool {
        let start: [f32; JOINT_COUNT] = from.map(|v| v as f32);
        let change: [f32; JOINT_COUNT] = std::array::from_fn(|i| (to[i] - from[i]) as f32);
        let whole_m = self.motion_m(&change);
        let furthest_m = whole_m.iter().map(|m| m[0]).fold(0.0, f32::max);
        let world = self.world();
        let mut near = Near::everything(&world);
        near.narrows = true;
        let mut motion_m = whole_m.clone();
        // Stretches by number, of `1 / count` of the edge each.
        let (mut count, mut stretches) = (BLOCK as u32, SPREAD.map(|k| k as u32).to_vec());
        loop {
            let half = 0.5 / count as f32;
            for (scaled, whole) in motion_m.iter_mut().zip(&whole_m) {
                for (scaled, whole) in scaled.iter_mut().zip(whole) {
                    *scaled = whole * half;
                }
            }
            let mut undecided = Vec::new();
            for block in stretches.chunks(BLOCK) {
                // Plain loops, which the compiler turns into vectors. Idle lanes repeat the last stretch.
                let mut fractions = [(block[block.len() - 1] as f32 + 0.5) / count as f32; BLOCK];
                for (fraction, stretch) in fractions.iter_mut().zip(block) {
                    *fraction = (*stretch as f32 + 0.5) / count as f32;
                }
                let mut configurations: Configurations = [[0.0; BLOCK]; JOINT_COUNT];
                for i in 0..JOINT_COUNT {
                    for k in 0..BLOCK {
                        configurations[i][k] = start[i] + fractions[k] * change[i];
                    }
                }
                let mut question =
                    CollisionQuery { configurations: &configurations, motion_m: &motion_m, any_block_ends: true, near: &mut near };
                let verdict = ask(self.instruction_set, &world, &mut question);
                if verdict.blocked != 0 {
                    return false;
                }
                undecided.extend((0..block.len()).filter(|k| verdict.undecided >> k & 1 == 1).map(|k| block[k]));
            }
            near.narrows = false;
            if undecided.is_empty() {
                return true;
            }
            if undecided.len() > self.edge.undecided || furthest_m * half < self.edge.tightest_m {
                return false;
            }
            // Few are cut finely, so that no lane is idle.
            let cuts = (BLOCK / undecided.len()).max(2) as u32;
            count *= cuts;
            stretches = undecided.iter().flat_map(|k| (0..cuts).map(move |c| k * cuts + c)).collect();
        }
    }

    /// Whether a whole path is free, its ends included.
    pub fn path_is_free(&self, path: &[Joints]) -> bool {
        path.iter().all(|q| self.arm.limits.contains(q, 0.0)) && path.windows(2).all(|w| self.edge_is_free(&w[0], &w[1]))
    }

    /// For each group and each joint, how far the group can move by a change of the angles from that joint on, metres.
    fn motion_m(&self, change: &[f32; JOINT_COUNT]) -> Vec<[f32; JOINT_COUNT]> {
        let sums = |levers: &[f32; JOINT_COUNT]| {
            let mut sums = [0.0; JOINT_COUNT];
            let mut sum = 0.0;
            for i in (0..JOINT_COUNT).rev() {
                sum += levers[i] * change[i].abs();
                sums[i] = sum;
            }
            sums
        };
        self.body.groups.iter().map(|group| sums(&group.levers)).collect()
    }
}
