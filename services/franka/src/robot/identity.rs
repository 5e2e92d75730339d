//! Whether the robot is the one that the configuration says: its protocol, its joints' places, its limits.
//!
//! A Panda speaks version 5 of the control interface and says nothing more of itself. An FR3 speaks version 10 and hands out its URDF: the
//! flange has to be where the driver's own kinematics have it, and of the robot's limits and the driver's the narrower ones count.

use franka::joint_velocity_limits::JointVelocityLimitsConfig;
use franka::{FciVersion, Frame, Model as RobotModel};
use repose_panda::{ApproachLimits, JointLimits, Joints, Model, READY, base_from_flange};

/// How far the flange may be from where it is expected, metres: the URDF's numbers have fewer digits.
const FLANGE_M: f64 = 1e-4;
/// Limits further apart than this are another robot's, in radians and their rates.
const SAME: f64 = 1e-3;

/// The protocol that a model speaks.
pub fn version_of(model: Model) -> FciVersion {
    match model {
        Model::Panda => FciVersion::V5,
        Model::Fr3 => FciVersion::V10,
    }
}

/// What a robot's own description says of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Identity {
    /// The limits that it may be commanded under.
    pub limits: JointLimits,
    /// What is otherwise than known, for a person.
    pub notes: Vec<String>,
}

/// Reads the description of a robot that should be `model`.
///
/// # Errors
/// What it is not.
pub fn identify(model: Model, urdf: &str) -> Result<Identity, String> {
    let robot = RobotModel::from_urdf(urdf).map_err(|e| format!("its description cannot be read: {e}"))?;
    let identity_m = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    for joints in [READY, [0.4, -0.5, 0.6, -1.7, 0.8, 1.9, -1.0]] {
        let theirs = robot.pose_q(Frame::Flange, &joints, &identity_m, &identity_m);
        let ours = base_from_flange(&joints).translation.vector;
        let apart_m = (0..3).map(|i| (theirs[12 + i] - ours[i]).powi(2)).sum::<f64>().sqrt();
        // What is no number is not near.
        if !(0.0..=FLANGE_M).contains(&apart_m) {
            return Err(format!("its flange is {apart_m:.4} m from where a {}'s is: it is another robot", model.name()));
        }
    }
    let theirs = limits_of(model, urdf)?;
    let known = model.limits();
    let differs = |what: &str, unit: &str, theirs: &Joints, known: &Joints| {
        let joint = (0..theirs.len()).find(|&i| (theirs[i] - known[i]).abs() > SAME)?;
        Some(format!("joint {joint}: the robot's {what} is {} {unit}, known is {}; the narrower one counts", theirs[joint], known[joint]))
    };
    let notes = [
        differs("lowest angle", "rad", &theirs.position_lower_rad, &known.position_lower_rad),
        differs("highest angle", "rad", &theirs.position_upper_rad, &known.position_upper_rad),
        differs("highest speed", "rad/s", &theirs.velocity_rad_s, &known.velocity_rad_s),
    ];
    // The margins of commands are those of the known limits; the robot's own may be narrower than that.
    Ok(Identity { limits: model.commanded_limits().narrower(&theirs), notes: notes.into_iter().flatten().collect() })
}

/// The limits in a robot's description; accelerations and jerks, which no description has, are the model's.
fn limits_of(model: Model, urdf: &str) -> Result<JointLimits, String> {
    let read = JointVelocityLimitsConfig::from_urdf(urdf).map_err(|e| format!("its limits cannot be read: {e}"))?;
    let each = |of: fn(&franka::joint_velocity_limits::PositionBasedJointVelocityLimitConstants) -> f64| {
        std::array::from_fn(|i| of(&read.joint_params()[i]))
    };
    Ok(JointLimits {
        position_lower_rad: each(|joint| joint.lower_position_limit),
        position_upper_rad: each(|joint| joint.upper_position_limit),
        velocity_rad_s: each(|joint| joint.max_velocity),
        approach: Some(ApproachLimits {
            deceleration_rad_s2: each(|joint| joint.deceleration_limit),
            offset_rad_s: each(|joint| joint.velocity_offset),
        }),
        ..model.limits()
    })
}

#[cfg(test)]
mod tests {
    use franka::model::{FER_URDF, FR3_URDF};
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn an_fr3_is_known_by_its_description_and_its_limits_are_ours() {
        let identity = identify(Model::Fr3, FR3_URDF).expect("an FR3");
        assert_eq!(identity.notes, Vec::<String>::new());
        assert_eq!(identity.limits, Model::Fr3.commanded_limits());
        assert_eq!(limits_of(Model::Fr3, FR3_URDF).expect("limits"), Model::Fr3.limits());
    }

    #[test]
    fn a_robot_with_longer_links_or_without_limits_is_refused() {
        let longer = FR3_URDF.replace("xyz=\"0 -0.316 0\"", "xyz=\"0 -0.326 0\"");
        assert_ne!(longer, FR3_URDF);
        assert!(identify(Model::Fr3, &longer).expect_err("another robot").contains("another robot"));
        assert!(identify(Model::Fr3, FER_URDF).expect_err("no FR3").contains("limits"));
        assert!(identify(Model::Fr3, "<robot/>").is_err());
    }

    #[test]
    fn narrower_limits_of_the_robot_count_and_are_said() {
        let slower = FR3_URDF.replacen("velocity=\"2.62\"", "velocity=\"1.5\"", 1);
        let identity = identify(Model::Fr3, &slower).expect("an FR3");
        assert_eq!(identity.limits.velocity_rad_s[0], 1.5);
        assert!(identity.notes[0].contains("joint 0"), "{:?}", identity.notes);
    }

    proptest! {
        #[test]
        fn the_fr3_has_the_pandas_links(u in prop::array::uniform7(0.0..1.0f64)) {
            let joints = Model::Panda.limits().between(&u);
            let origin = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
            let [fr3, panda] = [FR3_URDF, FER_URDF].map(|urdf| RobotModel::from_urdf(urdf).expect("a robot"));
            for frame in Frame::ALL {
                let [a, b] = [&fr3, &panda].map(|robot| robot.pose_q(frame, &joints, &origin, &origin));
                prop_assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-5), "{:?}", frame);
            }
            let flange = fr3.pose_q(Frame::Flange, &joints, &origin, &origin);
            let ours = base_from_flange(&joints);
            prop_assert!((0..3).all(|i| (flange[12 + i] - ours.translation.vector[i]).abs() < 1e-5));
        }
    }
}
