//! The vector kernel: sixteen configurations asked at once against the world and against the arm itself.
//!
//! Each configuration stands for a stretch of an edge around it. A lane is *blocked* when a sphere touches something there, *undecided* when
//! something is nearer than the sphere can move on the stretch, and else the whole stretch is free. Balls around groups of spheres are asked
//! before the spheres. After Thomason, Kingston and Kavraki, "Motions in Microseconds via Vectorized Sampling-Based Planning" (2024), who check
//! many configurations of an edge at once; stretches in place of samples make a free answer hold between the configurations too.

use nalgebra::Point3;
use repose_panda::lane_frames::{LaneFrame, lane_frames};
use repose_panda::{JOINT_COUNT, LinkFrame};
use repose_simd::{InstructionSet, Lanes, Work};

use super::body::{ArmBody, Group, GroupPair};
use crate::obstacles::{ObstacleShape, Obstacles};

/// Configurations asked at once, whatever the instruction set.
pub(super) const BLOCK: usize = 16;

/// Sixteen configurations: for each joint its angle in each of them, radians.
pub(super) type Configurations = [[f32; BLOCK]; JOINT_COUNT];

/// The arm and the obstacles of a collision query, the same for all blocks.
#[derive(Debug, Clone, Copy)]
pub(super) struct CollisionScene<'a> {
    pub world_from_base: &'a LinkFrame,
    pub body: &'a ArmBody,
    pub obstacles: &'a [&'a Obstacles],
    /// The solids of all obstacles.
    pub shapes: &'a [&'a ObstacleShape],
}

/// One block of configurations to check for collision.
#[derive(Debug)]
pub(super) struct CollisionQuery<'a> {
    pub configurations: &'a Configurations,
    /// For each group, how far it can move on a lane's stretch by the joints from each one on, metres; empty when only the configurations
    /// themselves are asked.
    pub motion_m: &'a [[f32; JOINT_COUNT]],
    /// Whether one blocked lane ends the question.
    pub any_block_ends: bool,
    /// For each group a bit per solid that may matter.
    pub near: &'a mut Near,
}

/// Which solids are near which group.
#[derive(Debug, Clone)]
pub(super) struct Near {
    words: usize,
    bits: Vec<u64>,
    /// Whether the stretches cover all that will be asked, so that what is far from them need not be asked again.
    pub narrows: bool,
}

impl Near {
    /// Everything may be near.
    pub fn everything(world: &CollisionScene<'_>) -> Self {
        let words = world.shapes.len().div_ceil(64);
        Self { words, bits: vec![u64::MAX; words * world.body.groups.len()], narrows: false }
    }
}

/// A bit per lane.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Verdict {
    pub blocked: u32,
    pub undecided: u32,
}

/// Answers with the instruction set.
pub(super) fn ask(set: InstructionSet, world: &CollisionScene<'_>, question: &mut CollisionQuery<'_>) -> Verdict {
    set.run(Asking { world, question })
}

/// A question on its way into the instruction set.
struct Asking<'a, 'w, 'q> {
    world: &'a CollisionScene<'w>,
    question: &'a mut CollisionQuery<'q>,
}

impl Work for Asking<'_, '_, '_> {
    type Output = Verdict;

    #[inline(always)]
    unsafe fn run<S: Lanes>(self) -> Verdict {
        // SAFETY: the instruction set is present by this function's contract.
        unsafe { ask_with::<S>(self.world, self.question) }
    }
}

#[inline(always)]
unsafe fn ask_with<S: Lanes>(world: &CollisionScene<'_>, question: &mut CollisionQuery<'_>) -> Verdict {
    let mut verdict = Verdict::default();
    let near = &mut *question.near;
    let before = near.narrows.then(|| {
        let none = vec![0; near.bits.len()];
        std::mem::replace(&mut near.bits, none)
    });
    for first in (0..BLOCK).step_by(S::COUNT) {
        // SAFETY: by this function's contract; `first` leaves a whole vector in the row.
        let part = unsafe {
            // No closures here and below: what a closure holds is compiled without this function's instruction set.
            let mut joints = [S::splat(0.0); JOINT_COUNT];
            for (lanes, row) in joints.iter_mut().zip(question.configurations) {
                *lanes = S::load(row.as_ptr().add(first));
            }
            let mut lanes = LaneBlock::<S>::new(world, &joints);
            lanes.ask(world, question, before.as_deref());
            lanes.verdict
        };
        verdict.blocked |= part.blocked << first;
        verdict.undecided |= part.undecided << first;
        if verdict.blocked != 0 && question.any_block_ends {
            break;
        }
    }
    verdict
}

/// One vector of configurations on its way through the questions.
struct LaneBlock<S: Lanes> {
    frames: [LaneFrame<S::V>; JOINT_COUNT],
    verdict: Verdict,
}

impl<S: Lanes> LaneBlock<S> {
    #[inline(always)]
    unsafe fn new(world: &CollisionScene<'_>, joints: &[S::V; JOINT_COUNT]) -> Self {
        // SAFETY: by this function's contract.
        Self { frames: unsafe { lane_frames::<S>(world.world_from_base, joints) }, verdict: Verdict::default() }
    }

    #[inline(always)]
    unsafe fn ask(&mut self, world: &CollisionScene<'_>, question: &mut CollisionQuery<'_>, before: Option<&[u64]>) {
        // SAFETY: by this function's contract.
        unsafe {
            for index in 0..world.body.groups.len() {
                let group = &world.body.groups[index];
                let Some(frame) = group.frame else { continue };
                let motion_m = question.motion_m.get(index).map_or(0.0, |m| m[0]);
                self.group(world, question, before, index, group, frame, motion_m);
                if question.any_block_ends && self.verdict.blocked != 0 {
                    return;
                }
            }
            for pair in &world.body.pairs {
                let motion_m = question.motion_m.get(pair.far).map_or(0.0, |m| m[pair.joint]);
                self.pair(world, pair, motion_m);
                if question.any_block_ends && self.verdict.blocked != 0 {
                    return;
                }
            }
        }
    }

    /// Takes note of where a squared distance is below the square of a radius, or of a radius and a motion.
    #[inline(always)]
    unsafe fn note(&mut self, squared: S::V, radius_m: f32, motion_m: f32) {
        let reach = radius_m + motion_m;
        // SAFETY: by this function's contract.
        let near = unsafe { S::less(squared, S::splat(reach * reach)) };
        if near != 0 {
            self.verdict.undecided |= near;
            // SAFETY: by this function's contract.
            self.verdict.blocked |= unsafe { S::less(squared, S::splat(radius_m * radius_m)) };
        }
    }

    /// One group against the world.
    #[inline(always)]
    #[allow(clippy::too_many_arguments, reason = "the innermost part of a kernel, inlined")]
    unsafe fn group(
        &mut self,
        world: &CollisionScene<'_>,
        question: &mut CollisionQuery<'_>,
        before: Option<&[u64]>,
        index: usize,
        group: &Group,
        frame: usize,
        motion_m: f32,
    ) {
        // SAFETY: by this function's contract.
        unsafe {
            let frame = &self.frames[frame];
            let ball = frame.carry::<S>(&group.ball.center);
            let reach = group.ball.world_m + motion_m;
            let words = question.near.words;
            let (mut low, mut high) = ([f32::NEG_INFINITY; 3], [f32::INFINITY; 3]);
            if before.is_some() {
                for k in 0..3 {
                    (low[k], high[k]) = (S::smallest(ball[k]) - reach, S::largest(ball[k]) + reach);
                }
            }
            for word in 0..words {
                let asked = before.map_or(question.near.bits[index * words + word], |b| b[index * words + word]);
                let mut found = 0u64;
                let mut rest = if world.shapes.len() >= (word + 1) * 64 { asked } else { asked & ((1 << (world.shapes.len() % 64)) - 1) };
                while rest != 0 {
                    let bit = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let shape = world.shapes[word * 64 + bit];
                    let (lower, upper) = shape.bounds();
                    if before.is_some() && (0..3).any(|k| lower[k] > high[k] || upper[k] < low[k]) {
                        continue;
                    }
                    if S::less(shape.squared_distance::<S>(&ball), S::splat(reach * reach)) != 0 {
                        found |= 1 << bit;
                    }
                }
                if before.is_some() {
                    question.near.bits[index * words + word] |= found;
                }
                if found == 0 {
                    continue;
                }
                let frame = self.frames[group.frame.unwrap_or(0)];
                for sphere in &group.spheres {
                    let center = frame.carry::<S>(&sphere.center);
                    let mut rest = found;
                    while rest != 0 {
                        let shape = world.shapes[word * 64 + rest.trailing_zeros() as usize];
                        rest &= rest - 1;
                        self.note(shape.squared_distance::<S>(&center), sphere.world_m, motion_m);
                    }
                    if question.any_block_ends && self.verdict.blocked != 0 {
                        return;
                    }
                }
            }
            for obstacles in world.obstacles {
                if obstacles.near_points::<S>(&ball, reach) != 0 {
                    self.cloud(question, obstacles, group, motion_m);
                }
            }
        }
    }

    /// One group's spheres against observed points.
    #[inline(always)]
    unsafe fn cloud(&mut self, question: &CollisionQuery<'_>, obstacles: &Obstacles, group: &Group, motion_m: f32) {
        // SAFETY: by this function's contract; each row of `places` holds a whole vector.
        unsafe {
            let frame = self.frames[group.frame.unwrap_or(0)];
            for sphere in &group.spheres {
                let center = frame.carry::<S>(&sphere.center);
                let mut lanes = obstacles.near_points::<S>(&center, sphere.world_m + motion_m) & !self.verdict.blocked;
                if lanes == 0 {
                    continue;
                }
                let mut places = [[0.0f32; BLOCK]; 3];
                for k in 0..3 {
                    S::store(places[k].as_mut_ptr(), center[k]);
                }
                while lanes != 0 {
                    let lane = lanes.trailing_zeros();
                    lanes &= lanes - 1;
                    let place = Point3::new(places[0][lane as usize], places[1][lane as usize], places[2][lane as usize]);
                    let bit = 1 << lane;
                    let is_undecided = self.verdict.undecided & bit != 0;
                    if !is_undecided && !obstacles.has_point_within::<S>(&place, sphere.world_m + motion_m) {
                        continue;
                    }
                    self.verdict.undecided |= bit;
                    // What is near something where nothing moves touches it.
                    if (!is_undecided && motion_m <= 0.0) || obstacles.has_point_within::<S>(&place, sphere.world_m) {
                        self.verdict.blocked |= bit;
                        if question.any_block_ends {
                            return;
                        }
                    }
                }
            }
        }
    }

    /// Where a place of a group is.
    #[inline(always)]
    unsafe fn place(&self, world: &CollisionScene<'_>, group: &Group, place: &[f32; 3]) -> [S::V; 3] {
        // SAFETY: by this function's contract.
        unsafe {
            match group.frame {
                Some(frame) => self.frames[frame].carry::<S>(place),
                None => {
                    let at = world.world_from_base.carry(&nalgebra::Vector3::from(place.map(f64::from)));
                    [S::splat(at.x as f32), S::splat(at.y as f32), S::splat(at.z as f32)]
                }
            }
        }
    }

    /// Two groups of the arm against each other: ball against ball, spheres against ball, spheres against spheres.
    #[inline(always)]
    unsafe fn pair(&mut self, world: &CollisionScene<'_>, pair: &GroupPair, motion_m: f32) {
        // SAFETY: by this function's contract.
        unsafe {
            let (near, far) = (&world.body.groups[pair.near], &world.body.groups[pair.far]);
            let far_ball = self.place(world, far, &far.ball.center);
            let apart = squared_apart::<S>(&self.place(world, near, &near.ball.center), &far_ball);
            let reach = near.ball.self_m + far.ball.self_m + motion_m;
            if S::less(apart, S::splat(reach * reach)) == 0 {
                return;
            }
            for sphere in &near.spheres {
                let center = self.place(world, near, &sphere.center);
                let reach = sphere.self_m + far.ball.self_m + motion_m;
                if S::less(squared_apart::<S>(&center, &far_ball), S::splat(reach * reach)) == 0 {
                    continue;
                }
                for other in &far.spheres {
                    let apart = squared_apart::<S>(&center, &self.place(world, far, &other.center));
                    self.note(apart, sphere.self_m + other.self_m, motion_m);
                }
            }
        }
    }
}

#[inline(always)]
unsafe fn squared_apart<S: Lanes>(a: &[S::V; 3], b: &[S::V; 3]) -> S::V {
    // SAFETY: by this function's contract.
    unsafe {
        let (x, y, z) = (S::sub(a[0], b[0]), S::sub(a[1], b[1]), S::sub(a[2], b[2]));
        S::fma(x, x, S::fma(y, y, S::mul(z, z)))
    }
}
