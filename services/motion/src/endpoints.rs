//! The service on the network: `plan`, `execute` and `reset`.

use async_trait::async_trait;
use repose_proto::load::WorkerLoad;
use repose_proto::motion::{MotionPlan, MotionPlanRequest, RobotResetRequest};
use repose_proto::scoring::disclose;
use repose_proto::{CallError, Message, Payload};
use repose_runtime::{Call, Handler, load_of};

use crate::robot_link::RobotLink;
use crate::worker::Worker;

/// Answers `plan`, `execute` and `reset`.
pub struct Endpoints {
    worker: Worker,
    link: RobotLink,
}

impl Endpoints {
    /// Plans with a worker and moves robots over a link.
    pub fn new(worker: Worker, link: RobotLink) -> Self {
        Self { worker, link }
    }

    /// Ranked placements to a timed motion. The request comes as JSON, or in bulk form with its scene.
    async fn plan(&self, call: &Call) -> Result<Payload, CallError> {
        let (request, scene) = match call.payload.is_bulk() {
            true => call.timed("decode", || disclose::<MotionPlanRequest>(&call.payload.decode_bulk(MotionPlanRequest::SCHEMA)?))?,
            false => (call.payload.decode_json()?, None),
        };
        let started = std::time::Instant::now();
        let plan = self.worker.plan(call.context(), request, scene).await?;
        call.stage("plan", started.elapsed().as_secs_f64() * 1e3);
        Payload::json(&plan)
    }

    /// A plan carried out, with progress by phase.
    async fn execute(&self, call: &Call) -> Result<Payload, CallError> {
        let plan: MotionPlan = self.worker.executable(call.payload.decode_json()?)?;
        let (link, reporting, cancelled) = (self.link.clone(), call.clone(), call.cancelled.clone());
        // A task of its own: the end of the call must not cut it off between two commands.
        let execution = tokio::spawn(async move {
            let progress = |phase| match Payload::json(&phase) {
                Ok(payload) => reporting.progress(payload),
                Err(error) => tracing::warn!(%error, "progress that cannot be sent"),
            };
            link.execute(plan, cancelled, progress).await
        });
        let reply = execution.await.map_err(|e| CallError::internal(format!("the execution was lost: {e}")))??;
        Payload::json(&reply)
    }

    /// A latched stop cleared.
    async fn reset(&self, call: &Call) -> Result<Payload, CallError> {
        let RobotResetRequest { robot } = call.payload.decode_json()?;
        Payload::json(&self.link.reset(&robot).await?)
    }
}

#[async_trait]
impl Handler for Endpoints {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "plan" => self.plan(&call).await,
            "execute" => self.execute(&call).await,
            "reset" => self.reset(&call).await,
            _ => Err(call.unknown_method()),
        }
    }

    fn at_most_once(&self, method: &str) -> bool {
        matches!(method, "execute" | "reset")
    }

    fn load(&self) -> WorkerLoad {
        load_of(&self.worker.gauge(), self.worker.capacity())
    }
}
