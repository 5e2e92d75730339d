//! The service on the network: `place` and `arrange`. Requests come as JSON with a scene's id, or in bulk form with the scene enclosed.

use std::sync::Arc;
use std::time::{Duration, Instant};

use async_trait::async_trait;
use repose_proto::enclosed::disclose;
use repose_proto::load::WorkerLoad;
use repose_proto::place::{PlaceRequest, ReachingRobot};
use repose_proto::{ArrangeRequest, CallError, ErrorCode, Message, Payload, Scene};
use repose_runtime::{Call, CallOptions, Caller, CellCallers, Handler, fetch_scene, load_of};

use self::fetches::Fetches;
use crate::cached_scene::CachedScene;
use crate::config::{PlannerConfig, Robots};
use crate::remote_models::{KnownForecasts, RemoteModels};
use crate::worker::Worker;

mod fetches;

/// Answers `place` and `arrange`.
pub struct Endpoints {
    worker: Arc<Worker>,
    perception: CellCallers,
    inference: Caller,
    fetches: Fetches,
    scene_timeout: Duration,
    reply_reserve: Duration,
    forecasts: Arc<KnownForecasts>,
    robots: Robots,
}

impl Endpoints {
    /// Answers from what a worker computes, with scenes from perception and scores from inference.
    pub fn new(worker: Arc<Worker>, perception: CellCallers, inference: Caller, robots: Robots, config: &PlannerConfig) -> Self {
        let (scene_timeout, reply_reserve) =
            (Duration::from_millis(config.scene_timeout_ms), Duration::from_millis(config.reply_reserve_ms));
        Self { worker, perception, inference, fetches: Fetches::default(), scene_timeout, reply_reserve, forecasts: Arc::default(), robots }
    }

    async fn place(&self, call: &Call) -> Result<Payload, CallError> {
        let (mut request, enclosed) = match call.payload.is_bulk() {
            true => disclose::<PlaceRequest>(&call.payload.decode_bulk(PlaceRequest::SCHEMA)?)?,
            false => (call.payload.decode_json::<PlaceRequest>()?, None),
        };
        self.complete(&mut request.robot, call);
        let scene = self.scene_of(&request.scene.scene_id, enclosed, call).await?;
        let models = self.models(call);
        let reporting = call.clone();
        let progress = move |done| match Payload::json(&done) {
            Ok(payload) => reporting.progress(payload),
            Err(error) => tracing::warn!(%error, "progress could not be sent"),
        };
        let started = Instant::now();
        let result = self.worker.plan(call.context(), scene, request, models, progress).await?;
        call.stage("search", started.elapsed().as_secs_f64() * 1e3);
        Payload::json(&result)
    }

    async fn arrange(&self, call: &Call) -> Result<Payload, CallError> {
        let (mut request, enclosed) = match call.payload.is_bulk() {
            true => disclose::<ArrangeRequest>(&call.payload.decode_bulk(ArrangeRequest::SCHEMA)?)?,
            false => (call.payload.decode_json::<ArrangeRequest>()?, None),
        };
        self.complete(&mut request.robot, call);
        let scene = self.scene_of(&request.scene.scene_id, enclosed, call).await?;
        let started = Instant::now();
        let result = self.worker.arrange(call.context(), scene, request, self.models(call)).await?;
        call.stage("search", started.elapsed().as_secs_f64() * 1e3);
        Payload::json(&result)
    }

    /// Puts in what a request of this worker's own cell leaves to it; where a pool's other cells have their robots it does not know.
    fn complete(&self, robot: &mut Option<ReachingRobot>, call: &Call) {
        if call.cell.is_none() {
            self.robots.complete(robot);
        }
    }

    /// The networks, asked for a call.
    fn models(&self, call: &Call) -> RemoteModels {
        let runtime = tokio::runtime::Handle::current();
        RemoteModels::new(self.inference.clone(), runtime, call.clone(), self.reply_reserve, self.forecasts.clone())
    }

    /// The scene of a request: the one that it encloses, or by its id.
    async fn scene_of(&self, scene_id: &str, enclosed: Option<Scene>, call: &Call) -> Result<Arc<CachedScene>, CallError> {
        match enclosed {
            Some(scene) => self.keep(scene_id.to_owned(), scene).await,
            None => self.scene(scene_id, call).await,
        }
    }

    /// A scene by its id: kept here, or from whichever perception worker of the call's cell has it.
    async fn scene(&self, scene_id: &str, call: &Call) -> Result<Arc<CachedScene>, CallError> {
        if let Ok(kept) = self.worker.scenes().get(scene_id) {
            return Ok(kept);
        }
        let options = CallOptions::for_call(call);
        // What is left then is for the search, or for a caller that has the scene to send it.
        let options = CallOptions { deadline: (options.deadline / 2).min(self.scene_timeout), ..options };
        let started = Instant::now();
        // Whoever waits gives up when its own fetch would have: its caller may send the scene.
        let turn = tokio::time::timeout(options.deadline, self.fetches.turn(scene_id)).await;
        if let Ok(kept) = self.worker.scenes().get(scene_id) {
            call.stage("scene", started.elapsed().as_secs_f64() * 1e3);
            return Ok(kept);
        }
        let _turn =
            turn.map_err(|_| CallError::not_found("scene_id", format!("scene {scene_id} is not here, and did not come in time")))?;
        let options = CallOptions { deadline: options.deadline.saturating_sub(started.elapsed()), ..options };
        let perception = self.perception.of(call).await?;
        let scene = fetch_scene(&perception, scene_id, &options).await.map_err(|error| match error.code {
            ErrorCode::Cancelled | ErrorCode::NotFound => error,
            // The caller can help: it may send the scene whole.
            _ => CallError::not_found("scene_id", format!("scene {scene_id} is not here, and perception could not be asked: {error}")),
        })?;
        call.stage("scene", started.elapsed().as_secs_f64() * 1e3);
        self.keep(scene_id.to_owned(), scene).await
    }

    async fn keep(&self, scene_id: String, scene: Scene) -> Result<Arc<CachedScene>, CallError> {
        let worker = self.worker.clone();
        // Hashing a scene takes milliseconds, too long for the threads that serve the network.
        let kept = tokio::task::spawn_blocking(move || worker.keep(&scene_id, scene)).await;
        kept.unwrap_or_else(|e| Err(CallError::internal(format!("keeping the scene failed: {e}"))))
    }
}

#[async_trait]
impl Handler for Endpoints {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "place" => self.place(&call).await,
            "arrange" => self.arrange(&call).await,
            _ => Err(call.unknown_method()),
        }
    }

    fn load(&self) -> WorkerLoad {
        load_of(&self.worker.gauge(), self.worker.capacity())
    }
}
