//! The compute side of the service: the bounded queue, the threads that plan, and the scenes that were sent.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use repose_proto::motion::{MotionPlan, MotionPlanRequest};
use repose_proto::{CallError, ErrorCode, Scene};
use repose_runtime::{ComputeQueue, JobContext, LoadGauge, QueueSettings, RuntimeError};

use crate::config::MotionConfig;
use crate::pick_place::PickPlaceSettings;
use crate::request;
use crate::wire::PlanTerms;

/// Plans on its own threads.
pub struct Worker {
    queue: ComputeQueue,
    settings: Arc<PickPlaceSettings>,
    terms: PlanTerms,
    scenes: Arc<Mutex<HeldScenes>>,
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
            queue: ComputeQueue::start(queue)?,
            scenes: Arc::new(Mutex::new(HeldScenes { limit: config.scenes.max(1), held: VecDeque::new() })),
        })
    }

    /// Plans a request on the scene that came with it, or on one that came before. The same content seen again is as young as it was last seen.
    ///
    /// # Errors
    /// `not_found` on `scene_id` when the scene is not held and did not come; `invalid_argument` when it is another one; the planner's errors
    /// as `failed_precondition`; `cancelled` and `deadline_exceeded` as soon as they are so; those of the queue.
    pub async fn plan(&self, context: JobContext, request: MotionPlanRequest, scene: Option<Scene>) -> Result<MotionPlan, CallError> {
        let held = locked(&self.scenes).get(&request.scene.scene_id);
        if held.is_none() && scene.is_none() {
            let message = format!("this worker does not hold scene {}", request.scene.scene_id);
            return Err(CallError::not_found("scene_id", message));
        }
        let (settings, terms, scenes) = (self.settings.clone(), self.terms, self.scenes.clone());
        let job = move |context: &JobContext| {
            let scene = match (held, scene) {
                (Some(held), None) => held,
                (Some(held), Some(sent)) if sent.stamp_ns <= held.stamp_ns => held,
                (_, Some(sent)) => Arc::new(checked(sent, &request.scene.scene_id)?),
                (None, None) => return Err(CallError::internal("no scene to plan on")),
            };
            // Kept before the planning, which may fail or be given up: the caller need not send it again.
            locked(&scenes).keep(&request.scene.scene_id, scene.clone());
            planned(context, &request, &scene, &settings, &terms)
        };
        self.queue.run(context, job).await
    }

    /// A plan as it may be carried out: it travels through its caller, so what it says of its scene's age counts only where that is stricter
    /// than this worker's own limit and, where the scene is held, than when that was seen.
    ///
    /// # Errors
    /// `not_found` when the plan's scene is held and has no such object.
    pub fn executable(&self, mut plan: MotionPlan) -> Result<MotionPlan, CallError> {
        let held = locked(&self.scenes).get(&plan.scene_id);
        if let Some(scene) = held {
            if scene.object(plan.query).is_none() {
                return Err(CallError::not_found("query", format!("the plan's scene has no object {}", plan.query)));
            }
            plan.scene_stamp_ns = plan.scene_stamp_ns.min(scene.stamp_ns);
        }
        plan.max_scene_age_ms = plan.max_scene_age_ms.min(self.terms.max_scene_age_ms);
        Ok(plan)
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

/// The scene, if its content has the id that the request names.
fn checked(scene: Scene, scene_id: &str) -> Result<Scene, CallError> {
    let actual = scene.id();
    if actual == scene_id {
        return Ok(scene);
    }
    Err(CallError::invalid("scene.scene_id", format!("the enclosed scene's id is {actual}, not {scene_id}")))
}

fn locked(scenes: &Mutex<HeldScenes>) -> MutexGuard<'_, HeldScenes> {
    scenes.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One request on its scene, while it is worth it.
fn planned(
    context: &JobContext,
    request: &MotionPlanRequest,
    scene: &Scene,
    settings: &PickPlaceSettings,
    terms: &PlanTerms,
) -> Result<MotionPlan, CallError> {
    context.check()?;
    request::plan(scene, request, settings, terms, &|| context.check().is_err()).map_err(|error| match error.code {
        // The context knows why.
        ErrorCode::Cancelled => context.check().err().unwrap_or(error),
        _ => error,
    })
}

/// Scenes by id, least recently used out.
struct HeldScenes {
    limit: usize,
    /// Most recently used last.
    held: VecDeque<(String, Arc<Scene>)>,
}

impl HeldScenes {
    fn get(&mut self, scene_id: &str) -> Option<Arc<Scene>> {
        let at = self.held.iter().position(|(id, _)| id == scene_id)?;
        let entry = self.held.remove(at)?;
        let scene = entry.1.clone();
        self.held.push_back(entry);
        Some(scene)
    }

    /// Keeps the youngest sighting: the id leaves out when the content was seen.
    fn keep(&mut self, scene_id: &str, scene: Arc<Scene>) {
        let younger = self.get(scene_id).filter(|held| held.stamp_ns > scene.stamp_ns);
        self.held.retain(|(id, _)| id != scene_id);
        self.held.push_back((scene_id.to_owned(), younger.unwrap_or(scene)));
        while self.held.len() > self.limit {
            self.held.pop_front();
        }
    }
}
