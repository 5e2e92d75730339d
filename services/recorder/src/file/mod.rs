//! The container: writing parts of bounded size, and reading them, whole or cut off.

pub mod parts;
pub mod reading;
pub mod writing;

/// The profile that the header of our files names.
pub const PROFILE: &str = "repose";
/// The topic of whole scenes, below the cell's prefix. No key: on the wire they are answers.
pub const SCENE_TOPIC: &str = "scene_by_id";
/// The entry of a channel's metadata with the wire's encoding, `application/json;repose.RobotState.v1`.
pub const ENCODING: &str = "encoding";
