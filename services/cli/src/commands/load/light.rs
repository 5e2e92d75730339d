//! Light cells: without a camera, a robot and physics, but each with a scene of its own, which a pool fetches from it as from any cell.

use std::sync::Arc;

use async_trait::async_trait;
use repose_proto::perception::SceneRequest;
use repose_proto::{CallError, Payload, Scene, Service};
use repose_runtime::{Call, Handler, Server, Session};

use crate::failure::Failure;

/// By how much each cell's scene is off the one before it, metres: nothing to a search, and another content.
const APART_M: f32 = 1e-6;

/// A cell that has a scene and nothing else.
pub struct LightCell {
    /// Its scene.
    pub scene: Scene,
    /// The scene's id.
    pub scene_id: String,
    /// What gives it to whoever asks.
    pub perception: Server,
}

/// The name of the `k`-th.
pub fn name(k: usize) -> String {
    format!("light-{k}")
}

impl LightCell {
    /// Starts the `k`-th, with a scene that is hardly another than this one. `session` is in its cell.
    pub async fn start(session: &Session, k: usize, scene: &Scene) -> Result<Self, Failure> {
        let mut scene = scene.clone();
        if let Some(point) = scene.points.first_mut() {
            point[0] += APART_M * k as f32;
        }
        let scene_id = scene.id();
        let whole = Payload::bulk(Scene::SCHEMA, &scene.to_bulk())?;
        let perception = session.start(Service::Perception, Arc::new(OneScene { scene_id: scene_id.clone(), whole })).await?;
        Ok(Self { scene, scene_id, perception })
    }
}

/// Perception that has seen one scene.
struct OneScene {
    scene_id: String,
    whole: Payload,
}

#[async_trait]
impl Handler for OneScene {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        if call.method != "scene" {
            return Err(call.unknown_method());
        }
        match call.payload.decode_json::<SceneRequest>()? {
            asked if asked.scene_id == self.scene_id => Ok(self.whole.clone()),
            asked => Err(CallError::not_found("scene_id", format!("scene {} is not of this cell", asked.scene_id))),
        }
    }
}
