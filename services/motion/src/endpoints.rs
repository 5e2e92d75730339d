//! The service on the network: `plan`, `execute`, `reset` and `recover`.

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use repose_proto::enclosed::disclose;
use repose_proto::load::WorkerLoad;
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlan, MotionPlanRequest, RecoverReply, RecoverRequest};
use repose_proto::robot::HeldObject;
use repose_proto::{CallError, ErrorCode, Message, Payload, Scene, Service};
use repose_runtime::{Call, CallOptions, Caller, Handler, RuntimeError, SCENE_WITHIN, Session, fetch_scene, fetch_stamp, load_of};

use crate::client_watch::ClientWatch;
use crate::config::{MotionConfig, OnClientLoss};
use crate::execution::{ExecutionTask, check_free};
use crate::neighbours::{Neighbours, Stances};
use crate::robot_link::{RobotLink, ToRest};
use crate::wire;
use crate::worker::Worker;

/// How long perception may take to say when it last saw a scene.
const STAMP_WITHIN: Duration = Duration::from_secs(1);

/// Answers `plan`, `execute`, `reset` and `recover`.
pub struct Endpoints {
    worker: Arc<Worker>,
    link: RobotLink,
    session: Session,
    perception: Caller,
    neighbours: Arc<Neighbours>,
    on_client_loss: OnClientLoss,
    /// How long a held scene passes for as young as it came.
    young_for: Duration,
}

impl Endpoints {
    /// Plans with a worker, moves robots over a link, asks perception for scenes, and heeds other robots of the cell.
    ///
    /// # Errors
    /// When the configuration is out of range, or the network or the operating system refuses.
    pub async fn start(session: &Session, config: &MotionConfig) -> Result<Self, RuntimeError> {
        Ok(Self {
            worker: Arc::new(Worker::start(config)?),
            link: RobotLink::new(session.clone(), config)?,
            session: session.clone(),
            perception: session.caller(Service::Perception).await?,
            neighbours: Arc::new(Neighbours::follow(session, config.base()?).await?),
            on_client_loss: config.on_client_loss,
            young_for: Duration::from_millis(config.max_scene_age_ms / 2),
        })
    }

    /// The scene of a request where it did not come along and is not held: perception of this cell is nearer than most callers. None where it cannot
    /// be had so; a caller that has it at hand sends it then.
    async fn missing_scene(&self, scene_id: &str, call: &Call) -> Option<Scene> {
        // Where there is no perception nobody waits for one.
        if self.worker.scene(scene_id).is_some() || self.perception.workers().is_empty() {
            return None;
        }
        let started = std::time::Instant::now();
        let options = CallOptions::for_call(call);
        let options = CallOptions { deadline: SCENE_WITHIN.min(options.deadline / 2), ..options };
        let fetched = fetch_scene(&self.perception, scene_id, &options).await;
        call.stage("scene", started.elapsed().as_secs_f64() * 1e3);
        fetched.inspect_err(|error| tracing::debug!(scene_id, %error, "perception has no scene to plan on")).ok()
    }

    /// The scene of a request by its id that a way is checked against: as [`Self::missing_scene`], and one that is held for longer than it passes for
    /// young as perception has seen it since. The same content has one id whenever it is seen, and what is planned on it can be carried out for as
    /// long as its sighting is young.
    async fn scene_seen_last(&self, scene_id: &str, young_for: Duration, call: &Call) -> Option<Scene> {
        let Some(held) = self.worker.scene(scene_id) else { return self.missing_scene(scene_id, call).await };
        if held.held_for() < young_for || self.perception.workers().is_empty() {
            return None;
        }
        let options = CallOptions::for_call(call);
        let options = CallOptions { deadline: STAMP_WITHIN.min(options.deadline / 2), ..options };
        let asked = fetch_stamp(&self.perception, scene_id, &options).await;
        let stamp_ns =
            asked.inspect_err(|error| tracing::debug!(scene_id, %error, "perception does not say when it saw a scene")).ok()??;
        (stamp_ns > held.scene().stamp_ns).then(|| Scene { stamp_ns, ..held.scene().clone() })
    }

    /// Ranked placements to a timed motion. The request comes as JSON, or in bulk form with its scene.
    async fn plan(&self, call: &Call) -> Result<Payload, CallError> {
        let (request, scene) = match call.payload.is_bulk() {
            true => call.timed("decode", || disclose::<MotionPlanRequest>(&call.payload.decode_bulk(MotionPlanRequest::SCHEMA)?))?,
            false => {
                let request: MotionPlanRequest = call.payload.decode_json()?;
                let scene = self.scene_seen_last(&request.scene.scene_id, self.young_for, call).await;
                (request, scene)
            }
        };
        self.neighbours.check_base_of(&request.robot)?;
        let started = std::time::Instant::now();
        let beside = self.neighbours.solids(&request.robot);
        let plan = self.worker.plan(call.context(), request, scene, beside).await?;
        call.stage("plan", started.elapsed().as_secs_f64() * 1e3);
        Payload::json(&plan)
    }

    /// A plan carried out, with progress by phase. What becomes of it when its client is gone is configured.
    async fn execute(&self, call: &Call) -> Result<Payload, CallError> {
        let client = self.client_of(call).await;
        let plan: MotionPlan = call.payload.decode_json()?;
        let robot = plan.robot.clone();
        let stood = self.neighbours.stances(&robot);
        let (plan, grasps) = self.executable(plan, call).await?;
        self.neighbours.check_stances(&robot, &stood)?;
        let task = self.task(call, grasps);
        let (link, reporting) = (self.link.clone(), call.clone());
        let execute = async move |to_rest| {
            let progress = |phase| match Payload::json(&phase) {
                Ok(payload) => reporting.progress(payload),
                Err(error) => tracing::warn!(%error, "progress that cannot be sent"),
            };
            link.execute(plan, task, to_rest, progress).await
        };
        Payload::json(&self.driven(call, &robot, stood, client, execute).await?)
    }

    /// The client of a call, watched from now on. Before anything else is done for it: a client that goes while a motion is prepared has to be
    /// missed when that begins, and whoever looks only then takes it for one that holds no token. None where an execution goes on without it.
    async fn client_of(&self, call: &Call) -> Option<ClientWatch> {
        match self.on_client_loss {
            OnClientLoss::Stop => ClientWatch::of(&self.session, &call.id).await,
            OnClientLoss::Finish => None,
        }
    }

    /// A plan as it may be carried out beside the robots that stand there, and what it puts into the hand, where its scene is known.
    async fn executable(&self, plan: MotionPlan, call: &Call) -> Result<(MotionPlan, Option<HeldObject>), CallError> {
        let fetched = self.missing_scene(&plan.scene_id, call).await;
        let (worker, neighbours, context) = (self.worker.clone(), self.neighbours.clone(), call.context());
        let check = move || -> Result<_, CallError> {
            let go_on = || context.check();
            let (plan, held) = worker.executable(plan, fetched, &go_on)?;
            let scene = held.as_ref().map(|held| held.scene());
            neighbours.check(&plan, scene, &go_on)?;
            let grasps = scene.and_then(|scene| wire::held_object(scene, &plan));
            Ok((plan, grasps))
        };
        let checked = tokio::task::spawn_blocking(check).await;
        checked.map_err(|e| CallError::internal(format!("the check of a plan was lost: {e}")))?
    }

    /// The arm of a robot driven for a call until it is at rest again, while its `client` is there and those beside it stand as they `stood`.
    async fn driven<F>(
        &self,
        call: &Call,
        robot: &str,
        stood: Stances,
        client: Option<ClientWatch>,
        drive: impl FnOnce(ToRest) -> F,
    ) -> Result<ExecuteReply, CallError>
    where
        F: Future<Output = Result<ExecuteReply, CallError>> + Send + 'static,
    {
        // A task of its own: the end of the call must not cut it off between two commands.
        let driven = tokio::spawn(drive(self.to_rest(call, robot, stood, client)));
        driven.await.map_err(|e| CallError::internal(format!("the execution was lost: {e}")))?
    }

    /// What brings an arm to rest that is driven for a call: its end, that of its client, and another robot that begins to do something beside it.
    fn to_rest(&self, call: &Call, robot: &str, stood: Stances, client: Option<ClientWatch>) -> ToRest {
        let (cancelled, neighbours, robot) = (call.cancelled.clone(), self.neighbours.clone(), robot.to_owned());
        Box::pin(async move {
            let gone = async move {
                match client {
                    Some(mut client) => client.gone().await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                () = cancelled.cancelled() => {
                    CallError::new(ErrorCode::Cancelled, "the caller cancelled, the deadline passed, or motion is to end")
                }
                // Not `cancelled`, which the runtime takes for the end of this worker where no caller has cancelled.
                () = gone => CallError::precondition("the client is gone"),
                begun = neighbours.begun_beside(&robot, &stood) => begun,
            }
        })
    }

    /// An arm brought back.
    async fn recover(&self, call: &Call) -> Result<Payload, CallError> {
        let client = self.client_of(call).await;
        let (request, scene) = match call.payload.is_bulk() {
            true => call.timed("decode", || disclose::<RecoverRequest>(&call.payload.decode_bulk(RecoverRequest::SCHEMA)?))?,
            false => {
                let request: RecoverRequest = call.payload.decode_json()?;
                let scene = match &request.scene {
                    // What stands there now counts, however young it was before.
                    Some(named) => self.scene_seen_last(&named.scene_id, Duration::ZERO, call).await,
                    None => None,
                };
                (request, scene)
            }
        };
        let state = self.link.state(&request.robot).await?;
        check_free(&state)?;
        self.neighbours.check_still(&request.robot)?;
        let stood = self.neighbours.stances(&request.robot);
        let beside = self.neighbours.solids(&request.robot);
        let robot = request.robot.clone();
        let unmoved = |seen_ns| self.neighbours.check_unmoved(&robot, seen_ns);
        let (phases, retreated_m, checked_against) = self.worker.recover(call.context(), request, scene, &state, beside, unmoved).await?;
        self.neighbours.check_stances(&robot, &stood)?;
        if phases.is_empty() {
            let (outcome, joints_rad) = (ExecutionOutcome::Done, state.q_rad);
            return Payload::json(&RecoverReply { outcome, reason: None, retreated_m, checked_against, joints_rad });
        }
        let (link, task) = (self.link.clone(), self.task(call, None));
        let driven = robot.clone();
        let follow = async move |to_rest| link.follow(&driven, phases, task, to_rest).await;
        let ExecuteReply { outcome, reason, joints_rad, .. } = self.driven(call, &robot, stood, client, follow).await?;
        Payload::json(&RecoverReply { outcome, reason, retreated_m, checked_against, joints_rad })
    }

    /// The robot's task of a call.
    fn task(&self, call: &Call, grasps: Option<HeldObject>) -> ExecutionTask {
        ExecutionTask { commander: self.link.commander().to_owned(), id: call.id.clone(), grasps }
    }

    /// A latched stop cleared.
    async fn reset(&self, call: &Call) -> Result<Payload, CallError> {
        Payload::json(&self.link.reset(&call.payload.decode_json()?).await?)
    }
}

#[async_trait]
impl Handler for Endpoints {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "plan" => self.plan(&call).await,
            "execute" => self.execute(&call).await,
            "reset" => self.reset(&call).await,
            "recover" => self.recover(&call).await,
            _ => Err(call.unknown_method()),
        }
    }

    fn at_most_once(&self, method: &str) -> bool {
        matches!(method, "execute" | "reset" | "recover")
    }

    fn load(&self) -> WorkerLoad {
        WorkerLoad { keep_out: self.worker.keep_out().to_vec(), ..load_of(&self.worker.gauge(), self.worker.capacity()) }
    }
}
