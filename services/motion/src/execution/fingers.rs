//! Fingers within an execution: waited for until they have settled where they were sent, then what they hold is told from nothing.

use repose_proto::motion::{ExecutionOutcome, Phase};
use repose_proto::robot::RobotState;

use super::{Execution, ExecutionAction, Stage, Taken};

/// How long a gripper is given before its settling is believed, milliseconds of robot time.
const SETTLED_MS: f64 = 100.0;
/// How far from its commanded width a gripper may stand to have reached it, metres.
const REACHED_M: f64 = 0.004;
/// Fingers that are further apart or nearer than they were by more than this have moved, metres.
const MOVED_M: f64 = 0.001;
/// Fingers that do not settle stand where they have been for this long, milliseconds of robot time: they press and tremble.
const STANDS_MS: f64 = 500.0;

/// What was seen of the fingers since a phase began.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fingers {
    /// How far apart they were at its beginning, metres.
    from_m: f64,
    /// How far apart they stand, metres, and since when, milliseconds of robot time.
    stand_m: f64,
    stand_since_ms: f64,
}

impl Fingers {
    /// At the beginning of a phase.
    pub(super) fn of(state: &RobotState) -> Self {
        Self { from_m: state.gripper_width_m, stand_m: state.gripper_width_m, stand_since_ms: state.robot_ms }
    }

    /// Takes a state.
    pub(super) fn see(&mut self, state: &RobotState) {
        if (state.gripper_width_m - self.stand_m).abs() > MOVED_M {
            (self.stand_m, self.stand_since_ms) = (state.gripper_width_m, state.robot_ms);
        }
    }

    fn stand(&self, state: &RobotState) -> bool {
        state.robot_ms - self.stand_since_ms >= STANDS_MS
    }
}

impl Execution {
    /// A gripper that says it has settled is believed where that can be: one that has refused its action says so too, and one that begins late has
    /// settled where it was before.
    pub(super) fn watch_gripper(&mut self, taken: Taken, settled_since_ms: Option<f64>, now_ms: u64) -> Vec<ExecutionAction> {
        let robot_ms = self.last_state.robot_ms;
        let since_ms = settled_since_ms.unwrap_or(robot_ms);
        self.stage = Stage::Gripper { taken, settled_since_ms: Some(since_ms) };
        let waited_ms = robot_ms - since_ms;
        let has_acted = self.has_acted();
        let is_settled = self.last_state.gripper_settled && waited_ms >= SETTLED_MS && has_acted;
        if !is_settled && waited_ms <= self.settings.gripper_timeout_ms {
            return Vec::new();
        }
        let stand = is_settled || self.fingers.stand(&self.last_state);
        if let Some(reason) = self.cancelled.take() {
            return if stand { self.end_at_fingers(reason, now_ms) } else { self.stopped(reason) };
        }
        let (width_m, wanted_m) = (self.last_state.gripper_width_m, self.wanted_m());
        if self.current().name == Phase::Grasp {
            if self.is_there() && !self.last_state.gripper_holding {
                return self.end(ExecutionOutcome::GraspLost, Some("the gripper closed on nothing".to_owned()), now_ms);
            }
            // Fingers that press may tremble for long: standing well apart is holding too. Those on their way would sweep the object along.
            if has_acted && !stand {
                return self.stopped(self.unsettled(width_m));
            }
            self.grasp_width_m = width_m;
        }
        let may_go_on = has_acted && (is_settled || self.current().name == Phase::Grasp || self.is_there());
        if !may_go_on {
            return self.end_at_fingers(format!("the gripper stands at {width_m:.3} m and was sent to {wanted_m:.3} m"), now_ms);
        }
        self.enter_stream(now_ms)
    }

    /// Ends it at fingers that are through with what they were told. Those that are not may close on something yet, and may hold what the robot's side
    /// does not say: then that has to know that the task was never closed.
    fn end_at_fingers(&mut self, reason: String, now_ms: u64) -> Vec<ExecutionAction> {
        match self.last_state.gripper_settled {
            true => self.end(ExecutionOutcome::Stopped, Some(reason), now_ms),
            false => self.stopped(reason),
        }
    }

    /// Ends it on the way. With an object, fingers that have not settled may hold it though the robot's side does not say so: they are waited for.
    pub(super) fn end_on_the_way(&mut self, reason: String, now_ms: u64) -> Vec<ExecutionAction> {
        let may_hold = self.current().name.is_carrying() && !self.last_state.gripper_settled && !self.last_state.gripper_holding;
        match self.stage {
            Stage::Stream { taken, .. } if may_hold && self.is_taken(taken.first_seq) => {
                self.cancelled = Some(reason);
                self.stage = Stage::Slip { taken, since_ms: self.last_state.robot_ms };
                self.kept_alive()
            }
            _ => self.end(ExecutionOutcome::Stopped, Some(reason), now_ms),
        }
    }

    /// Where the phase's gripper action sends the fingers, metres.
    fn wanted_m(&self) -> f64 {
        self.current().gripper.map_or(0.0, |g| g.width_m)
    }

    /// Whether the fingers stand where the phase's action sends them.
    fn is_there(&self) -> bool {
        (self.last_state.gripper_width_m - self.wanted_m()).abs() <= REACHED_M
    }

    /// Whether the fingers are where the phase's action may leave them: where they were sent, or, closing on something and opening beside something,
    /// on the way there from where they were.
    fn has_acted(&self) -> bool {
        let (width_m, from_m) = (self.last_state.gripper_width_m, self.fingers.from_m);
        self.is_there()
            || match self.current().name {
                Phase::Grasp => self.last_state.gripper_holding || from_m - width_m > MOVED_M,
                Phase::Release => width_m - from_m > REACHED_M,
                _ => false,
            }
    }

    fn unsettled(&self, width_m: f64) -> String {
        let waited_s = self.settings.gripper_timeout_ms / 1e3;
        format!("the fingers have not settled within {waited_s:.1} s; they are at {width_m:.3} m (see `[motion] gripper_timeout_ms`)")
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
            return self.end_at_fingers(reason, now_ms);
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
