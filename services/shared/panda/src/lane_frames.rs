//! Forward kinematics of many configurations at once: one in each lane of a vector.
//!
//! The same chain as [`crate::kinematics`], in single precision; the Denavit–Hartenberg turns are all right angles and are written out. A place
//! on the arm is within about a micrometre of what double precision gives, which callers cover by [`LANE_ROUNDING_M`].

use repose_simd::Lanes;

use crate::kinematics::{ELBOW_OFFSET_M, FOREARM_M, SHOULDER_M, UPPER_ARM_M, WRIST_OFFSET_M};
use crate::{JOINT_COUNT, LinkFrame};

/// More than single precision moves any place on the arm (or something held within half a metre of it), metres.
pub const LANE_ROUNDING_M: f32 = 1e-5;

/// The frames of one link in all lanes: axes and origin, each x y z.
#[derive(Debug, Clone, Copy)]
pub struct LaneFrame<V> {
    /// The link's x axis.
    pub x: [V; 3],
    /// The link's y axis.
    pub y: [V; 3],
    /// The link's z axis.
    pub z: [V; 3],
    /// The link's origin, metres.
    pub origin: [V; 3],
}

impl<V: Copy> LaneFrame<V> {
    /// Where a place of the link is in every lane.
    ///
    /// # Safety
    /// The instruction set of `S` must be present.
    #[inline(always)]
    pub unsafe fn carry<S: Lanes<V = V>>(&self, place: &[f32]) -> [V; 3] {
        // SAFETY: by this function's contract.
        unsafe {
            let (x, y, z) = (S::splat(place[0]), S::splat(place[1]), S::splat(place[2]));
            // No closures here and below: what a closure holds is compiled without this function's instruction set.
            let mut at = self.origin;
            for (k, along) in at.iter_mut().enumerate() {
                *along = S::fma(self.x[k], x, S::fma(self.y[k], y, S::fma(self.z[k], z, *along)));
            }
            at
        }
    }
}

/// The frames of links 1 to 7 in the world, for the joint angles in each lane.
///
/// # Safety
/// The instruction set of `S` must be present.
#[inline(always)]
pub unsafe fn lane_frames<S: Lanes>(world_from_base: &LinkFrame, joints: &[S::V; JOINT_COUNT]) -> [LaneFrame<S::V>; JOINT_COUNT] {
    // SAFETY: by this function's contract.
    unsafe {
        let (turn, origin) = (&world_from_base.rotation, &world_from_base.origin);
        let zero = [S::splat(0.0); 3];
        let mut base = LaneFrame { x: zero, y: zero, z: zero, origin: zero };
        for k in 0..3 {
            base.x[k] = S::splat(turn[(k, 0)] as f32);
            base.y[k] = S::splat(turn[(k, 1)] as f32);
            base.z[k] = S::splat(turn[(k, 2)] as f32);
            base.origin[k] = S::splat(origin[k] as f32);
        }
        let one = next::<S>(&base, Turn::None, 0.0, SHOULDER_M, joints[0]);
        let two = next::<S>(&one, Turn::Back, 0.0, 0.0, joints[1]);
        let three = next::<S>(&two, Turn::Forth, 0.0, UPPER_ARM_M, joints[2]);
        let four = next::<S>(&three, Turn::Forth, ELBOW_OFFSET_M, 0.0, joints[3]);
        let five = next::<S>(&four, Turn::Back, -ELBOW_OFFSET_M, FOREARM_M, joints[4]);
        let six = next::<S>(&five, Turn::Forth, 0.0, 0.0, joints[5]);
        let seven = next::<S>(&six, Turn::Forth, WRIST_OFFSET_M, 0.0, joints[6]);
        [one, two, three, four, five, six, seven]
    }
}

/// The fixed turn about x from one joint's frame to the next.
#[derive(Clone, Copy)]
enum Turn {
    None,
    /// By a right angle: y becomes z.
    Forth,
    /// By a right angle the other way.
    Back,
}

#[inline(always)]
unsafe fn next<S: Lanes>(from: &LaneFrame<S::V>, turn: Turn, a_m: f64, d_m: f64, angle: S::V) -> LaneFrame<S::V> {
    // SAFETY: by this function's contract.
    unsafe {
        let (side, z) = match turn {
            Turn::None => (from.y, from.z),
            Turn::Forth => (from.z, against::<S>(&from.y)),
            Turn::Back => (against::<S>(&from.z), from.y),
        };
        let (sin, cos) = sin_cos::<S>(angle);
        let (a, d) = (S::splat(a_m as f32), S::splat(d_m as f32));
        let mut next = LaneFrame { x: from.x, y: side, z, origin: from.origin };
        for k in 0..3 {
            next.x[k] = S::fma(from.x[k], cos, S::mul(side[k], sin));
            next.y[k] = S::sub(S::mul(side[k], cos), S::mul(from.x[k], sin));
            if a_m != 0.0 {
                next.origin[k] = S::fma(from.x[k], a, next.origin[k]);
            }
            if d_m != 0.0 {
                next.origin[k] = S::fma(z[k], d, next.origin[k]);
            }
        }
        next
    }
}

#[inline(always)]
unsafe fn against<S: Lanes>(v: &[S::V; 3]) -> [S::V; 3] {
    // SAFETY: by this function's contract.
    unsafe {
        let zero = S::splat(0.0);
        [S::sub(zero, v[0]), S::sub(zero, v[1]), S::sub(zero, v[2])]
    }
}

/// Sine and cosine of angles up to 4 in size, to about 3e-7: the series of half the angle, then doubled.
#[inline(always)]
unsafe fn sin_cos<S: Lanes>(angle: S::V) -> (S::V, S::V) {
    // Coefficients 1/n! with alternating sign: at 2 rad the first left out is below 2e-8.
    const SIN: [f32; 6] = [1.0 / 6_227_020_800.0, -1.0 / 39_916_800.0, 1.0 / 362_880.0, -1.0 / 5_040.0, 1.0 / 120.0, -1.0 / 6.0];
    const COS: [f32; 7] =
        [-1.0 / 87_178_291_200.0, 1.0 / 479_001_600.0, -1.0 / 3_628_800.0, 1.0 / 40_320.0, -1.0 / 720.0, 1.0 / 24.0, -1.0 / 2.0];
    // SAFETY: by this function's contract.
    unsafe {
        let half = S::mul(angle, S::splat(0.5));
        let square = S::mul(half, half);
        let mut sin = S::splat(SIN[0]);
        for coefficient in &SIN[1..] {
            sin = S::fma(sin, square, S::splat(*coefficient));
        }
        sin = S::fma(S::mul(sin, square), half, half);
        let mut cos = S::splat(COS[0]);
        for coefficient in &COS[1..] {
            cos = S::fma(cos, square, S::splat(*coefficient));
        }
        cos = S::fma(cos, square, S::splat(1.0));
        let twice = S::add(sin, sin);
        (S::mul(twice, cos), S::sub(S::splat(1.0), S::mul(twice, sin)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Joints, LIMITS, LinkFrames};
    use nalgebra::{Isometry3, Vector3};
    use proptest::prelude::*;
    use repose_simd::{InstructionSet, Work};

    fn joints() -> impl Strategy<Value = Joints> {
        prop::array::uniform7(0.0..1.0f64).prop_map(|u| LIMITS.between(&u))
    }

    /// Largest distance from where double precision puts the places of all links.
    #[inline(always)]
    unsafe fn deviation<S: Lanes>(configurations: &[Joints; 16], world_from_base: &Isometry3<f64>) -> f64 {
        let place = Vector3::new(0.05, -0.1, 0.15);
        let mut worst = 0.0f64;
        for first in (0..16).step_by(S::COUNT) {
            let columns: [[f32; 16]; 7] = std::array::from_fn(|i| std::array::from_fn(|k| configurations[(first + k) % 16][i] as f32));
            // SAFETY: the caller has the instruction set; every column is 16 floats long.
            let frames =
                unsafe { lane_frames::<S>(&LinkFrame::of(world_from_base), &std::array::from_fn(|i| S::load(columns[i].as_ptr()))) };
            for (link, frame) in frames.iter().enumerate() {
                // SAFETY: as above; each row of `lanes` is 16 floats long.
                unsafe {
                    let at = frame.carry::<S>(&[place.x as f32, place.y as f32, place.z as f32]);
                    let mut lanes = [[0.0f32; 16]; 3];
                    (0..3).for_each(|k| S::store(lanes[k].as_mut_ptr(), at[k]));
                    for lane in 0..S::COUNT {
                        let expected = world_from_base * LinkFrames::at(&configurations[first + lane]).links[link].carry(&place);
                        (0..3).for_each(|k| worst = worst.max((f64::from(lanes[k][lane]) - expected[k]).abs()));
                    }
                }
            }
        }
        worst
    }

    /// [`deviation`] of sixteen configurations.
    struct Deviation<'a>(&'a [Joints; 16], &'a Isometry3<f64>);

    impl Work for Deviation<'_> {
        type Output = f64;

        #[inline(always)]
        unsafe fn run<S: Lanes>(self) -> f64 {
            // SAFETY: the instruction set is present by this function's contract.
            unsafe { deviation::<S>(self.0, self.1) }
        }
    }

    proptest! {
        #[test]
        fn every_lane_agrees_with_double_precision(
            many in prop::collection::vec(joints(), 16), shift in prop::array::uniform3(-0.5..0.5f64), turn in -3.0..3.0f64,
        ) {
            let configurations: [Joints; 16] = std::array::from_fn(|k| many[k]);
            let world_from_base = Isometry3::new(Vector3::from(shift), Vector3::z() * turn);
            for set in InstructionSet::available() {
                let worst = set.run(Deviation(&configurations, &world_from_base));
                prop_assert!(worst < f64::from(LANE_ROUNDING_M) / 3.0, "{set:?}: {worst}");
            }
        }
    }
}
