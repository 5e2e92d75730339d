//! How an execution talks to the robot.

use nalgebra::Isometry3;
use repose_panda::Model;

/// How an execution talks to the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExecutionSettings {
    /// What the robot should be: a stretch is slowed down under its limits, and one that says another model of itself is not moved.
    pub model: Model,
    /// Where its base should be: one that says that it stands elsewhere is not moved. Default: at the world's origin.
    pub world_from_base: Isometry3<f64>,
    /// How far ahead of the robot the set-points reach, milliseconds of robot time, at least 200. Default 1000.
    pub horizon_ms: f64,
    /// How long a command may be acted on after receipt, milliseconds. Default 500.
    pub ttl_ms: u64,
    /// How long the robot may take to take a command, milliseconds; it is repeated until then. Default 2000.
    pub take_timeout_ms: u64,
    /// How long the robot's state may be silent, milliseconds in which this process ran itself. Default 1500.
    pub state_timeout_ms: u64,
    /// How long the gripper may take to settle, milliseconds of robot time; then whether it stands, and where, decides. Default 3000.
    pub gripper_timeout_ms: f64,
    /// How far ahead of the robot a cancelled stream begins to slow down, milliseconds of robot time: longer than a state and a command take,
    /// shorter than the horizon. Default 150.
    pub halt_lead_ms: f64,
    /// The same for a robot whose controller takes whole trajectories: it is told of what lies beyond its own lead alone. Default 400.
    pub whole_halt_lead_ms: f64,
    /// How far behind its stream the robot may be at the end, milliseconds of robot time. Default 3000.
    pub lag_ms: f64,
}

impl Default for ExecutionSettings {
    fn default() -> Self {
        Self {
            model: Model::Panda,
            world_from_base: Isometry3::identity(),
            horizon_ms: 1000.0,
            ttl_ms: 500,
            take_timeout_ms: 2000,
            state_timeout_ms: 1500,
            gripper_timeout_ms: 3000.0,
            halt_lead_ms: 150.0,
            whole_halt_lead_ms: 400.0,
            lag_ms: 3000.0,
        }
    }
}
