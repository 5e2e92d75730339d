//! The networks on inference workers, which a search on a compute thread asks and waits for.
//!
//! A request names the scene by its id; only when a worker does not hold it is it sent whole. From the first reply on, only workers with
//! the same weights and kernel are asked, because a result must not depend on who answered.

use std::sync::{Arc, Mutex, Once, PoisonError};
use std::time::{Duration, Instant};

use repose_proto::load::WorkerLoad;
use repose_proto::scoring::{PriorReply, PriorRequest, RealismBy, ScoreReply, ScoreRequest};
use repose_proto::{CallError, Message, Payload, Scene};
use repose_runtime::{Accept, Call, CallOptions, Caller};
use tokio::runtime::Handle;

use crate::learned::models::{PlacementModels, Provenance};
use crate::learned::stability::Stability;

/// The models of one placement request.
pub struct RemoteModels {
    inference: Caller,
    runtime: Handle,
    call: Call,
    reserve: Duration,
    stability: Arc<Stability>,
    pinned: Mutex<Option<Provenance>>,
}

impl RemoteModels {
    /// Asks `inference` on behalf of a call, until `reserve` before its deadline, which is left to send the answer. `runtime` carries the
    /// messages while compute threads wait.
    pub fn new(inference: Caller, runtime: Handle, call: Call, reserve: Duration, stability: Arc<Stability>) -> Self {
        Self { inference, runtime, call, reserve, stability, pinned: Mutex::default() }
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

    /// Warns once when the stability trees were fitted with other weights.
    fn check_fit(&self, weights_hash: &str) {
        static SAID: Once = Once::new();
        let fitted_with = &self.stability.fitted_on().weights_hash;
        if fitted_with != weights_hash {
            SAID.call_once(|| {
                tracing::warn!(
                    weights_hash,
                    fitted_with,
                    "the stability was fitted with other weights: the realism of `best` is less sure; `repose train --network stability` fits it anew"
                );
            });
        }
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
        if request.realism && request.realism_by == RealismBy::Outcome {
            self.check_fit(&reply.weights_hash);
        }
        Ok(reply)
    }

    fn stability(&self) -> &Stability {
        &self.stability
    }
}
