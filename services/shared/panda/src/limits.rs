//! The Panda's official joint limits.
//!
//! Position, velocity and torque: franka_ros, `franka_description/robots/panda/joint_limits.yaml`. Acceleration, jerk and torque rate:
//! libfranka, `rate_limiting.h` (before its margin of 1e-3). Older documents give wider values; these are what the robot enforces.

use crate::{JOINT_COUNT, Joints};

/// The widest opening between the fingers, metres (each finger moves half of it).
pub const FINGER_OPENING_MAX_M: f64 = 0.08;

/// What each joint may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimits {
    /// Lowest angle, radians.
    pub position_lower_rad: Joints,
    /// Highest angle, radians.
    pub position_upper_rad: Joints,
    /// Highest speed, radians per second.
    pub velocity_rad_s: Joints,
    /// Highest acceleration, radians per second squared.
    pub acceleration_rad_s2: Joints,
    /// Highest jerk, radians per second cubed.
    pub jerk_rad_s3: Joints,
}

/// The official limits.
pub const LIMITS: JointLimits = JointLimits {
    position_lower_rad: [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],
    position_upper_rad: [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
    velocity_rad_s: [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61],
    acceleration_rad_s2: [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0],
    jerk_rad_s3: [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10_000.0, 10_000.0],
};

impl JointLimits {
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
    fn what_is_not_a_number_is_outside() {
        let mut joints = READY;
        joints[5] = f64::NAN;
        assert_eq!(LIMITS.outside(&joints, 0.0), Some(5));
    }
}
