//! Fingers within an execution: waited for until they have settled, then what they hold is told from nothing.

use repose_proto::motion::{ExecutionOutcome, Phase};

use super::{Execution, ExecutionAction, Stage, Taken};

/// How long a gripper is given before its settling is believed, milliseconds of robot time.
const SETTLED_MS: f64 = 100.0;
/// How far from its commanded width a gripper that does not settle may stand to have reached it, metres.
const REACHED_M: f64 = 0.004;

impl Execution {
    pub(super) fn watch_gripper(&mut self, taken: Taken, settled_since_ms: Option<f64>, now_ms: u64) -> Vec<ExecutionAction> {
        let robot_ms = self.last_state.robot_ms;
        let since_ms = settled_since_ms.unwrap_or(robot_ms);
        self.stage = Stage::Gripper { taken, settled_since_ms: Some(since_ms) };
        let waited_ms = robot_ms - since_ms;
        let is_settled = self.last_state.gripper_settled && waited_ms >= SETTLED_MS;
        if !is_settled && waited_ms <= self.settings.gripper_timeout_ms {
            return Vec::new();
        }
        if let Some(reason) = self.cancelled.take() {
            return self.end(ExecutionOutcome::Stopped, Some(reason), now_ms);
        }
        let (width_m, wanted_m) = (self.last_state.gripper_width_m, self.current().gripper.map_or(0.0, |g| g.width_m));
        if self.current().name == Phase::Grasp {
            // Fingers that press may tremble for long: standing well apart is holding too.
            if !self.last_state.gripper_holding && width_m <= wanted_m + REACHED_M {
                return self.end(ExecutionOutcome::GraspLost, Some("the gripper closed on nothing".to_owned()), now_ms);
            }
            self.grasp_width_m = width_m;
        } else if !is_settled && (width_m - wanted_m).abs() > REACHED_M {
            let reason = format!("the gripper stands at {width_m:.3} m and was sent to {wanted_m:.3} m");
            return self.end(ExecutionOutcome::Stopped, Some(reason), now_ms);
        }
        self.enter_stream(now_ms)
    }

    /// Waits for fingers that have closed further on the way. What slipped, and is held again where it is thinner, is carried on: a task that is
    /// closed with it in the hand needs a person, and where it ends up is looked at when it is down.
    pub(super) fn watch_slip(&mut self, since_ms: f64, now_ms: u64) -> Vec<ExecutionAction> {
        let state = &self.last_state;
        let waited_ms = state.robot_ms - since_ms;
        let is_settled = state.gripper_settled && waited_ms >= SETTLED_MS;
        if !is_settled && waited_ms <= self.settings.gripper_timeout_ms {
            return Vec::new();
        }
        let is_held = state.gripper_holding || state.gripper_width_m > self.grasp_wanted_m() + REACHED_M;
        let width_m = state.gripper_width_m;
        if let Some(reason) = self.cancelled.take() {
            return self.end(ExecutionOutcome::Stopped, Some(reason), now_ms);
        }
        if !is_held {
            return self.end(ExecutionOutcome::GraspLost, Some("the object was lost on the way".to_owned()), now_ms);
        }
        self.grasp_width_m = width_m;
        self.next_phase(now_ms)
    }

    /// Where the fingers were sent to grasp, metres.
    fn grasp_wanted_m(&self) -> f64 {
        self.phases.iter().find(|phase| phase.name == Phase::Grasp).and_then(|phase| phase.gripper).map_or(0.0, |g| g.width_m)
    }
}
