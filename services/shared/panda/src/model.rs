//! Which arm it is: the Panda or its successor, the Research 3 (FR3).
//!
//! Both have the same links: the joints' origins in franka_description's `fr3` and `fer` are equal, and the Panda's kinematics, spheres and hand
//! here stand for both. What they may do differs: position limits, speeds, accelerations, jerks.

use crate::{ApproachLimits, FR3_LIMITS, JOINT_COUNT, JointLimits, LIMITS, with_room_to_fade};

/// What libfranka leaves of every velocity, acceleration and jerk limit (`kLimitEps` in `rate_limiting.h`).
const MARGIN: f64 = 1e-3;
/// Set-points that the Panda may lose in a row; the FR3 is to lose none (`kTolNumberPacketsLost`).
const PANDA_LOSES: f64 = 3.0;
const PERIOD_S: f64 = 1e-3;

/// A robot of the family.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Model {
    /// The Franka Emika Panda, also called Franka Emika Robot (FER).
    #[default]
    Panda,
    /// The Franka Research 3.
    Fr3,
}

impl Model {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Panda, Self::Fr3];

    /// Its name in configurations and in a robot's state.
    pub fn name(self) -> &'static str {
        match self {
            Self::Panda => "panda",
            Self::Fr3 => "fr3",
        }
    }

    /// The model of a name.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// Its official limits.
    pub fn limits(self) -> JointLimits {
        match self {
            Self::Panda => LIMITS,
            Self::Fr3 => FR3_LIMITS,
        }
    }

    /// What a controller may command over the network: libfranka's margins off the official limits, and for the Panda the speed that a joint
    /// gains while set-points are lost, for the robot goes on with a constant acceleration then.
    pub fn commanded_limits(self) -> JointLimits {
        let limits = self.limits();
        let lost_s = PERIOD_S * if self == Self::Panda { PANDA_LOSES } else { 0.0 };
        let slower = |i: usize| MARGIN + lost_s * (limits.acceleration_rad_s2[i] - MARGIN);
        let approach = limits
            .approach
            .map(|approach| ApproachLimits { offset_rad_s: std::array::from_fn(|i| approach.offset_rad_s[i] + slower(i)), ..approach });
        JointLimits {
            velocity_rad_s: std::array::from_fn::<_, JOINT_COUNT, _>(|i| limits.velocity_rad_s[i] - slower(i)),
            approach,
            acceleration_rad_s2: limits.acceleration_rad_s2.map(|a| a - MARGIN),
            jerk_rad_s3: limits.jerk_rad_s3.map(|j| j - MARGIN),
            ..limits
        }
    }

    /// What every driver of it carries out, and motions are planned within: what may be commanded, less the room for what the robot is off the arm's
    /// way.
    pub fn driven_limits(self) -> JointLimits {
        with_room_to_fade(&self.commanded_limits())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_model_is_found_by_its_name() {
        for model in Model::ALL {
            assert_eq!(Model::parse(model.name()), Some(model));
        }
        assert_eq!(Model::parse("ur5"), None);
    }

    #[test]
    fn commanded_limits_are_libfrankas() {
        let panda = Model::Panda.commanded_limits();
        // `kMaxJointVelocity` of libfranka 0.9: 2.1750 - 1e-3 - 3 · 1e-3 · 14.999.
        assert!((panda.velocity_rad_s[0] - 2.129_003).abs() < 1e-9);
        let fr3 = Model::Fr3.commanded_limits();
        assert!((fr3.velocity_rad_s[4] - 5.259).abs() < 1e-9);
        assert!((fr3.speed_at(0, 2.7, 1.0) - 0.474_370).abs() < 1e-6, "computeUpperLimitsJointVelocity of libfranka 0.21");
        assert!((fr3.acceleration_rad_s2[0] - 9.999).abs() < 1e-9);
    }

    #[test]
    fn what_drivers_carry_out_lies_within_what_may_be_commanded() {
        for model in Model::ALL {
            let (driven, commanded) = (model.driven_limits(), model.commanded_limits());
            assert_eq!(driven.narrower(&commanded), driven);
            assert_eq!(driven.narrower(&model.limits()), driven);
            assert!(!driven.contains(&commanded.between(&[0.0; JOINT_COUNT]), 0.0), "there is room at the position limits");
        }
    }
}
