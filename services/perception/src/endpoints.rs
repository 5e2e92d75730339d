//! The service on the network: calls in and replies out, and the frames of its cameras.

use std::sync::Arc;

use async_trait::async_trait;
use repose_proto::load::WorkerLoad;
use repose_proto::perception::{LatestRequest, SceneRequest};
use repose_proto::{CallError, Payload, Scene};
use repose_runtime::{Call, Handler, SceneStore, load_of};
use tokio::sync::Mutex;

use crate::newest_scenes::KeptScene;
use crate::report::report;
use crate::worker::{FrameOrigin, Worker};

/// Answers `segment`, `latest` and `scene`.
pub struct Endpoints {
    worker: Arc<Worker>,
    /// The scenes that were asked for in packed form last, as they were when they were packed.
    packed: SceneStore<KeptScene>,
    /// Held while one is packed.
    packing: Mutex<()>,
}

/// Scenes that are kept in packed form, a megabyte each, and their bytes: as many as callers may fetch at a time.
const PACKED_SCENES: usize = 4;
const PACKED_BYTES: usize = 16 << 20;

impl Endpoints {
    /// Answers from what a worker makes and keeps.
    pub fn new(worker: Arc<Worker>) -> Self {
        let packed = SceneStore::beside_another(PACKED_SCENES, PACKED_BYTES, |scene: &KeptScene| scene.payload.bytes.len());
        Self { worker, packed, packing: Mutex::default() }
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
        let kept = self.worker.scene(&request.scene_id)?;
        let stamp_ns = kept.summary.stamp_ns;
        if !request.packed {
            return request.answer_as_of(&kept.payload, stamp_ns);
        }
        // Several parts are asked for at once: the first packs, and the others wait for that.
        let _packing = self.packing.lock().await;
        // The same content may have come again since it was packed. Parts of it may be under way, and say so; a whole one is packed anew.
        let is_good = |packed: &Arc<KeptScene>| request.part.is_some() || packed.summary.stamp_ns == stamp_ns;
        if let Some(packed) = self.packed.get(&request.scene_id).ok().filter(is_good) {
            return request.answer_as_of(&packed.payload, stamp_ns);
        }
        let packing = move || {
            let payload = Payload::packed(Scene::SCHEMA, &kept.payload.decode_bulk(Scene::SCHEMA)?)?;
            Ok::<_, CallError>(KeptScene { summary: kept.summary.clone(), payload })
        };
        let packed = tokio::task::spawn_blocking(packing).await.map_err(|e| CallError::internal(format!("packing was lost: {e}")))??;
        let packed = Arc::new(packed);
        self.packed.keep(&request.scene_id, packed.clone());
        request.answer_as_of(&packed.payload, stamp_ns)
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
