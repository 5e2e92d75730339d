//! The service on the network: `prior`, `score`, `models` and `forecasts`. Requests come as JSON or in bulk form with the scene enclosed.

use std::sync::Arc;
use std::time::Instant;

use async_trait::async_trait;
use repose_proto::enclosed::disclose;
use repose_proto::load::WorkerLoad;
use repose_proto::scoring::{ForecastsRequest, ModelsRequest, PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, Message, Payload, Scene, SceneRef};
use repose_runtime::{Call, Handler, load_of};

use crate::held_scene::HeldScene;
use crate::worker::{ModelReply, ModelRequest, Worker};

/// Answers `prior`, `score`, `models` and `forecasts`.
pub struct Endpoints {
    worker: Arc<Worker>,
}

impl Endpoints {
    /// Answers from what a worker computes.
    pub fn new(worker: Arc<Worker>) -> Self {
        Self { worker }
    }

    async fn prior(&self, call: &Call) -> Result<Payload, CallError> {
        let (request, enclosed) = match call.payload.is_bulk() {
            true => disclose::<PriorRequest>(&call.payload.decode_bulk(PriorRequest::SCHEMA)?)?,
            false => (call.payload.decode_json::<PriorRequest>()?, None),
        };
        let held = self.held(&request.scene, enclosed).await?;
        match self.ask(call, ModelRequest::Prior(request, held)).await? {
            ModelReply::Prior(reply) => Payload::bulk(PriorReply::SCHEMA, &reply.to_bulk()),
            ModelReply::Score(_) => Err(CallError::internal("a prior request was answered with scores")),
        }
    }

    async fn score(&self, call: &Call) -> Result<Payload, CallError> {
        let (request, enclosed) = ScoreRequest::from_bulk(&call.payload.decode_bulk(ScoreRequest::SCHEMA)?)?;
        let held = self.held(&request.scene, enclosed).await?;
        match self.ask(call, ModelRequest::Score(request, held)).await? {
            ModelReply::Score(reply) => Payload::bulk(ScoreReply::SCHEMA, &reply.to_bulk()),
            ModelReply::Prior(_) => Err(CallError::internal("a score request was answered with a prior")),
        }
    }

    /// Asks the worker. The time that takes travels beside the answer, so that a caller can separate it from transport.
    async fn ask(&self, call: &Call, question: ModelRequest) -> Result<ModelReply, CallError> {
        let started = Instant::now();
        let answer = self.worker.ask(call.context(), question).await;
        call.stage("networks", started.elapsed().as_secs_f64() * 1e3);
        answer
    }

    /// The scene of a request: the enclosed one, which is held from then on, or the one held under its id.
    async fn held(&self, scene: &SceneRef, enclosed: Option<Scene>) -> Result<Arc<HeldScene>, CallError> {
        let Some(enclosed) = enclosed else { return self.worker.store().get(&scene.scene_id) };
        let (worker, scene_id) = (self.worker.clone(), scene.scene_id.clone());
        // Hashing a scene takes milliseconds, too long for the threads that serve the network.
        let held = tokio::task::spawn_blocking(move || worker.hold(&scene_id, enclosed)).await;
        held.unwrap_or_else(|e| Err(CallError::internal(format!("holding the scene failed: {e}"))))
    }
}

#[async_trait]
impl Handler for Endpoints {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "prior" => self.prior(&call).await,
            "score" => self.score(&call).await,
            "models" => {
                call.payload.decode_json::<ModelsRequest>()?;
                Payload::json(&self.worker.engine().models())
            }
            "forecasts" => {
                call.payload.decode_json::<ForecastsRequest>()?;
                Payload::json(&self.worker.engine().forecasts())
            }
            _ => Err(call.unknown_method()),
        }
    }

    fn load(&self) -> WorkerLoad {
        let engine = self.worker.engine();
        WorkerLoad {
            weights_hash: engine.weights_hash().to_owned(),
            kernel: engine.kernel().to_owned(),
            ..load_of(&self.worker.gauge(), self.worker.capacity())
        }
    }
}
