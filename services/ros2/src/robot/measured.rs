//! Where the joints are, from `JointState` messages, which may come in parts and in any order of joints.

use repose_ros_messages::JointState;

use crate::config::RobotConfig;

/// The joints of one robot.
#[derive(Debug, Clone)]
pub struct Measured {
    joints: [String; 7],
    fingers: Vec<String>,
    q_rad: [Option<f64>; 7],
    fingers_m: Vec<Option<f64>>,
    /// When all seven had been told anew, milliseconds.
    whole_at_ms: Option<u64>,
    told: [bool; 7],
    /// Whether the last message told of a finger.
    told_fingers: bool,
}

impl Measured {
    /// Nothing so far.
    pub fn new(config: &RobotConfig) -> Self {
        let fingers = config.finger_joints.clone();
        Self {
            joints: config.joints.clone(),
            fingers_m: vec![None; fingers.len()],
            fingers,
            q_rad: [None; 7],
            whole_at_ms: None,
            told: [false; 7],
            told_fingers: false,
        }
    }

    /// Takes a message; whether all seven joints have been told since this last was so.
    pub fn take(&mut self, state: &JointState, now_ms: u64) -> bool {
        self.told_fingers = false;
        for (name, position) in state.name.iter().zip(&state.position).filter(|(_, position)| position.is_finite()) {
            if let Some(i) = self.joints.iter().position(|joint| joint == name) {
                (self.q_rad[i], self.told[i]) = (Some(*position), true);
            }
            if let Some(i) = self.fingers.iter().position(|finger| finger == name) {
                (self.fingers_m[i], self.told_fingers) = (Some(*position), true);
            }
        }
        let whole = self.told.iter().all(|told| *told);
        if whole {
            (self.told, self.whole_at_ms) = ([false; 7], Some(now_ms));
        }
        whole
    }

    /// Joint positions, radians, once all seven are known.
    pub fn q_rad(&self) -> Option<[f64; 7]> {
        self.whole_at_ms?;
        let mut q_rad = [0.0; 7];
        for (q, known) in q_rad.iter_mut().zip(&self.q_rad) {
            *q = (*known)?;
        }
        Some(q_rad)
    }

    /// How far the joints are from a configuration, radians: the furthest of them; not at all while they are not known.
    pub fn off_rad(&self, from_rad: &[f64; 7]) -> f64 {
        let off = |q_rad: [f64; 7]| q_rad.iter().zip(from_rad).map(|(q, from)| (q - from).abs()).fold(0.0, f64::max);
        self.q_rad().map_or(0.0, off)
    }

    /// The gripper's opening, metres: what the fingers' positions add up to. None where the last message did not tell of them: nobody knows then
    /// whether they stand.
    pub fn width_m(&self) -> Option<f64> {
        let known: Option<Vec<f64>> = self.fingers_m.iter().copied().collect();
        known.filter(|_| self.told_fingers).map(|fingers| fingers.iter().sum())
    }

    /// How long ago the joints were told, milliseconds.
    pub fn age_ms(&self, now_ms: u64) -> Option<u64> {
        self.whole_at_ms.map(|at_ms| now_ms.saturating_sub(at_ms))
    }

    /// The joints that nobody has told of yet.
    pub fn missing(&self) -> Vec<&str> {
        self.joints.iter().zip(&self.q_rad).filter(|(_, q)| q.is_none()).map(|(joint, _)| joint.as_str()).collect()
    }

    /// The finger joints that nobody has told of yet.
    pub fn missing_fingers(&self) -> Vec<&str> {
        self.fingers.iter().zip(&self.fingers_m).filter(|(_, at)| at.is_none()).map(|(finger, _)| finger.as_str()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_messages_that_name_the_fingers_tell_of_them() {
        let config: RobotConfig = toml::from_str("name = \"panda\"\ntrajectory_action = \"/arm\"").expect("a robot");
        let mut measured = Measured::new(&config);
        let mut tell = |names: &[&str]| {
            let name = names.iter().map(|name| (*name).to_owned()).collect();
            measured.take(&JointState { name, position: vec![0.02; names.len()], ..JointState::default() }, 0);
            measured.width_m()
        };
        assert_eq!(tell(&["panda_finger_joint1", "panda_finger_joint2"]), Some(0.04));
        assert_eq!(tell(&["panda_joint1", "panda_joint2"]), None);
    }
}
