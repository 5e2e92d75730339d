//! Between two timed set-points: the cubic that meets the position and the velocity of both (Hermite).
//!
//! What the robot's side does at 1 kHz; who wants to know where it will be does the same. Where a motion of bounded jerk `j` is sampled every
//! `h`, the cubic's acceleration jumps by at most `16/27·j·h` at a set-point and its jerk stays below `j` between them (Peano kernels). Where the
//! motion's acceleration stays below `a`, the cubic's stays below `a + 4/27·j·h`: at its ends it is a mean of the motion's with weights
//! `4 − 6s`, which is largest where the motion brakes from a third of the way on.

use crate::Joints;

/// Largest jump of the cubics' acceleration at a set-point, as a share of the sampled motion's jerk times the set-points' distance in time.
pub const ACCELERATION_JUMP: f64 = 16.0 / 27.0;
/// Largest excess of the cubics' acceleration over the largest of the sampled motion, as a share of its jerk times the set-points' distance in time.
pub const ACCELERATION_EXCESS: f64 = 4.0 / 27.0;
/// Largest difference of the cubics' velocity from the sampled motion's, as a share of its jerk times the square of the set-points' distance in
/// time; 0.77 of the way, rounded up.
pub const VELOCITY_EXCESS: f64 = 0.0323;

/// A knot of the interpolation: position (radians) and velocity (radians per second).
pub type Knot<'a> = (&'a Joints, &'a Joints);

/// Position and velocity at the share `s` (0 to 1) of the way from `a` to `b`, `span_s` seconds apart.
pub fn hermite((qa, va): Knot<'_>, (qb, vb): Knot<'_>, span_s: f64, s: f64) -> (Joints, Joints) {
    let (s2, s3) = (s * s, s * s * s);
    let position = std::array::from_fn(|i| {
        (2.0 * s3 - 3.0 * s2 + 1.0) * qa[i]
            + (s3 - 2.0 * s2 + s) * span_s * va[i]
            + (3.0 * s2 - 2.0 * s3) * qb[i]
            + (s3 - s2) * span_s * vb[i]
    });
    let velocity = std::array::from_fn(|i| {
        (6.0 * s2 - 6.0 * s) * (qa[i] - qb[i]) / span_s + (3.0 * s2 - 4.0 * s + 1.0) * va[i] + (3.0 * s2 - 2.0 * s) * vb[i]
    });
    (position, velocity)
}

/// The smooth step from 0 to 1 (first and second derivative 0 at both ends) at the share `s` of the way; at most 1.875, 5.774 and 60 are its
/// derivatives.
pub fn smooth_step(s: f64) -> f64 {
    let s = s.clamp(0.0, 1.0);
    s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::JOINT_COUNT;

    /// A cubic motion of joint 0 and its velocity.
    fn cubic([a, b, c, d]: [f64; 4], t: f64) -> (Joints, Joints) {
        let (mut q, mut v) = ([0.0; JOINT_COUNT], [0.0; JOINT_COUNT]);
        q[0] = a + t * (b + t * (c + t * d));
        v[0] = b + t * (2.0 * c + 3.0 * t * d);
        (q, v)
    }

    proptest! {
        #[test]
        fn a_cubic_motion_is_followed_exactly(by in prop::array::uniform4(-2.0..2.0f64), span_s in 0.001..0.5f64, s in 0.0..1.0f64) {
            let (a, b, there) = (cubic(by, 0.0), cubic(by, span_s), cubic(by, s * span_s));
            let (q, v) = hermite((&a.0, &a.1), (&b.0, &b.1), span_s, s);
            prop_assert!((q[0] - there.0[0]).abs() < 1e-12 && (v[0] - there.1[0]).abs() < 1e-9);
        }
    }

    #[test]
    fn the_acceleration_exceeds_the_motions_by_no_more_than_said_where_that_brakes_from_a_third_on() {
        // Acceleration of 1 that falls with a jerk of 1 from a third of the way of 1 on.
        let late = 2.0 / 3.0f64;
        let (position, velocity) = (0.5 - late.powi(3) / 6.0, 1.0 - late * late / 2.0);
        let start = 6.0 * position - 2.0 * velocity;
        assert!((start - 1.0 - ACCELERATION_EXCESS).abs() < 1e-12, "{start}");
    }

    #[test]
    fn the_velocity_differs_by_no_more_than_said() {
        const STEPS: usize = 1000;
        // The jerk's weight in the difference at a share of the way, integrated from the end of the interval.
        let difference = |s: f64| {
            let (mut kernel, mut whole) = (0.0, 0.0f64);
            for k in (0..STEPS).rev() {
                let u = (k as f64 + 0.5) / STEPS as f64;
                let weight = s * (4.0 - 6.0 * u) + 0.5 * s * s * (12.0 * u - 6.0) - f64::from(u8::from(u < s));
                kernel += weight / STEPS as f64;
                whole += kernel.abs() / STEPS as f64;
            }
            whole
        };
        let largest = (1..100).map(|k| difference(f64::from(k) / 100.0)).fold(0.0, f64::max);
        assert!(largest < VELOCITY_EXCESS + 1e-4 && largest > VELOCITY_EXCESS - 3e-4, "{largest}");
    }

    #[test]
    fn the_acceleration_jumps_by_no_more_than_said_where_the_jerk_changes_its_sign() {
        // Jerk of ±1 over intervals of 1, the worst case of the kernels: the sign changes a third before and after the set-point.
        let flips = [2.0 / 3.0, 4.0 / 3.0];
        let sample = |t: f64| {
            let (mut q, mut v, mut a, mut at, mut jerk) = (0.0, 0.0, 0.0, 0.0, 1.0);
            for end in flips.into_iter().chain([f64::INFINITY]) {
                let dt = t.min(end) - at;
                q += dt * (v + dt * (a / 2.0 + dt * jerk / 6.0));
                v += dt * (a + dt * jerk / 2.0);
                a += dt * jerk;
                (at, jerk) = (end, -jerk);
                if t <= end {
                    break;
                }
            }
            (q, v)
        };
        let acceleration = |from: f64, s: f64| {
            let ((qa, va), (qb, vb)) = (sample(from), sample(from + 1.0));
            (12.0 * s - 6.0) * (qa - qb) + (6.0 * s - 4.0) * va + (6.0 * s - 2.0) * vb
        };
        let jump = (acceleration(1.0, 0.0) - acceleration(0.0, 1.0)).abs();
        assert!(jump <= ACCELERATION_JUMP + 1e-12 && jump > ACCELERATION_JUMP - 1e-9, "{jump}");
    }
}
