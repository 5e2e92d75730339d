//! Set-points as a trajectory of ROS, and a goal on its way through a controller.

use repose_proto::robot::SetPoint;
use repose_ros_messages::{Duration, FollowJointTrajectoryGoal, JointTrajectory, JointTrajectoryPoint};

/// How far a controller is with a goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GoalState {
    /// Sent, and not answered yet.
    Sent,
    /// Accepted.
    Accepted,
}

/// The goal that the arm follows: a trajectory that its controller has, or is to have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Goal {
    /// Its number: later ones take the place of earlier ones.
    pub number: u64,
    /// How far it is.
    pub state: GoalState,
    /// Since when, milliseconds.
    pub since_ms: u64,
    /// How long its trajectory takes, milliseconds.
    pub duration_ms: f64,
}

/// The trajectory from `from_ms` of a stream on. The point at that very instant is left out: it is where the arm is.
pub fn trajectory(joints: &[String; 7], set_points: &[SetPoint], from_ms: f64) -> JointTrajectory {
    let point = |p: &SetPoint| JointTrajectoryPoint {
        positions: p.q_rad.into(),
        velocities: p.dq_rad_s.into(),
        time_from_start: Duration::from_ms(p.t_ms - from_ms),
        ..JointTrajectoryPoint::default()
    };
    let points = set_points.iter().filter(|p| p.t_ms > from_ms).map(point).collect();
    JointTrajectory { joint_names: joints.to_vec(), points, ..JointTrajectory::default() }
}

/// The goal that a controller is sent: the trajectory, with the controller's own tolerances.
pub fn goal_of(trajectory: JointTrajectory) -> FollowJointTrajectoryGoal {
    FollowJointTrajectoryGoal { trajectory, ..FollowJointTrajectoryGoal::default() }
}
