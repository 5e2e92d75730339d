//! The newest states of a cell's robots, and where each robot was at the instant of a frame.

use std::collections::{BTreeMap, VecDeque};

use repose_proto::RobotInView;
use repose_proto::robot::RobotState;

/// States of each robot that are kept: more than a frame's way takes, at the rate at which robots tell them.
const KEPT: usize = 128;
/// Robots of a cell that are followed.
const MAX_ROBOTS: usize = 16;
/// A state says where a robot was for this long before and after it, nanoseconds: an arm that is stopped meanwhile is 10 cm off at most.
const HOLDS_NS: u64 = 100_000_000;

/// States by robot, oldest first.
#[derive(Debug, Default)]
pub struct RobotStates {
    by_robot: BTreeMap<String, VecDeque<RobotState>>,
}

impl RobotStates {
    /// A robot told its state.
    pub fn put(&mut self, robot: &str, state: RobotState) {
        if !self.by_robot.contains_key(robot) && self.by_robot.len() >= MAX_ROBOTS {
            return;
        }
        let states = self.by_robot.entry(robot.to_owned()).or_default();
        states.push_back(state);
        if states.len() > KEPT {
            states.pop_front();
        }
    }

    /// The robots at an instant, of those that say where their base stands.
    pub fn at(&self, stamp_ns: u64) -> Vec<RobotInView> {
        self.by_robot.iter().filter_map(|(name, states)| in_view(name, states, stamp_ns)).collect()
    }
}

/// A robot at an instant: between the states before and after it, or as the only near one says that it moved.
fn in_view(name: &str, states: &VecDeque<RobotState>, stamp_ns: u64) -> Option<RobotInView> {
    let holds = |state: &&RobotState| state.stamp_ns.abs_diff(stamp_ns) <= HOLDS_NS;
    let before = states.iter().filter(holds).filter(|state| state.stamp_ns <= stamp_ns).max_by_key(|state| state.stamp_ns);
    let after = states.iter().filter(holds).filter(|state| state.stamp_ns > stamp_ns).min_by_key(|state| state.stamp_ns);
    let (nearest, joints_rad, width_m) = match (before, after) {
        (Some(a), Some(b)) => {
            let (since_ns, to_ns) = (stamp_ns - a.stamp_ns, b.stamp_ns - stamp_ns);
            let share = since_ns as f64 / (since_ns + to_ns) as f64;
            let between = |a: f64, b: f64| a + (b - a) * share;
            let joints_rad = std::array::from_fn(|i| between(a.q_rad[i], b.q_rad[i]));
            (if since_ns <= to_ns { a } else { b }, joints_rad, between(a.gripper_width_m, b.gripper_width_m))
        }
        (Some(only), None) | (None, Some(only)) => {
            let since_s = (stamp_ns as f64 - only.stamp_ns as f64) * 1e-9;
            (only, std::array::from_fn(|i| only.q_rad[i] + only.dq_rad_s[i] * since_s), only.gripper_width_m)
        }
        (None, None) => return None,
    };
    Some(RobotInView {
        name: name.to_owned(),
        model: nearest.model.clone().unwrap_or_else(|| "panda".to_owned()),
        joints_rad,
        gripper_width_m: width_m.clamp(0.0, 0.08),
        holding: Some(nearest.gripper_holding),
        world_from_base: nearest.world_from_base?,
    })
}

#[cfg(test)]
mod tests {
    use repose_proto::RigidTransform;
    use repose_proto::robot::RobotMode;

    use super::*;

    /// A state in which the first joint turns at 0.2 rad/s.
    fn state(stamp_ns: u64, first_rad: f64, world_from_base: Option<RigidTransform>) -> RobotState {
        let json = serde_json::json!({
            "v": 1, "seq": 1, "stamp_ns": stamp_ns, "robot_ms": 0.0, "q_rad": [first_rad, 0.0, 0.0, -2.0, 0.0, 2.0, 0.0],
            "dq_rad_s": [0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "gripper_width_m": 0.04, "gripper_settled": true, "gripper_holding": true, "mode": RobotMode::Idle,
            "stop": null, "owner": null, "last_command": null, "stream_ms": null, "world_from_base": world_from_base,
        });
        serde_json::from_value(json).unwrap()
    }

    #[test]
    fn a_robot_is_between_its_states_or_on_its_way_from_the_last_and_nowhere_without_one_in_time() {
        let mut states = RobotStates::default();
        // Another robot's side may put them late.
        for (k, first_rad) in [(1, 0.2), (0, 0.1), (2, 0.3)] {
            states.put("left", state(1_000_000_000 + k as u64 * 50_000_000, first_rad, Some(RigidTransform::IDENTITY)));
        }
        states.put("unplaced", state(1_000_000_000, 0.0, None));
        let at = |stamp_ns| states.at(stamp_ns).into_iter().map(|robot| (robot.name, robot.joints_rad[0])).collect::<Vec<_>>();
        for (stamp_ns, first_rad) in [(1_000_000_000, 0.1), (1_060_000_000, 0.22), (1_190_000_000, 0.3 + 0.09 * 0.2), (990_000_000, 0.098)]
        {
            let seen = at(stamp_ns);
            assert!(seen.len() == 1 && seen[0].0 == "left" && (seen[0].1 - first_rad).abs() < 1e-9, "{stamp_ns}: {seen:?}");
        }
        assert!(at(2_000_000_000).is_empty());
    }
}
