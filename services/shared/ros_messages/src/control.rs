//! `trajectory_msgs` and `control_msgs`: what joint trajectory and gripper controllers take.

use serde::{Deserialize, Serialize};

use crate::common::{Duration, Header, Transform, Vector3};

/// `trajectory_msgs/msg/JointTrajectoryPoint`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectoryPoint {
    /// Radians, or metres of joints that slide.
    pub positions: Vec<f64>,
    /// The same per second.
    pub velocities: Vec<f64>,
    /// The same per second squared.
    pub accelerations: Vec<f64>,
    /// Newton metres, or newtons.
    pub effort: Vec<f64>,
    /// Since the trajectory's start.
    pub time_from_start: Duration,
}

/// `trajectory_msgs/msg/JointTrajectory`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectory {
    /// When it starts; zero: at once.
    pub header: Header,
    /// The joints, in the order of the points' numbers.
    pub joint_names: Vec<String>,
    /// The points.
    pub points: Vec<JointTrajectoryPoint>,
}

/// `geometry_msgs/msg/Twist`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    linear: Vector3,
    angular: Vector3,
}

/// `trajectory_msgs/msg/MultiDOFJointTrajectoryPoint`, which nothing here moves by.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiDofPoint {
    transforms: Vec<Transform>,
    velocities: Vec<Twist>,
    accelerations: Vec<Twist>,
    time_from_start: Duration,
}

/// `trajectory_msgs/msg/MultiDOFJointTrajectory`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiDofTrajectory {
    header: Header,
    joint_names: Vec<String>,
    points: Vec<MultiDofPoint>,
}

/// `control_msgs/msg/JointTolerance`; 0 leaves the controller's own.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTolerance {
    /// The joint.
    pub name: String,
    /// Radians.
    pub position: f64,
    /// Radians per second.
    pub velocity: f64,
    /// Radians per second squared.
    pub acceleration: f64,
}

/// `control_msgs/msg/JointComponentTolerance`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ComponentTolerance {
    joint_name: String,
    component: u16,
    position: f64,
    velocity: f64,
    acceleration: f64,
}

/// `control_msgs/action/FollowJointTrajectory`, the goal.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FollowJointTrajectoryGoal {
    /// The trajectory.
    pub trajectory: JointTrajectory,
    /// Joints with several degrees of freedom: none.
    pub multi_dof_trajectory: MultiDofTrajectory,
    /// How far off the joints may be on the way.
    pub path_tolerance: Vec<JointTolerance>,
    /// The same of joints with several degrees of freedom.
    pub component_path_tolerance: Vec<ComponentTolerance>,
    /// How far off they may be at the end.
    pub goal_tolerance: Vec<JointTolerance>,
    /// The same of joints with several degrees of freedom.
    pub component_goal_tolerance: Vec<ComponentTolerance>,
    /// How late they may be.
    pub goal_time_tolerance: Duration,
}

/// `control_msgs/action/FollowJointTrajectory`, the result.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FollowJointTrajectoryResult {
    /// 0: reached.
    pub error_code: i32,
    /// What went wrong.
    pub error_string: String,
}

/// `control_msgs/action/FollowJointTrajectory`, what its feedback begins with in every release. Later releases put numbers between what follows,
/// which is not read.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FollowJointTrajectoryFeedback {
    /// When.
    pub header: Header,
    /// The joints.
    pub joint_names: Vec<String>,
    /// Where they should be.
    pub desired: JointTrajectoryPoint,
    /// Where they are.
    pub actual: JointTrajectoryPoint,
    /// The difference.
    pub error: JointTrajectoryPoint,
}

/// `control_msgs/action/GripperCommand`, the goal.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct GripperCommandGoal {
    /// Where the finger joint goes, metres.
    pub position: f64,
    /// Newtons at most.
    pub max_effort: f64,
}

/// `control_msgs/action/GripperCommand`, the result and the feedback.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct GripperCommandResult {
    /// Where the finger joint is, metres.
    pub position: f64,
    /// Newtons.
    pub effort: f64,
    /// Whether something is in the way.
    pub stalled: bool,
    /// Whether the position was reached.
    pub reached_goal: bool,
}
