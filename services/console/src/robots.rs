//! A cell's robots, as they were last heard of. Names come and go while somebody looks at a cell for weeks: those long silent are forgotten.

use std::collections::BTreeMap;
use std::time::Instant;

use repose_proto::followed_robots::{MAX_ROBOTS, SILENT};
use repose_proto::robot::RobotState;

use crate::system::REMEMBERED;

/// What each robot has told last, and when.
#[derive(Default)]
pub struct KnownRobots(BTreeMap<String, (Instant, RobotState)>);

impl KnownRobots {
    /// Notes a state of a robot; whether there is room for it. Where as many are known as are followed, the one that has been silent for longest goes.
    pub fn saw(&mut self, robot: &str, state: RobotState, at: Instant) -> bool {
        if self.0.len() >= MAX_ROBOTS && !self.0.contains_key(robot) {
            let silent = self.0.iter().filter(|(_, (heard, _))| at.duration_since(*heard) > SILENT);
            let Some(gone) = silent.min_by_key(|(_, (heard, _))| *heard).map(|(name, _)| name.clone()) else { return false };
            self.0.remove(&gone);
        }
        self.0.insert(robot.to_owned(), (at, state));
        true
    }

    /// The newest state of one.
    pub fn state(&self, robot: &str) -> Option<&RobotState> {
        self.0.get(robot).map(|(_, state)| state)
    }

    /// The names of all; those long silent are forgotten.
    pub fn names(&mut self, now: Instant) -> Vec<String> {
        self.0.retain(|_, (heard, _)| now.duration_since(*heard) < REMEMBERED);
        self.0.keys().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use serde_json::json;

    use super::*;

    fn state() -> RobotState {
        let still = [0.0; 7];
        serde_json::from_value(json!({"v": 1, "seq": 1, "stamp_ns": 1, "robot_ms": 0.0, "q_rad": still, "dq_rad_s": still,
            "gripper_width_m": 0.04, "gripper_settled": true, "gripper_holding": false, "mode": "idle"}))
        .expect("a state")
    }

    #[test]
    fn names_that_come_and_go_leave_room_for_the_robots_that_are_there() {
        let (mut robots, start) = (KnownRobots::default(), Instant::now());
        for k in 0..MAX_ROBOTS {
            assert!(robots.saw(&format!("robot-{k}"), state(), start + Duration::from_millis(k as u64)));
        }
        assert!(!robots.saw("another", state(), start + SILENT / 2), "all the others live");
        assert!(robots.saw("robot-0", state(), start + SILENT) && robots.saw("another", state(), start + 2 * SILENT));
        assert!(robots.state("another").is_some() && robots.state("robot-0").is_some());
        assert!(robots.state("robot-1").is_none(), "it has been silent for the longest");
        assert_eq!(robots.names(start + 2 * SILENT).len(), MAX_ROBOTS);
        assert_eq!(robots.names(start + REMEMBERED + SILENT), ["another"]);
        assert!(robots.names(start + REMEMBERED + 2 * SILENT).is_empty());
    }
}
