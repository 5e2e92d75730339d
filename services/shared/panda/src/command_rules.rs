//! Franka's rules for a stream of joint set-points, one each millisecond.
//!
//! The robot takes the first set-point only where it stands, and stops with a named reflex when a later one leaves the position limits or
//! asks for a velocity, acceleration or jerk above the limits. Derivatives are backward differences, as in libfranka's `rate_limiting.h`;
//! the reasons carry the names of libfranka's `Errors`. One rule is added: a set-point after which the arm could no longer come to rest within
//! all limits is refused too. So a stop at any moment keeps them, whatever was commanded before.

use crate::stop::{MotionState, OverrunLimit, overrun};
use crate::{JOINT_COUNT, JointLimits, Joints, LIMITS};

/// How far the first set-point may be from where the robot stands, radians per joint.
pub const START_TOLERANCE_RAD: f64 = 1e-3;

/// What is demanded of a stream of set-points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandRuleSettings {
    /// The limits.
    pub limits: JointLimits,
    /// Time between set-points, seconds. Default 0.001.
    pub period_s: f64,
    /// How far the first set-point may be from where the robot stands, radians. Default [`START_TOLERANCE_RAD`].
    pub start_tolerance_rad: f64,
}

impl Default for CommandRuleSettings {
    fn default() -> Self {
        Self { limits: LIMITS, period_s: 0.001, start_tolerance_rad: START_TOLERANCE_RAD }
    }
}

/// Which rule a set-point broke. `joint` counts from 0.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Violation {
    /// A number is NaN or infinite.
    #[error("joint {joint}: the set-point is not finite")]
    NotFinite {
        /// The joint.
        joint: usize,
    },
    /// The first set-point is not where the robot stands.
    #[error("start_pose_invalid: joint {joint} stands at {from_rad:.4} rad and is sent to {to_rad:.4} rad")]
    StartPoseInvalid {
        /// The joint.
        joint: usize,
        /// Where it stands, radians.
        from_rad: f64,
        /// Where the set-point is, radians.
        to_rad: f64,
    },
    /// The set-point lies outside the position limits.
    #[error("joint_motion_generator_position_limits_violation: joint {joint} at {value_rad:.4} rad")]
    PositionLimits {
        /// The joint.
        joint: usize,
        /// The set-point, radians.
        value_rad: f64,
    },
    /// The set-point asks for too high a velocity.
    #[error("joint_motion_generator_velocity_limits_violation: joint {joint} at {value:.3} rad/s of {limit:.3}")]
    VelocityLimits {
        /// The joint.
        joint: usize,
        /// What was asked, rad/s.
        value: f64,
        /// What is allowed, rad/s.
        limit: f64,
    },
    /// The set-point asks for too high an acceleration.
    #[error("joint_motion_generator_velocity_discontinuity: joint {joint} at {value:.2} rad/s² of {limit:.2}")]
    VelocityDiscontinuity {
        /// The joint.
        joint: usize,
        /// What was asked, rad/s².
        value: f64,
        /// What is allowed, rad/s².
        limit: f64,
    },
    /// The set-point asks for too high a jerk.
    #[error("joint_motion_generator_acceleration_discontinuity: joint {joint} at {value:.0} rad/s³ of {limit:.0}")]
    AccelerationDiscontinuity {
        /// The joint.
        joint: usize,
        /// What was asked, rad/s³.
        value: f64,
        /// What is allowed, rad/s³.
        limit: f64,
    },
    /// From the set-point on no stop would keep the position limits.
    #[error("joint_motion_generator_position_limits_violation: joint {joint} could no longer stop before its limit")]
    NoRoomToStop {
        /// The joint.
        joint: usize,
    },
    /// From the set-point on no stop would keep the velocity limits.
    #[error("joint_motion_generator_velocity_limits_violation: joint {joint} could no longer stay below its limit")]
    NoRoomToSlow {
        /// The joint.
        joint: usize,
    },
}

impl Violation {
    /// The reflex's name as libfranka spells it.
    pub fn name(&self) -> &'static str {
        match self {
            Self::NotFinite { .. } => "set_point_not_finite",
            Self::StartPoseInvalid { .. } => "start_pose_invalid",
            Self::PositionLimits { .. } | Self::NoRoomToStop { .. } => "joint_motion_generator_position_limits_violation",
            Self::VelocityLimits { .. } | Self::NoRoomToSlow { .. } => "joint_motion_generator_velocity_limits_violation",
            Self::VelocityDiscontinuity { .. } => "joint_motion_generator_velocity_discontinuity",
            Self::AccelerationDiscontinuity { .. } => "joint_motion_generator_acceleration_discontinuity",
        }
    }
}

/// Rounding of positions that backward differences would otherwise blow up into violations.
const ROUNDING: f64 = 1e-6;
/// What rounding makes of the speed of a joint that stands, and more, rad/s: next to its limit an FR3 allows none at all.
const STILL_RAD_S: f64 = 1e-9;

/// The rules applied to one stream: feed it every set-point in turn.
#[derive(Debug, Clone)]
pub struct CommandRules {
    settings: CommandRuleSettings,
    state: MotionState,
    started: bool,
}

impl CommandRules {
    /// A stream that begins with the robot at rest at `measured`. Where that is beyond the position limits, as those of a driver that keeps off the
    /// robot's own, it may come back from there.
    pub fn new(measured: &Joints, settings: CommandRuleSettings) -> Self {
        let settings = CommandRuleSettings { limits: settings.limits.including(measured), ..settings };
        Self { settings, state: MotionState::at_rest(*measured), started: false }
    }

    /// The same when its first set-point, at `measured` itself, has been accepted already.
    pub fn continued(measured: &Joints, settings: CommandRuleSettings) -> Self {
        Self { started: true, ..Self::new(measured, settings) }
    }

    /// The limits that the set-points are checked against.
    pub fn limits(&self) -> &JointLimits {
        &self.settings.limits
    }

    /// Where and how the arm moves at the last set-point that was accepted.
    pub fn state(&self) -> &MotionState {
        &self.state
    }

    /// Takes the next set-point, or says which rule it breaks (and is then as before).
    ///
    /// # Errors
    /// The [`Violation`] of the first joint that breaks a rule.
    pub fn accept(&mut self, set_point: &Joints) -> Result<(), Violation> {
        if let Some(joint) = (0..JOINT_COUNT).find(|&i| !set_point[i].is_finite()) {
            return Err(Violation::NotFinite { joint });
        }
        if let Some(joint) = self.settings.limits.outside(set_point, 0.0) {
            return Err(Violation::PositionLimits { joint, value_rad: set_point[joint] });
        }
        if !self.started {
            let from = &self.state.position_rad;
            let far = |i: &usize| (set_point[*i] - from[*i]).abs() > self.settings.start_tolerance_rad;
            if let Some(joint) = (0..JOINT_COUNT).find(far) {
                return Err(Violation::StartPoseInvalid { joint, from_rad: from[joint], to_rad: set_point[joint] });
            }
            self.state = MotionState::at_rest(*set_point);
            self.started = true;
            return Ok(());
        }
        let next = self.state.followed_by(set_point, self.settings.period_s);
        (0..JOINT_COUNT).try_for_each(|joint| self.check_joint(joint, &next))?;
        match overrun(&next, &self.settings.limits, self.settings.period_s) {
            Some((joint, OverrunLimit::Position)) => return Err(Violation::NoRoomToStop { joint }),
            Some((joint, OverrunLimit::Velocity)) => return Err(Violation::NoRoomToSlow { joint }),
            None => {}
        }
        self.state = next;
        Ok(())
    }

    /// Checks a whole stream; on a violation, the index of the set-point that broke the rule comes with it.
    ///
    /// # Errors
    /// The index and the [`Violation`].
    pub fn check<'a>(
        measured: &Joints,
        set_points: impl IntoIterator<Item = &'a Joints>,
        settings: CommandRuleSettings,
    ) -> Result<(), (usize, Violation)> {
        let mut rules = Self::new(measured, settings);
        set_points.into_iter().enumerate().try_for_each(|(i, q)| rules.accept(q).map_err(|violation| (i, violation)))
    }

    fn check_joint(&self, joint: usize, next: &MotionState) -> Result<(), Violation> {
        let limits = &self.settings.limits;
        let exceeds = |value: f64, limit: f64| value.abs() > limit * (1.0 + ROUNDING);
        let value = next.velocity_rad_s[joint];
        let limit = limits.speed_at(joint, next.position_rad[joint], value);
        if value.abs() > STILL_RAD_S && exceeds(value, limit) {
            return Err(Violation::VelocityLimits { joint, value, limit });
        }
        let (value, limit) = (next.acceleration_rad_s2[joint], limits.acceleration_rad_s2[joint]);
        if exceeds(value, limit) {
            return Err(Violation::VelocityDiscontinuity { joint, value, limit });
        }
        let value = (value - self.state.acceleration_rad_s2[joint]) / self.settings.period_s;
        let limit = limits.jerk_rad_s3[joint];
        if exceeds(value, limit) {
            return Err(Violation::AccelerationDiscontinuity { joint, value, limit });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FR3_LIMITS, READY};

    fn ramp(acceleration: f64, count: usize) -> Vec<Joints> {
        (0..count)
            .map(|k| {
                let t = k as f64 * 1e-3;
                let mut q = READY;
                q[0] += 0.5 * acceleration * t * t;
                q
            })
            .collect()
    }

    #[test]
    fn a_gentle_ramp_is_accepted() {
        assert_eq!(CommandRules::check(&READY, &ramp(5.0, 200), CommandRuleSettings::default()), Ok(()));
    }

    #[test]
    fn each_rule_has_its_reflex() {
        let settings = CommandRuleSettings::default();
        let mut far = READY;
        far[2] += 0.01;
        let start = CommandRules::check(&READY, &[far], settings).unwrap_err();
        assert_eq!((start.0, start.1.name()), (0, "start_pose_invalid"));
        let jump = CommandRules::check(&READY, &[READY, far], settings).unwrap_err();
        assert_eq!((jump.0, jump.1.name()), (1, "joint_motion_generator_velocity_limits_violation"));
        // The jerk limit lets the acceleration grow for ten milliseconds before it is too much.
        let growing: Vec<Joints> = (0..50)
            .map(|k| {
                let mut q = READY;
                q[0] += 2000.0 / 6.0 * (f64::from(k) * 1e-3).powi(3);
                q
            })
            .collect();
        let hard = CommandRules::check(&READY, &growing, settings).unwrap_err();
        assert_eq!(hard.1.name(), "joint_motion_generator_velocity_discontinuity");
        let jerky = CommandRules::check(&READY, &ramp(20.0, 50), settings).unwrap_err();
        assert_eq!(jerky.1.name(), "joint_motion_generator_acceleration_discontinuity");
        let mut outside = READY;
        outside[3] = 0.5;
        assert_eq!(
            CommandRules::check(&READY, &[outside], settings).unwrap_err().1.name(),
            "joint_motion_generator_position_limits_violation"
        );
        assert_eq!(CommandRules::check(&READY, &[[f64::NAN; 7]], settings).unwrap_err().1, Violation::NotFinite { joint: 0 });
    }

    #[test]
    fn a_joint_that_stands_where_no_speed_is_allowed_does_not_move_by_rounding() {
        let mut stands = READY;
        stands[6] = FR3_LIMITS.position_upper_rad[6] - 0.001;
        assert_eq!(FR3_LIMITS.speed_at(6, stands[6], 1.0), 0.0);
        let mut rules = CommandRules::new(&stands, CommandRuleSettings { limits: FR3_LIMITS, ..CommandRuleSettings::default() });
        let mut rounded = stands;
        rounded[6] *= 1.0 + f64::EPSILON;
        assert_eq!((rules.accept(&stands), rules.accept(&rounded)), (Ok(()), Ok(())));
        rounded[6] += 1e-6;
        assert_eq!(rules.accept(&rounded).unwrap_err().name(), "joint_motion_generator_velocity_limits_violation");
    }

    #[test]
    fn a_race_towards_a_limit_is_refused_while_it_can_still_be_stopped() {
        let mut rules = CommandRules::new(&READY, CommandRuleSettings::default());
        let refused = ramp(13.95, 2000).iter().find_map(|q| rules.accept(q).err());
        // Half a percent below the velocity limit the acceleration can no longer be taken back in time.
        assert_eq!(refused, Some(Violation::NoRoomToSlow { joint: 0 }));
        assert_eq!(overrun(rules.state(), &LIMITS, 1e-3), None, "what was accepted can be stopped");
        assert!(rules.state().velocity_rad_s[0] > 0.98 * LIMITS.velocity_rad_s[0]);
        let mut near = READY;
        near[0] = LIMITS.position_upper_rad[0] - 0.05;
        let mut rules = CommandRules::new(&near, CommandRuleSettings::default());
        let refused =
            ramp(5.0, 2000).iter().map(|q| std::array::from_fn(|i| q[i] - READY[i] + near[i])).find_map(|q| rules.accept(&q).err());
        assert_eq!(refused, Some(Violation::NoRoomToStop { joint: 0 }));
        assert!(rules.state().position_rad[0] < LIMITS.position_upper_rad[0] - 0.005);
    }
}
