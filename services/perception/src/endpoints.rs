//! The service on the network: calls in and replies out, and the frames of its cameras.

use std::sync::Arc;

use async_trait::async_trait;
use repose_proto::load::WorkerLoad;
use repose_proto::perception::{LatestRequest, SceneRequest};
use repose_proto::{CallError, Payload, Scene};
use repose_runtime::{Call, Handler, load_of};

use crate::report::report;
use crate::worker::Worker;

/// Answers `segment`, `latest` and `scene`.
pub struct Endpoints {
    worker: Arc<Worker>,
}

impl Endpoints {
    /// Answers from what a worker makes and keeps.
    pub fn new(worker: Arc<Worker>) -> Self {
        Self { worker }
    }

    /// A frame to its scene, kept under its id.
    async fn segment(&self, call: &Call) -> Result<Payload, CallError> {
        let (scene, times) = self.worker.segment(call.context(), call.payload.clone()).await?;
        call.stage("decode", times.decode_ms);
        call.stage("segment", times.segment_ms);
        call.stage("encode", times.encode_ms);
        report(&scene.summary, None);
        let payload = scene.payload.clone();
        self.worker.keep(scene);
        Ok(payload)
    }

    /// The summary of a camera's newest scene.
    fn latest(&self, call: &Call) -> Result<Payload, CallError> {
        let LatestRequest { camera } = call.payload.decode_json()?;
        let summary = self.worker.newest().of(&camera).cloned();
        let summary = summary.ok_or_else(|| CallError::not_found("camera", format!("no scene of camera {camera:?} was made here")))?;
        Payload::json(&summary)
    }

    /// A scene by its id, packed for whoever is at the end of a slow network.
    async fn scene(&self, call: &Call) -> Result<Payload, CallError> {
        let SceneRequest { scene_id, packed } = call.payload.decode_json()?;
        let plain = self.worker.scene(&scene_id)?.payload.clone();
        if !packed {
            return Ok(plain);
        }
        let packing = move || Payload::packed(Scene::SCHEMA, &plain.decode_bulk(Scene::SCHEMA)?);
        tokio::task::spawn_blocking(packing).await.map_err(|e| CallError::internal(format!("packing was lost: {e}")))?
    }
}

#[async_trait]
impl Handler for Endpoints {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "segment" => self.segment(&call).await,
            "latest" => self.latest(&call),
            "scene" => self.scene(&call).await,
            _ => Err(call.unknown_method()),
        }
    }

    fn load(&self) -> WorkerLoad {
        load_of(&self.worker.gauge(), self.worker.capacity())
    }
}
