//! What a worker says of itself, 5 to 10 times a second, for callers to choose by.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Message;
use crate::motion::KeepOutZone;

/// A worker's load.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WorkerLoad {
    /// Contract version, 1.
    pub v: u32,
    /// Counts loads, so that a caller sees when it missed some.
    pub seq: u64,
    /// Calls waiting.
    pub queue_depth: usize,
    /// Calls that may wait before the next is refused.
    pub queue_capacity: usize,
    /// Calls being computed.
    pub in_flight: usize,
    /// Smoothed time to serve one call, milliseconds.
    pub service_ms: f64,
    /// BLAKE3 of the weights served; empty without any.
    pub weights_hash: String,
    /// The kernel in use; empty without any.
    pub kernel: String,
    /// Whether the worker takes no new calls.
    pub draining: bool,
    /// Whether the worker serves [`crate::Cell::operate`]; workers of release 1 take every method on their `call` key.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub operates: bool,
    /// Whether the worker puts copies of its calls on its journal: somebody records.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub journals: bool,
    /// Version of the worker's program; workers of release 1 tell none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// When it was told, by the clock of the worker's host, nanoseconds since the Unix epoch: nothing goes by it, but a clock that is off can be said so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stamp_ns: Option<u64>,
    /// Calls ended since the worker started; workers of release 1 do not tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended: Option<u64>,
    /// Those of them that the worker failed: `internal`, `unavailable`, `resource_exhausted`, `deadline_exceeded`. What was wrong with the
    /// request itself is not among them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failed: Option<u64>,
    /// The keep-out zones that a motion worker heeds; nobody else has any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub keep_out: Vec<KeepOutZone>,
    /// The cameras whose frames a perception worker takes; nobody else has any. Their scenes may be seldom while nobody asks for them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<CameraLoad>,
}

/// What a perception worker received of a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CameraLoad {
    /// The camera.
    pub camera: String,
    /// Frames that came since the worker started.
    pub frames: u64,
    /// How long ago the newest of them came, milliseconds.
    pub frame_age_ms: u64,
    /// Its newest scene, where one was made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub newest: Option<NewestSceneLoad>,
}

/// A camera's newest scene, in a worker's load.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NewestSceneLoad {
    /// Its id.
    pub scene_id: String,
    /// How many objects it has.
    pub objects: usize,
    /// How long ago it was made, milliseconds.
    pub age_ms: u64,
    /// From its stamp to when its frame came, by the worker's clock, milliseconds.
    pub lag_ms: f64,
}

impl Message for WorkerLoad {
    const SCHEMA: &'static str = "WorkerLoad.v1";
}
