//! Asking perception: the newest scene of a camera, or a scene by its id. `segment` takes a frame in bulk form.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::keys::validate_chunk;
use crate::{CallError, Message, SceneRef};

/// Asks for the newest scene of a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LatestRequest {
    /// The camera.
    pub camera: String,
}

impl Message for LatestRequest {
    const SCHEMA: &'static str = "LatestRequest.v1";

    fn validate(&self) -> Result<(), CallError> {
        validate_chunk("camera", &self.camera)
    }
}

/// Asks for a scene by its id.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneRequest {
    /// The scene's id.
    pub scene_id: String,
    /// Whether it may come packed (`PackedScene.v1`): a fifth as large, at some 50 ms of computing. Workers of release 1 refuse the field.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub packed: bool,
}

impl SceneRequest {
    /// Asks for a scene as it is.
    pub fn new(scene_id: impl Into<String>) -> Self {
        Self { scene_id: scene_id.into(), packed: false }
    }
}

impl Message for SceneRequest {
    const SCHEMA: &'static str = "SceneRequest.v1";

    fn validate(&self) -> Result<(), CallError> {
        SceneRef { scene_id: self.scene_id.clone() }.validate().map_err(|e| e.at("scene_id"))
    }
}
