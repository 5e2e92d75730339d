//! What a robot does and holds, who commands it, and what can be done.

use repose_proto::robot::{RobotMode, RobotState};

/// A robot's state for a person: what it does, what it holds, who commands, and what can be done.
pub fn describe(robot: &str, state: &RobotState) -> String {
    let mut said = vec![match (&state.stop, state.mode) {
        (Some(stop), _) => format!("{robot} is stopped: {} ({})", stop.reason, stop.kind),
        (None, RobotMode::Stopped) => format!("{robot} is stopped and does not say why"),
        (None, RobotMode::Idle) => format!("{robot} stands"),
        (None, RobotMode::Moving) => format!("{robot} moves"),
    }];
    said.push(match (&state.held, state.gripper_holding) {
        (Some(held), _) => format!("it holds object {} of scene {}", held.object, held.scene_id.chars().take(12).collect::<String>()),
        (None, true) => format!("it holds something {:.0} mm wide", state.gripper_width_m * 1e3),
        (None, false) => format!("its hand is empty, fingers {:.0} mm apart", state.gripper_width_m * 1e3),
    });
    said.push(match (&state.owner, state.open_task()) {
        (Some(owner), Some(task)) => format!("{} commands it (task {task})", owner.id),
        (Some(owner), None) => format!("{} commanded it last", owner.id),
        (None, _) => "nobody has commanded it".to_owned(),
    });
    if state.mode == RobotMode::Stopped {
        said.push("`repose robot reset` clears the stop; then `repose robot open`, `retreat` and `home` bring it back".to_owned());
    }
    said.join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_is_said_with_its_reason_and_the_way_out() {
        let still = [0.0; 7];
        let mut state: RobotState = serde_json::from_value(serde_json::json!({
            "v": 1, "seq": 1, "stamp_ns": 0, "robot_ms": 0.0, "q_rad": still, "dq_rad_s": still, "gripper_width_m": 0.04,
            "gripper_settled": true, "gripper_holding": false, "mode": "idle", "stop": null, "owner": null, "last_command": null, "stream_ms": null
        }))
        .expect("a state");
        assert_eq!(describe("panda", &state), "panda stands; its hand is empty, fingers 40 mm apart; nobody has commanded it");
        state.mode = RobotMode::Stopped;
        state.stop = serde_json::from_value(serde_json::json!({"kind": "estop", "reason": "a hand"})).expect("a stop");
        let said = describe("panda", &state);
        assert!(said.contains("stopped: a hand (estop)") && said.contains("repose robot reset"), "{said}");
    }
}
