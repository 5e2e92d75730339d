//! The client's side of an action: three services and two topics.

use std::time::Duration;

use repose_ros_messages::{
    CancelGoalRequest, CancelGoalResponse, FeedbackMessage, GetResultRequest, GetResultResponse, GoalInfo, GoalStatusArray,
    SendGoalRequest, SendGoalResponse, Uuid,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::sync::Mutex;

use super::endpoints::{Node, RosSubscription};
use super::service::RosClient;
use crate::error::BridgeError;
use crate::wire::names::Qos;

/// The names of the types that are derived from an action's.
#[derive(Debug, Clone, Copy)]
pub struct ActionTypes {
    /// The service that sends a goal.
    pub send_goal: &'static str,
    /// The service that waits for its result.
    pub get_result: &'static str,
    /// The message that says how far it is.
    pub feedback: &'static str,
}

impl ActionTypes {
    /// `control_msgs/action/FollowJointTrajectory`.
    pub const FOLLOW_JOINT_TRAJECTORY: Self = Self {
        send_goal: "control_msgs/action/FollowJointTrajectory_SendGoal",
        get_result: "control_msgs/action/FollowJointTrajectory_GetResult",
        feedback: "control_msgs/action/FollowJointTrajectory_FeedbackMessage",
    };
    /// `control_msgs/action/GripperCommand`.
    pub const GRIPPER_COMMAND: Self = Self {
        send_goal: "control_msgs/action/GripperCommand_SendGoal",
        get_result: "control_msgs/action/GripperCommand_GetResult",
        feedback: "control_msgs/action/GripperCommand_FeedbackMessage",
    };
}

/// A client of one action server.
pub struct ActionClient<G, R, F> {
    name: String,
    send: RosClient<SendGoalRequest<G>, SendGoalResponse>,
    result: RosClient<GetResultRequest, GetResultResponse<R>>,
    cancel: RosClient<CancelGoalRequest, CancelGoalResponse>,
    feedback: Mutex<RosSubscription<FeedbackMessage<F>>>,
    status: Mutex<RosSubscription<GoalStatusArray>>,
}

/// What a server tells of its goals by itself.
#[derive(Debug, Clone, PartialEq)]
pub enum Heard<F> {
    /// How far one is.
    Feedback(FeedbackMessage<F>),
    /// The states of all.
    Status(GoalStatusArray),
}

/// What a server says to a cancel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Canceled {
    /// It is ending the goal.
    Ending,
    /// It refuses.
    Refused,
    /// It carries out no such goal: it has not come yet, or is over.
    NotThere,
}

/// A goal's id.
pub type GoalHandle = Uuid;

/// The id under which every goal of a server is canceled, whoever sent it.
pub const ALL_GOALS: GoalHandle = GoalHandle { uuid: [0; 16] };

impl<G: Serialize, R: DeserializeOwned, F: DeserializeOwned> ActionClient<G, R, F> {
    /// Becomes a client of the action of that name.
    ///
    /// # Errors
    /// When the name or a type is unknown, or the network refuses.
    pub async fn new(node: &Node, name: &str, types: ActionTypes) -> Result<Self, BridgeError> {
        let part = |part: &str| format!("{name}/_action/{part}");
        Ok(Self {
            name: name.to_owned(),
            send: node.client(&part("send_goal"), types.send_goal).await?,
            result: node.client(&part("get_result"), types.get_result).await?,
            cancel: node.client(&part("cancel_goal"), "action_msgs/srv/CancelGoal").await?,
            feedback: node.subscribe_any_version(&part("feedback"), types.feedback, Qos::DEFAULT).await?.into(),
            status: node.subscribe(&part("status"), "action_msgs/msg/GoalStatusArray", Qos::KEPT).await?.into(),
        })
    }

    /// The action's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The next that the server tells of its goals by itself, and that can be read; waits for ever where nothing can come. Cancel safe.
    pub async fn heard(&self) -> Heard<F> {
        let (mut feedback, mut status) = (self.feedback.lock().await, self.status.lock().await);
        loop {
            tokio::select! {
                Some(Ok(told)) = feedback.recv() => return Heard::Feedback(told),
                Some(Ok(told)) = status.recv() => return Heard::Status(told),
                else => std::future::pending().await,
            }
        }
    }

    /// Sends a goal; whether it was accepted.
    ///
    /// # Errors
    /// When nobody answers in time.
    pub async fn send(&self, goal_id: GoalHandle, goal: G, patience: Duration) -> Result<bool, BridgeError> {
        Ok(self.send.call(&SendGoalRequest { goal_id, goal }, patience).await?.accepted)
    }

    /// Waits for a goal's result.
    ///
    /// # Errors
    /// When the server is gone, or there is none in time.
    pub async fn result(&self, goal_id: GoalHandle, patience: Duration) -> Result<GetResultResponse<R>, BridgeError> {
        self.result.call(&GetResultRequest { goal_id }, patience).await
    }

    /// Asks for a goal to be canceled, or all of them ([`ALL_GOALS`]); what the server says to that.
    ///
    /// # Errors
    /// When nobody answers in time.
    pub async fn cancel(&self, goal_id: GoalHandle, patience: Duration) -> Result<Canceled, BridgeError> {
        let request = CancelGoalRequest { goal_info: GoalInfo { goal_id, ..GoalInfo::default() } };
        Ok(canceled(goal_id, &self.cancel.call(&request, patience).await?))
    }
}

/// What a server's response to a cancel means.
fn canceled(goal_id: GoalHandle, response: &CancelGoalResponse) -> Canceled {
    match response.return_code {
        // A server that was to cancel all and has none finds no fault either.
        CancelGoalResponse::NONE if goal_id == ALL_GOALS && response.goals_canceling.is_empty() => Canceled::NotThere,
        CancelGoalResponse::NONE => Canceled::Ending,
        CancelGoalResponse::UNKNOWN_GOAL_ID | CancelGoalResponse::GOAL_TERMINATED => Canceled::NotThere,
        _ => Canceled::Refused,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cancel_of_all_goals_finds_none_where_the_server_names_none() {
        let one = GoalHandle { uuid: [7; 16] };
        let response = |return_code, goals: usize| CancelGoalResponse { return_code, goals_canceling: vec![GoalInfo::default(); goals] };
        for (goal, code, goals, expected) in [
            (ALL_GOALS, CancelGoalResponse::NONE, 0, Canceled::NotThere),
            (ALL_GOALS, CancelGoalResponse::NONE, 1, Canceled::Ending),
            (ALL_GOALS, 1, 0, Canceled::Refused),
            // Some servers do not list the goal that was named.
            (one, CancelGoalResponse::NONE, 0, Canceled::Ending),
            (one, CancelGoalResponse::GOAL_TERMINATED, 0, Canceled::NotThere),
        ] {
            assert_eq!(canceled(goal, &response(code, goals)), expected, "{goal:?}, code {code}, {goals} goals");
        }
    }
}
