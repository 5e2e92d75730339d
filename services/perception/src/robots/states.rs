//! The newest states of a cell's robots, and where each robot was at the instant of a frame.

use std::collections::{BTreeMap, VecDeque};

use repose_proto::RobotInView;
use repose_proto::robot::RobotState;

/// States of each robot that are kept: more than a frame's way takes, at the rate at which robots tell them.
const KEPT: usize = 128;
/// Robots of a cell that are followed.
const MAX_ROBOTS: usize = 16;
/// A state says where a robot was for this long before and after it, nanoseconds: an arm moves 10 cm in it at most.
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
        let nearest = |states: &VecDeque<RobotState>| {
            let state = states.iter().min_by_key(|state| state.stamp_ns.abs_diff(stamp_ns)).cloned();
            state.filter(|state| state.stamp_ns.abs_diff(stamp_ns) <= HOLDS_NS)
        };
        let in_view = |(name, states): (&String, &VecDeque<RobotState>)| {
            let state = nearest(states)?;
            Some(RobotInView {
                name: name.clone(),
                model: state.model.clone().unwrap_or_else(|| "panda".to_owned()),
                joints_rad: state.q_rad,
                gripper_width_m: state.gripper_width_m.clamp(0.0, 0.08),
                holding: Some(state.gripper_holding),
                world_from_base: state.world_from_base?,
            })
        };
        self.by_robot.iter().filter_map(in_view).collect()
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::RigidTransform;
    use repose_proto::robot::RobotMode;

    use super::*;

    fn state(stamp_ns: u64, first_rad: f64, world_from_base: Option<RigidTransform>) -> RobotState {
        let json = serde_json::json!({
            "v": 1, "seq": 1, "stamp_ns": stamp_ns, "robot_ms": 0.0, "q_rad": [first_rad, 0.0, 0.0, -2.0, 0.0, 2.0, 0.0],
            "dq_rad_s": vec![0.0; 7], "gripper_width_m": 0.04, "gripper_settled": true, "gripper_holding": true, "mode": RobotMode::Idle,
            "stop": null, "owner": null, "last_command": null, "stream_ms": null, "world_from_base": world_from_base,
        });
        serde_json::from_value(json).unwrap()
    }

    #[test]
    fn a_robot_is_where_its_nearest_state_says_and_nowhere_without_one_in_time() {
        let mut states = RobotStates::default();
        for (k, first_rad) in [0.1, 0.2, 0.3].into_iter().enumerate() {
            states.put("left", state(1_000_000_000 + k as u64 * 50_000_000, first_rad, Some(RigidTransform::IDENTITY)));
        }
        states.put("unplaced", state(1_000_000_000, 0.0, None));
        let at = |stamp_ns| states.at(stamp_ns).into_iter().map(|robot| (robot.name, robot.joints_rad[0])).collect::<Vec<_>>();
        assert_eq!(at(1_060_000_000), [("left".to_owned(), 0.2)]);
        assert_eq!(at(1_190_000_000), [("left".to_owned(), 0.3)]);
        assert!(at(2_000_000_000).is_empty());
    }
}
