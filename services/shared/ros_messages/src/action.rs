//! What every action is made of: `action_msgs`, `unique_identifier_msgs`, and the services that are derived from an action's definition.

use serde::{Deserialize, Serialize};

use crate::common::Time;

/// `unique_identifier_msgs/msg/UUID`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Uuid {
    /// Its bytes.
    pub uuid: [u8; 16],
}

/// `action_msgs/msg/GoalInfo`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GoalInfo {
    /// The goal; all zeros means every goal.
    pub goal_id: Uuid,
    /// When it was accepted.
    pub stamp: Time,
}

/// `action_msgs/msg/GoalStatus`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GoalStatus {
    /// The goal.
    pub goal_info: GoalInfo,
    /// One of [`status`].
    pub status: i8,
}

/// `action_msgs/msg/GoalStatusArray`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GoalStatusArray {
    /// The goals of a server.
    pub status_list: Vec<GoalStatus>,
}

/// The states of a goal.
pub mod status {
    /// Being carried out.
    pub const EXECUTING: i8 = 2;
    /// Reached.
    pub const SUCCEEDED: i8 = 4;
    /// Ended because its client asked for it.
    pub const CANCELED: i8 = 5;
    /// Ended by the server.
    pub const ABORTED: i8 = 6;

    /// The state's name.
    pub fn name(status: i8) -> &'static str {
        match status {
            1 => "accepted",
            EXECUTING => "executing",
            3 => "canceling",
            SUCCEEDED => "succeeded",
            CANCELED => "canceled",
            ABORTED => "aborted",
            _ => "unknown",
        }
    }
}

/// `action_msgs/srv/CancelGoal`, the request.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CancelGoalRequest {
    /// Which goals.
    pub goal_info: GoalInfo,
}

/// `action_msgs/srv/CancelGoal`, the response.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CancelGoalResponse {
    /// [`Self::NONE`], or why none is being canceled.
    pub return_code: i8,
    /// Those.
    pub goals_canceling: Vec<GoalInfo>,
}

impl CancelGoalResponse {
    /// At least one goal is being canceled.
    pub const NONE: i8 = 0;
    /// There is no goal of that id.
    pub const UNKNOWN_GOAL_ID: i8 = 2;
    /// The goal cannot be canceled any more.
    pub const GOAL_TERMINATED: i8 = 3;
}

/// The request that sends a goal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SendGoalRequest<G> {
    /// The goal's id, chosen by the client.
    pub goal_id: Uuid,
    /// The goal.
    pub goal: G,
}

/// Whether a goal was accepted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SendGoalResponse {
    /// Whether it was.
    pub accepted: bool,
    /// When.
    pub stamp: Time,
}

/// The request that waits for a goal's result.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetResultRequest {
    /// The goal.
    pub goal_id: Uuid,
}

/// A goal's result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GetResultResponse<R> {
    /// How it ended, one of [`status`].
    pub status: i8,
    /// The result.
    pub result: R,
}

/// How far a goal is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FeedbackMessage<F> {
    /// The goal.
    pub goal_id: Uuid,
    /// How far.
    pub feedback: F,
}
