//! The official joint limits of the Panda and of the Research 3 (FR3).
//!
//! The Panda's position, velocity and torque: franka_ros, `franka_description/robots/panda/joint_limits.yaml`; acceleration, jerk and torque
//! rate: libfranka 0.9, `rate_limiting.h` (before its margin of 1e-3). Older documents give wider values; these are what the robot enforces.
//!
//! The FR3's position and velocity, and how its highest speed falls towards a position limit: the `<limit>` and
//! `<position_based_velocity_limits>` of the URDF that the robot hands out (franka_description, `robots/fr3`; libfranka 0.21, `test/fr3.urdf`).
//! Acceleration and jerk: libfranka 0.21, `rate_limiting.h`. It is faster than the Panda and may accelerate most of its joints less.

use crate::{JOINT_COUNT, Joints};

/// The widest opening between the fingers, metres (each finger moves half of it).
pub const FINGER_OPENING_MAX_M: f64 = 0.08;
/// By so large a share of its angle a joint that is to stay where it is may be off it by rounding.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// What each joint may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimits {
    /// Lowest angle, radians.
    pub position_lower_rad: Joints,
    /// Highest angle, radians.
    pub position_upper_rad: Joints,
    /// Highest speed, radians per second.
    pub velocity_rad_s: Joints,
    /// How that falls towards the position limits, where it does.
    pub approach: Option<ApproachLimits>,
    /// Highest acceleration, radians per second squared.
    pub acceleration_rad_s2: Joints,
    /// Highest jerk, radians per second cubed.
    pub jerk_rad_s3: Joints,
}

/// The highest speed towards a position limit that is `way` off: `sqrt(2 · deceleration · way) − offset`, and never less than 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ApproachLimits {
    /// The deceleration, radians per second squared.
    pub deceleration_rad_s2: Joints,
    /// What is taken off the speed, radians per second.
    pub offset_rad_s: Joints,
}

/// The Panda's official limits.
pub const LIMITS: JointLimits = JointLimits {
    position_lower_rad: [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],
    position_upper_rad: [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
    velocity_rad_s: [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61],
    approach: None,
    acceleration_rad_s2: [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0],
    jerk_rad_s3: [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10_000.0, 10_000.0],
};

/// The FR3's official limits.
pub const FR3_LIMITS: JointLimits = JointLimits {
    position_lower_rad: [-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.54092, -3.0196],
    position_upper_rad: [2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196],
    velocity_rad_s: [2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26],
    approach: Some(ApproachLimits {
        deceleration_rad_s2: [6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0],
        offset_rad_s: [0.3, 0.2, 0.2, 0.3, 0.35, 0.35, 0.35],
    }),
    acceleration_rad_s2: [10.0; JOINT_COUNT],
    jerk_rad_s3: [5000.0; JOINT_COUNT],
};

impl JointLimits {
    /// The highest speed of a joint (from 0) at an angle, in the direction of `velocity_rad_s`, radians per second.
    pub fn speed_at(&self, joint: usize, position_rad: f64, velocity_rad_s: f64) -> f64 {
        let way_rad = if velocity_rad_s < 0.0 {
            position_rad - self.position_lower_rad[joint]
        } else {
            self.position_upper_rad[joint] - position_rad
        };
        self.speed_before(joint, way_rad)
    }

    /// The highest speed of a joint (from 0) towards a position limit that is `way_rad` off, radians per second.
    pub fn speed_before(&self, joint: usize, way_rad: f64) -> f64 {
        let highest = self.velocity_rad_s[joint];
        let Some(approach) = &self.approach else { return highest };
        let falling = (2.0 * approach.deceleration_rad_s2[joint] * way_rad.max(0.0)).sqrt() - approach.offset_rad_s[joint];
        falling.clamp(0.0, highest)
    }

    /// Its angles less those near the position limits to which it may go at no more than `least_rad_s`: where a motion may lead. The same where
    /// speeds do not fall.
    #[must_use]
    pub fn approachable(&self, least_rad_s: f64) -> Self {
        let Some(approach) = &self.approach else { return *self };
        let way_rad = |i: usize| (approach.offset_rad_s[i] + least_rad_s).powi(2) / (2.0 * approach.deceleration_rad_s2[i]);
        Self {
            position_lower_rad: std::array::from_fn(|i| self.position_lower_rad[i] + way_rad(i)),
            position_upper_rad: std::array::from_fn(|i| self.position_upper_rad[i] - way_rad(i)),
            ..*self
        }
    }

    /// The limits with the position limits widened to where the joints are: an arm that stands beyond them comes back from there, and goes no further
    /// than by the rounding of a joint that is to stay where it is.
    #[must_use]
    pub fn including(&self, joints: &Joints) -> Self {
        let rounding_rad = |i: usize| ROUNDING * joints[i].abs();
        Self {
            position_lower_rad: std::array::from_fn(|i| self.position_lower_rad[i].min(joints[i] - rounding_rad(i))),
            position_upper_rad: std::array::from_fn(|i| self.position_upper_rad[i].max(joints[i] + rounding_rad(i))),
            ..*self
        }
    }

    /// The limits that both have: what keeps them is allowed by either.
    #[must_use]
    pub fn narrower(&self, other: &Self) -> Self {
        let lower = |a: &Joints, b: &Joints| -> Joints { std::array::from_fn(|i| a[i].min(b[i])) };
        let higher = |a: &Joints, b: &Joints| -> Joints { std::array::from_fn(|i| a[i].max(b[i])) };
        let approach = match (&self.approach, &other.approach) {
            (Some(a), Some(b)) => Some(ApproachLimits {
                deceleration_rad_s2: lower(&a.deceleration_rad_s2, &b.deceleration_rad_s2),
                offset_rad_s: higher(&a.offset_rad_s, &b.offset_rad_s),
            }),
            (one, another) => one.or(*another),
        };
        Self {
            position_lower_rad: higher(&self.position_lower_rad, &other.position_lower_rad),
            position_upper_rad: lower(&self.position_upper_rad, &other.position_upper_rad),
            velocity_rad_s: lower(&self.velocity_rad_s, &other.velocity_rad_s),
            approach,
            acceleration_rad_s2: lower(&self.acceleration_rad_s2, &other.acceleration_rad_s2),
            jerk_rad_s3: lower(&self.jerk_rad_s3, &other.jerk_rad_s3),
        }
    }

    /// Whether all angles lie within the position limits, at least `margin_rad` away from them.
    pub fn contains(&self, joints: &Joints, margin_rad: f64) -> bool {
        self.outside(joints, margin_rad).is_none()
    }

    /// The first joint (from 0) that is not a number or not within the position limits less `margin_rad`.
    pub fn outside(&self, joints: &Joints, margin_rad: f64) -> Option<usize> {
        (0..JOINT_COUNT)
            .find(|&i| !(self.position_lower_rad[i] + margin_rad..=self.position_upper_rad[i] - margin_rad).contains(&joints[i]))
    }

    /// The angles brought within the position limits less `margin_rad`.
    pub fn clamped(&self, joints: &Joints, margin_rad: f64) -> Joints {
        std::array::from_fn(|i| joints[i].clamp(self.position_lower_rad[i] + margin_rad, self.position_upper_rad[i] - margin_rad))
    }

    /// The configuration at `fractions`, 0 to 1, of the way from the lower to the upper limits; rounding takes it beyond neither.
    pub fn between(&self, fractions: &[f64; JOINT_COUNT]) -> Joints {
        let [low, high] = [&self.position_lower_rad, &self.position_upper_rad];
        std::array::from_fn(|i| (low[i] + fractions[i] * (high[i] - low[i])).clamp(low[i], high[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::READY;

    #[test]
    fn the_ready_pose_is_within_the_limits_and_the_straight_arm_is_not() {
        assert!(LIMITS.contains(&READY, 0.1));
        assert_eq!(LIMITS.outside(&[0.0; 7], 0.0), Some(3), "the elbow cannot be straight");
        assert!(LIMITS.contains(&LIMITS.clamped(&[9.0; 7], 0.01), 0.009));
    }

    #[test]
    fn the_whole_way_between_the_limits_ends_at_them() {
        assert_eq!(LIMITS.between(&[0.0; JOINT_COUNT]), LIMITS.position_lower_rad);
        assert_eq!(LIMITS.between(&[1.0; JOINT_COUNT]), LIMITS.position_upper_rad);
    }

    #[test]
    fn the_fr3_slows_down_towards_its_limits_as_libfranka_works_it_out() {
        assert!(FR3_LIMITS.contains(&READY, 0.1));
        // `computeUpperLimitsJointVelocity` of libfranka's `rate_limiting.h` before its margin of 1e-3, joint 1 at 2.7 rad: -0.30 + sqrt(12 · 0.0501).
        assert!((FR3_LIMITS.speed_at(0, 2.7, 1.0) - 0.475_370).abs() < 1e-6);
        assert_eq!(FR3_LIMITS.speed_at(0, 2.7, -1.0), 2.62, "away from the limit it may go at once");
        assert_eq!(FR3_LIMITS.speed_at(0, 2.745, 1.0), 0.0);
        assert_eq!(LIMITS.speed_at(0, 2.89, 1.0), 2.175);
        let inner = FR3_LIMITS.approachable(0.1);
        for i in 0..JOINT_COUNT {
            assert!((FR3_LIMITS.speed_at(i, inner.position_upper_rad[i], 1.0) - 0.1).abs() < 1e-9);
            assert!((FR3_LIMITS.speed_at(i, inner.position_lower_rad[i], -1.0) - 0.1).abs() < 1e-9);
        }
        assert_eq!(LIMITS.approachable(0.1), LIMITS);
    }

    #[test]
    fn what_keeps_the_narrower_limits_keeps_both() {
        let both = LIMITS.narrower(&FR3_LIMITS);
        assert_eq!(both, FR3_LIMITS.narrower(&LIMITS));
        assert_eq!((both.position_lower_rad[5], both.position_upper_rad[5]), (0.54092, 3.7525));
        assert_eq!((both.velocity_rad_s[4], both.acceleration_rad_s2[1], both.jerk_rad_s3[1]), (2.61, 7.5, 3750.0));
        assert_eq!(both.approach, FR3_LIMITS.approach);
    }

    #[test]
    fn limits_are_widened_to_where_an_arm_stands_and_not_beyond() {
        let mut joints = READY;
        (joints[0], joints[1], joints[2]) = (2.9, -1.8, f64::NAN);
        let wider = LIMITS.including(&joints);
        let beyond_rad = [wider.position_upper_rad[0] - 2.9, -1.8 - wider.position_lower_rad[1]];
        assert!(beyond_rad.iter().all(|beyond_rad| (0.0..1e-13).contains(beyond_rad)), "{beyond_rad:?}");
        let ends = |limits: &JointLimits| (limits.position_lower_rad[0], limits.position_upper_rad[1], limits.position_upper_rad[2]);
        assert_eq!(ends(&wider), ends(&LIMITS));
        assert_eq!(LIMITS.including(&READY), LIMITS);
    }

    #[test]
    fn what_is_not_a_number_is_outside() {
        let mut joints = READY;
        joints[5] = f64::NAN;
        assert_eq!(LIMITS.outside(&joints, 0.0), Some(5));
    }
}
