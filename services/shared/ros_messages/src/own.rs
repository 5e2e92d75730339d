//! Services: `std_srvs/srv/Trigger`, and our own, whose definitions are in `services/ros2/interfaces/repose_msgs`.

use serde::{Deserialize, Serialize};

use crate::common::{Header, Pose, Transform};
use crate::control::JointTrajectory;

/// `std_srvs/srv/Trigger`, the request. A message without fields has one byte.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerRequest {
    /// Nothing.
    pub structure_needs_at_least_one_member: u8,
}

/// `std_srvs/srv/Trigger`, the response.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerResponse {
    /// Whether it worked.
    pub success: bool,
    /// What there is to say.
    pub message: String,
}

/// `repose_msgs/srv/Place`, the request.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlaceRequest {
    /// The camera whose newest scene is planned on.
    pub camera: String,
    /// The object to move.
    pub object: u16,
    /// What must hold.
    pub goal: Vec<String>,
    /// Distinct placements wanted.
    pub count: u32,
    /// The source of every random number.
    pub seed: u64,
}

/// `repose_msgs/srv/Place`, the response.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PlaceResponse {
    /// Whether there is a placement.
    pub success: bool,
    /// The error's code, or `none`; empty on success.
    pub code: String,
    /// The same for a person.
    pub message: String,
    /// The frame of the poses, and when the scene was seen.
    pub header: Header,
    /// The scene planned on.
    pub scene_id: String,
    /// The motions of the world that carry the observed object to the placed one, best first.
    pub placed_from_observed: Vec<Transform>,
    /// Where the object's centroid comes to be, with its turn.
    pub poses: Vec<Pose>,
    /// How likely each succeeds; NaN where nobody says.
    pub success_probability: Vec<f64>,
}

/// `repose_msgs/srv/Plan`, the request.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlanRequest {
    /// The camera whose newest scene is planned on.
    pub camera: String,
    /// The object to move.
    pub object: u16,
    /// What must hold.
    pub goal: Vec<String>,
    /// The source of every random number.
    pub seed: u64,
    /// Whether the robot carries it out.
    pub execute: bool,
}

/// `repose_msgs/srv/Plan`, the response.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PlanResponse {
    /// Whether there is a plan, and it was carried out where that was asked.
    pub success: bool,
    /// The error's code, or how the execution ended; empty on success.
    pub code: String,
    /// The same for a person.
    pub message: String,
    /// The scene planned on.
    pub scene_id: String,
    /// The placement that motion chose, by its rank.
    pub placement: u32,
    /// The stretches of the motion.
    pub phases: Vec<String>,
    /// When each begins, seconds of the trajectory.
    pub phase_starts_s: Vec<f64>,
    /// All of them one after the other.
    pub trajectory: JointTrajectory,
    /// Whether it was carried out.
    pub executed: bool,
}
