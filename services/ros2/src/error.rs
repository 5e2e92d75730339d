//! What keeps the bridge from running.

use repose_ros_messages::MessageError;
use repose_runtime::RuntimeError;

use crate::wire::names::NameError;
use crate::wire::type_hash::UnknownType;

/// Why the bridge, or something in it, cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum BridgeError {
    /// A field of the configuration that cannot be used.
    #[error("[ros2] {field}: {message}")]
    Config {
        /// Which.
        field: String,
        /// What was expected, and what came.
        message: String,
    },
    /// The ROS 2 system cannot be reached: another session than the cell's, with a router that nothing of ours starts.
    #[error("[ros2.session], the session with the ROS 2 system and its router (`ros2 run rmw_zenoh_cpp rmw_zenohd`): {0}")]
    RosSession(RuntimeError),
    /// The network refused.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// A message that cannot be read.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// A type without a definition.
    #[error(transparent)]
    Type(#[from] UnknownType),
    /// A name that ROS does not allow.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Nobody answered.
    #[error("{service} did not answer within {waited_ms} ms")]
    NoAnswer {
        /// The service.
        service: String,
        /// How long it was waited for.
        waited_ms: u128,
    },
    /// What came in between was refused by the cell.
    #[error(transparent)]
    Call(#[from] repose_proto::CallError),
}

impl BridgeError {
    /// A refusal of the configuration.
    pub fn config(field: impl Into<String>, message: impl Into<String>) -> Self {
        Self::Config { field: field.into(), message: message.into() }
    }
}
