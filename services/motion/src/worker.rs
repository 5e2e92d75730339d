//! The compute side of the service: the bounded queue, the threads that plan, and the scenes that were sent.

use std::sync::Arc;

use repose_panda::FINGER_OPENING_MAX_M;
use repose_proto::motion::{KeepOutZone, MotionPhase, MotionPlan, MotionPlanRequest, Phase, RecoverRequest, RecoveryMove};
use repose_proto::robot::{GripperCommand, RobotState};
use repose_proto::{CallError, ErrorCode, Scene};
use repose_runtime::{ComputeQueue, JobContext, LoadGauge, QueueSettings, RuntimeError, SceneStore, check_scene_id};

use crate::config::MotionConfig;
use crate::execution::keep_out::{Zones, check_carried};
use crate::execution::{check_age, check_unmoved};
use crate::motion_scene::MotionScene;
use crate::obstacles::ObstacleShape;
use crate::path::timing::Trajectory;
use crate::pick_place::PickPlaceSettings;
use crate::recovery::{Recovery, RecoveryError, RecoverySettings};
use crate::request;
use crate::wire::{self, PlanTerms};

/// Plans on its own threads.
pub struct Worker {
    queue: ComputeQueue,
    settings: Arc<PickPlaceSettings>,
    terms: PlanTerms,
    recovery: Arc<RecoverySettings>,
    scenes: Arc<SceneStore<MotionScene>>,
    keep_out: Vec<KeepOutZone>,
}

impl Worker {
    /// Starts the threads.
    ///
    /// # Errors
    /// When the configuration is out of range or the operating system gives no threads.
    pub fn start(config: &MotionConfig) -> Result<Self, RuntimeError> {
        let queue =
            QueueSettings { name: "motion".to_owned(), capacity: config.queue, threads: config.threads, ..QueueSettings::default() };
        Ok(Self {
            settings: Arc::new(config.planning()?),
            terms: config.terms()?,
            recovery: Arc::new(config.recovery()?),
            queue: ComputeQueue::start(queue)?,
            scenes: Arc::new(SceneStore::new(config.scenes, usize::MAX, |_| 0)),
            keep_out: config.keep_out.clone(),
        })
    }

    /// Plans a request on the scene that came with it, or on one that came before, around what stands `beside` the robot and is in no scene. The same
    /// content seen again is as young as it was last seen.
    ///
    /// # Errors
    /// `not_found` on `scene_id` when the scene is not held and did not come; `invalid_argument` when it is another one; the planner's errors
    /// as `failed_precondition`; `cancelled` and `deadline_exceeded` as soon as they are so; those of the queue.
    pub async fn plan(
        &self,
        context: JobContext,
        request: MotionPlanRequest,
        scene: Option<Scene>,
        beside: Vec<ObstacleShape>,
    ) -> Result<MotionPlan, CallError> {
        let held = self.held(&request.scene.scene_id, scene.as_ref())?;
        let settings = match beside.is_empty() {
            true => self.settings.clone(),
            false => Arc::new(PickPlaceSettings { beside, ..(*self.settings).clone() }),
        };
        let (terms, scenes) = (self.terms, self.scenes.clone());
        let job = move |context: &JobContext| {
            let scene = match (held, scene) {
                (Some(held), None) => held,
                (Some(held), Some(sent)) if sent.stamp_ns <= held.scene().stamp_ns => held,
                (held, Some(sent)) => {
                    check_scene_id(&sent, &request.scene.scene_id)?;
                    Arc::new(match held {
                        Some(held) => held.seen_again(sent),
                        None => MotionScene::new(sent),
                    })
                }
                (None, None) => return Err(CallError::internal("no scene to plan on")),
            };
            // Kept before the planning, which may fail or be given up: the caller need not send it again. The youngest sighting stays, for the
            // id does not tell when the content was seen.
            scenes.keep_over(&request.scene.scene_id, scene.clone(), |held| held.scene().stamp_ns < scene.scene().stamp_ns);
            planned(context, &request, &scene, &settings, &terms)
        };
        self.queue.run(context, job).await
    }

    /// A scene that is here.
    pub fn scene(&self, scene_id: &str) -> Option<Arc<MotionScene>> {
        self.scenes.get(scene_id).ok()
    }

    /// The scene where this worker holds it; none where it came along.
    fn held(&self, scene_id: &str, sent: Option<&Scene>) -> Result<Option<Arc<MotionScene>>, CallError> {
        match self.scenes.get(scene_id) {
            Err(missing) if sent.is_none() => Err(missing),
            held => Ok(held.ok()),
        }
    }

    /// The phases that bring an arm back from where it stands, how far the hand backs off, metres, and the scene, named or sent, that its way was
    /// checked against. `beside` is what the robots beside it fill, and `unmoved` refuses a scene, by when it was seen, that they have changed since.
    ///
    /// # Errors
    /// As [`Self::plan`]; `failed_precondition` on `scene` when it is not of what stands there now, on `robot` when the arm cannot be brought back
    /// so, with what to do.
    pub async fn recover(
        &self,
        context: JobContext,
        request: RecoverRequest,
        scene: Option<Scene>,
        state: &RobotState,
        beside: Vec<ObstacleShape>,
        unmoved: impl Fn(u64) -> Result<(), CallError>,
    ) -> Result<(Vec<MotionPhase>, Option<f64>, Option<String>), CallError> {
        if request.motion == RecoveryMove::Open {
            let gripper = Some(GripperCommand { width_m: FINGER_OPENING_MAX_M, force_n: self.settings.grip_force_n });
            return Ok((vec![MotionPhase { name: Phase::Release, gripper, set_points: Vec::new() }], None, None));
        }
        if state.gripper_holding {
            let message = "the robot has something in its hand: `repose robot open` first lets go of it where it is";
            return Err(CallError::precondition(message).at("robot"));
        }
        let held = request.scene.as_ref().map(|named| self.held(&named.scene_id, scene.as_ref())).transpose()?.flatten();
        let seen_ns = held.as_ref().map(|held| held.scene().stamp_ns).max(scene.as_ref().map(|sent| sent.stamp_ns));
        if let Some(seen_ns) = seen_ns {
            let is_current = check_age(seen_ns, self.terms.max_scene_age_ms, state.stamp_ns)
                .and_then(|()| check_unmoved(seen_ns, "the robot", state))
                .and_then(|()| unmoved(seen_ns));
            is_current.map_err(|e| CallError { message: format!("{}, or recover without a scene", e.message), ..e }.at("scene"))?;
        }
        let settings = RecoverySettings { beside, ..(*self.recovery).clone() };
        let (period_ms, q_rad, opening_m) = (self.terms.set_point_period_ms, state.q_rad, state.gripper_width_m);
        let job = move |context: &JobContext| {
            let named = request.scene.map(|named| named.scene_id);
            let (scene, checked_against) = match (held, scene) {
                // It may be younger than what is held under its name, and that counts as young as it only where the two are the same.
                (_, Some(sent)) => {
                    named.as_ref().map_or(Ok(()), |named| check_scene_id(&sent, named))?;
                    (Some(wire::surroundings(&sent)?), Some(named.unwrap_or_else(|| sent.id())))
                }
                (Some(held), None) => (Some(wire::surroundings(held.scene())?), named),
                (None, None) => (None, None),
            };
            let recovery = Recovery::new(&q_rad, opening_m, scene.as_ref(), &settings);
            let stuck = |error: RecoveryError| CallError::precondition(error.to_string()).at("robot");
            let phase =
                |name, trajectory: &Trajectory| MotionPhase { name, gripper: None, set_points: wire::set_points(trajectory, period_ms) };
            match request.motion {
                RecoveryMove::Open | RecoveryMove::Retreat => {
                    let (trajectory, retreated_m) = recovery.retreat().map_err(stuck)?;
                    Ok((vec![phase(Phase::Retreat, &trajectory)], Some(retreated_m), checked_against))
                }
                RecoveryMove::Home => {
                    let way = recovery.home(&|| context.check().is_err());
                    context.check()?;
                    let phases = way.map_err(stuck)?.iter().map(|trajectory| phase(Phase::Home, trajectory)).collect();
                    Ok((phases, None, checked_against))
                }
            }
        };
        self.queue.run(context, job).await
    }

    /// A plan as it may be carried out, and its scene where that is held or was `fetched`. The plan has passed through its caller's hands: what it says
    /// of its scene's age counts only where that is stricter than this worker's limit and, where the scene is held, than that scene's stamp. Not for async
    /// code: it hashes a fetched scene and goes through the whole plan; whether to `go_on` is asked on the way.
    ///
    /// # Errors
    /// `not_found` when the plan's scene is known and has no such object; `failed_precondition` when the plan enters a keep-out zone, or carries
    /// something of a scene that is not known where there are zones; `invalid_argument` when another scene was fetched; what `go_on` says.
    pub fn executable(
        &self,
        mut plan: MotionPlan,
        fetched: Option<Scene>,
        go_on: &dyn Fn() -> Result<(), CallError>,
    ) -> Result<(MotionPlan, Option<Arc<MotionScene>>), CallError> {
        let held = match fetched {
            Some(scene) => {
                check_scene_id(&scene, &plan.scene_id)?;
                Some(self.scenes.keep(&plan.scene_id, Arc::new(MotionScene::new(scene))))
            }
            None => self.scenes.get(&plan.scene_id).ok(),
        };
        if let Some(scene) = held.as_ref().map(|held| held.scene()) {
            if scene.object(plan.query).is_none() {
                return Err(CallError::not_found("query", format!("the plan's scene has no object {}", plan.query)));
            }
            plan.scene_stamp_ns = plan.scene_stamp_ns.min(scene.stamp_ns);
        }
        plan.max_scene_age_ms = plan.max_scene_age_ms.min(self.terms.max_scene_age_ms);
        let scene = held.as_ref().map(|held| held.scene());
        if !self.settings.keep_out.is_empty() {
            check_carried(&plan, scene)?;
        }
        let zones = Zones { world_from_base: &self.settings.world_from_base, solids: &self.settings.keep_out, of_robot: None };
        zones.check(&plan, scene, go_on)?;
        Ok((plan, held))
    }

    /// The keep-out zones that are heeded here.
    pub fn keep_out(&self) -> &[KeepOutZone] {
        &self.keep_out
    }

    /// What waits and what runs.
    pub fn gauge(&self) -> Arc<LoadGauge> {
        self.queue.gauge()
    }

    /// Requests that may wait.
    pub fn capacity(&self) -> usize {
        self.queue.capacity()
    }
}

/// One request on its scene, while it is worth it.
fn planned(
    context: &JobContext,
    request: &MotionPlanRequest,
    scene: &MotionScene,
    settings: &PickPlaceSettings,
    terms: &PlanTerms,
) -> Result<MotionPlan, CallError> {
    context.check()?;
    request::plan(scene.scene(), scene.planning()?, request, settings, terms, &|| context.check().is_err()).map_err(|error| {
        match error.code {
            // The context knows why.
            ErrorCode::Cancelled => context.check().err().unwrap_or(error),
            _ => error,
        }
    })
}
