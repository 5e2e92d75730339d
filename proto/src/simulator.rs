//! Asking the simulator: a new scene, and the truth.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Message, RELATION_COUNT, RigidTransform};

/// Clears the table and sets up the scene of a seed.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WorldResetRequest {
    /// The scene's seed.
    pub seed: u64,
}

impl Message for WorldResetRequest {
    const SCHEMA: &'static str = "WorldResetRequest.v1";
}

/// Asks for the truth.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TruthRequest {
    /// The viewer of the relations; the camera's where absent, radians.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub view_yaw_rad: Option<f64>,
}

impl Message for TruthRequest {
    const SCHEMA: &'static str = "TruthRequest.v1";
}

/// One object as it really is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrueObject {
    /// Its id, as in labels.
    pub id: u16,
    /// Its family: `box`, `mug`, …
    pub name: String,
    /// Its pose.
    pub world_from_object: RigidTransform,
    /// Pose of its mesh's bounding box (centre and edges).
    pub world_from_box: RigidTransform,
    /// Edge lengths of that box, metres.
    pub extent_m: [f64; 3],
}

/// The relations of an ordered pair.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TruePair {
    /// The query.
    pub query: u16,
    /// The anchor.
    pub anchor: u16,
    /// Which relations hold.
    pub holds: [bool; RELATION_COUNT],
}

/// The world as it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Truth {
    /// The scene's seed.
    pub seed: u64,
    /// Simulated time, milliseconds.
    pub sim_ms: f64,
    /// Whether every object is at rest.
    pub at_rest: bool,
    /// The viewer of the relations, radians.
    pub view_yaw_rad: f64,
    /// The objects, by id.
    pub objects: Vec<TrueObject>,
    /// The relations of every ordered pair.
    pub relations: Vec<TruePair>,
}

impl Message for Truth {
    const SCHEMA: &'static str = "Truth.v1";
}
