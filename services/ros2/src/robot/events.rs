//! What a robot's controllers tell, and what is to be done.

use repose_ros_messages::{FollowJointTrajectoryResult, GripperCommandResult, JointTrajectory};

/// What is to be done.
#[derive(Debug, Clone, PartialEq)]
pub enum Do {
    /// Send the arm's controller a goal.
    Follow(u64, JointTrajectory),
    /// Cancel it.
    Cancel(u64),
    /// Send the hand's controller a goal: position of its joint (metres), effort (newtons).
    Grip(u64, f64, f64),
    /// Cancel that one.
    CancelGrip(u64),
}

/// What the arm's controller says of a goal, by its number.
#[derive(Debug, Clone, PartialEq)]
pub enum Told {
    /// It accepts.
    Accepted(u64),
    /// It refuses: why.
    Refused(u64, String),
    /// It does not answer, and may have accepted: why.
    Unanswered(u64, String),
    /// It has ended the goal: a state of goals, and the result.
    Ended(u64, i8, FollowJointTrajectoryResult),
    /// Its end was not heard of: why.
    Lost(u64, String),
    /// It answers to a cancel that it is ending the goal.
    Ending(u64),
    /// It answers to a cancel that it carries out no such goal.
    NotThere(u64),
}

/// What the hand's controller says of a goal, by its number.
#[derive(Debug, Clone, PartialEq)]
pub enum HandTold {
    /// It refuses: why.
    Refused(u64, String),
    /// Something stalls the fingers on their way.
    Stalled(u64),
    /// It has ended the goal: a state of goals, and the result.
    Ended(u64, i8, GripperCommandResult),
    /// It does not answer, and may have taken the goal, or its end was not heard of: why.
    Lost(u64, String),
    /// It answers to a cancel that it carries out no such goal.
    NotThere(u64),
}
