//! `state` and `stop`: what the robot does, and its emergency stop, which every agent may put.

use std::time::Duration;

use repose_proto::CallError;
use repose_proto::robot::{RobotMode, RobotState};
use repose_runtime::emergency_stop_within;
use repose_sentences::robot::describe;
use schemars::JsonSchema;
use serde::Serialize;

use crate::answer::ToolResult;
use crate::arguments::{StateArguments, StopArguments};
use crate::asker::Asker;
use crate::desk::Desk;

/// How long a robot may take to show a stop before it is said that it has not.
const SHOWN_WITHIN: Duration = Duration::from_secs(5);
/// The longest reason that is passed on, characters.
const REASON: usize = 200;

/// What is said of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct RobotTold {
    /// The robot.
    pub robot: String,
    /// `idle`, `moving` or `stopped`.
    pub mode: RobotMode,
    /// Why it is stopped.
    pub stopped_because: Option<String>,
    /// Whether the hand holds something.
    pub holds_something: bool,
    /// Whether this server is having a plan carried out.
    pub carrying_out: bool,
    /// Whether `execute` is offered.
    pub may_execute: bool,
}

impl Desk {
    /// What the robot does.
    ///
    /// # Errors
    /// `unavailable` on `robot` when it does not say.
    pub async fn state(&self, _: &StateArguments) -> Result<ToolResult, CallError> {
        let state = self.robot_state(self.deadline()).await?;
        self.told(&state)
    }

    /// Stops the robot. The stop goes on when the agent is gone meanwhile.
    ///
    /// # Errors
    /// `deadline_exceeded` when the robot has not shown the stop in time.
    pub async fn stop(&self, asked: &StopArguments, asker: &Asker) -> Result<ToolResult, CallError> {
        let robot = &self.settings().robot;
        let reason: String = asked.reason.as_deref().unwrap_or("stopped by an agent").chars().take(REASON).collect();
        let source = format!("agent {}", asker.client);
        let state = emergency_stop_within(&self.session, robot, &source, &reason, SHOWN_WITHIN).await?;
        self.told(&state)
    }

    fn told(&self, state: &RobotState) -> Result<ToolResult, CallError> {
        let robot = &self.settings().robot;
        let told = RobotTold {
            robot: robot.clone(),
            mode: state.mode,
            stopped_because: state.stop.as_ref().map(|stop| stop.reason.clone()),
            holds_something: state.gripper_holding,
            carrying_out: !self.moves.under_way().is_empty(),
            may_execute: self.settings().allow_execute,
        };
        ToolResult::new(describe(robot, state), &told, None)
    }
}
