//! What keeps the driver from running.

use repose_runtime::RuntimeError;

use crate::robot::connection::ConnectError;

/// Why the driver cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum DriverError {
    /// A field of the configuration that cannot be used.
    #[error("[franka] {field}: {message}")]
    Config {
        /// Which.
        field: &'static str,
        /// What was expected, and what came.
        message: String,
    },
    /// The robot is another one, or cannot be driven from this machine.
    #[error("{0}")]
    Robot(#[from] ConnectError),
    /// The network refused.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The cell refused: another driver has the robot's name.
    #[error(transparent)]
    Call(#[from] repose_proto::CallError),
    /// A thread could not be started.
    #[error("no thread for {what}: {source}")]
    Thread {
        /// What it was to do.
        what: &'static str,
        /// Why not.
        source: std::io::Error,
    },
    /// The control loop has ended by itself: the robot stops, for it gets no set-points.
    #[error("the control loop has ended unexpectedly")]
    LoopEnded,
}
