//! The networks on inference workers, which a search on a compute thread asks and waits for.
//!
//! A request names the scene by its id; only when a worker does not hold it is it sent whole. From the first reply on, only workers with
//! the same weights and kernel are asked, because a result must not depend on who answered.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use repose_proto::load::WorkerLoad;
use repose_proto::scoring::{ForecastsReply, ForecastsRequest, PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, ErrorCode, Message, Payload, Scene};
use repose_runtime::{Accept, Call, CallOptions, Caller};
use tokio::runtime::Handle;

use crate::learned::forecast::Forecasts;
use crate::learned::models::{PlacementModels, Provenance};

/// The forecasts of the weights in service: megabytes that hardly ever change, so that they are asked for once.
#[derive(Debug, Default)]
pub struct KnownForecasts(Mutex<Option<(String, Arc<Forecasts>)>>);

impl KnownForecasts {
    /// The forecasts of these weights, asked for where others or none are known.
    fn of(&self, weights_hash: &str, ask: impl FnOnce() -> Result<Forecasts, CallError>) -> Result<Arc<Forecasts>, CallError> {
        let known = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, forecasts)) = known().as_ref().filter(|(hash, _)| hash == weights_hash) {
            return Ok(forecasts.clone());
        }
        // Nobody waits for another's answer: after a change of weights a few may ask at once.
        let forecasts = Arc::new(ask()?);
        *known() = Some((weights_hash.to_owned(), forecasts.clone()));
        Ok(forecasts)
    }
}

/// The models of one placement request.
pub struct RemoteModels {
    inference: Caller,
    runtime: Handle,
    call: Call,
    reserve: Duration,
    forecasts: Arc<KnownForecasts>,
    pinned: Mutex<Option<Provenance>>,
}

impl RemoteModels {
    /// Asks `inference` on behalf of a call, until `reserve` before its deadline, which is left to send the answer. `runtime` carries the
    /// messages while compute threads wait; `forecasts` are shared by all requests.
    pub fn new(inference: Caller, runtime: Handle, call: Call, reserve: Duration, forecasts: Arc<KnownForecasts>) -> Self {
        Self { inference, runtime, call, reserve, forecasts, pinned: Mutex::default() }
    }

    /// Asks with the scene's id, and with the whole scene when the worker lacks it.
    fn ask(
        &self,
        method: &str,
        scene: &Scene,
        encode: impl Fn(Option<&Scene>) -> Result<Payload, CallError>,
    ) -> Result<Payload, CallError> {
        let options = CallOptions::for_call(&self.call);
        let options = CallOptions { accept: self.accept(), deadline: options.deadline.saturating_sub(self.reserve), ..options };
        let started = Instant::now();
        let answer = self.runtime.block_on(self.inference.call_with_scene(method, Some(scene), encode, options));
        self.call.stage("inference", started.elapsed().as_secs_f64() * 1e3);
        let answer = answer?;
        self.call.stage("networks", answer.timing_ms.get("networks").copied().unwrap_or(0.0));
        Ok(answer.payload)
    }

    fn accept(&self) -> Option<Accept> {
        let pinned = self.pinned.lock().unwrap_or_else(PoisonError::into_inner).clone()?;
        Some(Arc::new(move |load: &WorkerLoad| load.weights_hash == pinned.weights_hash && load.kernel == pinned.kernel))
    }

    fn pin(&self, weights_hash: &str, kernel: &str) {
        let mut pinned = self.pinned.lock().unwrap_or_else(PoisonError::into_inner);
        pinned.get_or_insert_with(|| Provenance { weights_hash: weights_hash.to_owned(), kernel: kernel.to_owned() });
    }
}

impl PlacementModels for RemoteModels {
    fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError> {
        let payload = self.ask("prior", scene, |scene| Payload::with_scene(request, scene))?;
        let reply = PriorReply::from_bulk(&payload.decode_bulk(PriorReply::SCHEMA)?)?;
        self.pin(&reply.weights_hash, &reply.kernel);
        Ok(reply)
    }

    fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        let payload = self.ask("score", scene, |scene| Payload::bulk(ScoreRequest::SCHEMA, &request.to_bulk(scene)))?;
        let reply = ScoreReply::from_bulk(&payload.decode_bulk(ScoreReply::SCHEMA)?)?;
        self.pin(&reply.weights_hash, &reply.kernel);
        Ok(reply)
    }

    fn forecasts(&self) -> Result<Arc<Forecasts>, CallError> {
        let weights_hash = self.pinned.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map(|pinned| pinned.weights_hash.clone());
        let weights_hash = weights_hash.ok_or_else(|| CallError::internal("forecasts were asked for before any answer"))?;
        self.forecasts.of(&weights_hash, || {
            let options = CallOptions::for_call(&self.call);
            let options = CallOptions { accept: self.accept(), deadline: options.deadline.saturating_sub(self.reserve), ..options };
            let answer = self.runtime.block_on(self.inference.call("forecasts", Payload::json(&ForecastsRequest {})?, options))?;
            let reply: ForecastsReply = answer.payload.decode_json()?;
            if reply.weights_hash != weights_hash {
                let message = format!("the weights changed during the request, from {weights_hash} to {}", reply.weights_hash);
                return Err(CallError::new(ErrorCode::Unavailable, message));
            }
            Forecasts::read(&reply.forecasts)
        })
    }
}
