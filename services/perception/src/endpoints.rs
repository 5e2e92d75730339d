//! The service on the network: calls in and replies out, and the frames of its cameras.

use std::sync::Arc;

use async_trait::async_trait;
use repose_proto::load::WorkerLoad;
use repose_proto::perception::{LatestRequest, SceneRequest};
use repose_proto::{CallError, Payload, Scene};
use repose_runtime::{Call, Handler, SceneStore, load_of};
use tokio::sync::Mutex;

use crate::report::report;
use crate::worker::{FrameOrigin, Worker};

/// Answers `segment`, `latest` and `scene`.
pub struct Endpoints {
    worker: Arc<Worker>,
    /// The scenes that were asked for in packed form last.
    packed: SceneStore<Payload>,
    /// Held while one is packed.
    packing: Mutex<()>,
}

/// Scenes that are kept in packed form, a megabyte each, and their bytes: as many as callers may fetch at a time.
const PACKED_SCENES: usize = 4;
const PACKED_BYTES: usize = 16 << 20;

impl Endpoints {
    /// Answers from what a worker makes and keeps.
    pub fn new(worker: Arc<Worker>) -> Self {
        Self { worker, packed: SceneStore::new(PACKED_SCENES, PACKED_BYTES, |scene| scene.bytes.len()), packing: Mutex::default() }
    }

    /// A frame to its scene, kept under its id.
    async fn segment(&self, call: &Call) -> Result<Payload, CallError> {
        let (scene, times) = self.worker.segment(call.context(), call.payload.clone(), FrameOrigin::Caller).await?;
        call.stage("decode", times.decode_ms);
        call.stage("segment", times.segment_ms);
        call.stage("encode", times.encode_ms);
        report(&scene.summary, None);
        let payload = scene.payload.clone();
        self.worker.keep(scene);
        Ok(payload)
    }

    /// The summary of a camera's newest scene.
    async fn latest(&self, call: &Call) -> Result<Payload, CallError> {
        let LatestRequest { camera } = call.payload.decode_json()?;
        Payload::json(&self.worker.latest(&camera).await?)
    }

    /// A scene by its id, packed and in parts for whoever is at the end of a slow network.
    async fn scene(&self, call: &Call) -> Result<Payload, CallError> {
        let request: SceneRequest = call.payload.decode_json()?;
        let plain = self.worker.scene(&request.scene_id)?.payload.clone();
        if !request.packed {
            return request.answer(&plain);
        }
        // Several parts are asked for at once: the first packs, and the others wait for that.
        let _packing = self.packing.lock().await;
        if let Ok(scene) = self.packed.get(&request.scene_id) {
            return request.answer(&scene);
        }
        let packing = move || Payload::packed(Scene::SCHEMA, &plain.decode_bulk(Scene::SCHEMA)?);
        let scene = tokio::task::spawn_blocking(packing).await.map_err(|e| CallError::internal(format!("packing was lost: {e}")))??;
        request.answer(&self.packed.keep(&request.scene_id, Arc::new(scene)))
    }
}

#[async_trait]
impl Handler for Endpoints {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "segment" => self.segment(&call).await,
            "latest" => self.latest(&call).await,
            "scene" => self.scene(&call).await,
            _ => Err(call.unknown_method()),
        }
    }

    fn load(&self) -> WorkerLoad {
        WorkerLoad { cameras: self.worker.cameras(), ..load_of(&self.worker.gauge(), self.worker.capacity()) }
    }
}
