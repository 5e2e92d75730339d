//! A cell's robots, as they were last heard of. Names come and go while somebody looks at a cell for weeks: those long silent are forgotten.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use repose_proto::robot::RobotState;

use crate::system::REMEMBERED;

/// Robots that are known at once; further ones are left out.
const MOST: usize = 16;
/// One that has told nothing for longer makes room for another, where there are as many as are known: states come twenty times a second or more often.
const SILENT: Duration = Duration::from_secs(2);

/// What each robot has told last, and when.
#[derive(Default)]
pub struct KnownRobots(BTreeMap<String, (Instant, RobotState)>);

impl KnownRobots {
    /// Notes a state of a robot; whether there is room for it.
    pub fn saw(&mut self, robot: &str, state: RobotState, at: Instant) -> bool {
        if self.0.len() >= MOST && !self.0.contains_key(robot) {
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
        for k in 0..MOST {
            assert!(robots.saw(&format!("robot-{k}"), state(), start + Duration::from_millis(k as u64)));
        }
        assert!(!robots.saw("another", state(), start + SILENT / 2), "all the others live");
        assert!(robots.saw("robot-0", state(), start + SILENT) && robots.saw("another", state(), start + 2 * SILENT));
        assert!(robots.state("another").is_some() && robots.state("robot-0").is_some());
        assert!(robots.state("robot-1").is_none(), "it has been silent for the longest");
        assert_eq!(robots.names(start + 2 * SILENT).len(), MOST);
        assert_eq!(robots.names(start + REMEMBERED + SILENT), ["another"]);
        assert!(robots.names(start + REMEMBERED + 2 * SILENT).is_empty());
    }
}
