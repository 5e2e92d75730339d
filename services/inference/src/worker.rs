//! The compute side of the service: one thread owns the order of work, takes all waiting requests together, and spreads their candidates over
//! the engine's threads. A request is answered when its last candidate is scored, and dropped when nobody waits for it any more.

use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Duration;

use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, ErrorCode, Scene};
use repose_runtime::{BatchQueue, Job, JobContext, JobReply, LoadGauge, QueueSettings, RuntimeError, SceneStore, Shares};

use crate::config::InferenceConfig;
use crate::engine::Engine;
use crate::held_scene::HeldScene;
use crate::scoring::ScoreJob;

/// A request to the networks about a held scene.
pub enum ModelRequest {
    /// Draws from the prior.
    Prior(PriorRequest, Arc<HeldScene>),
    /// Scores of candidates.
    Score(ScoreRequest, Arc<HeldScene>),
}

impl ModelRequest {
    /// The cost in candidates, about; a prior takes no longer than one.
    fn weight(&self) -> usize {
        match self {
            Self::Prior(..) => 1,
            Self::Score(request, _) => request.candidates.len(),
        }
    }
}

/// The networks' reply.
pub enum ModelReply {
    /// Draws from the prior.
    Prior(PriorReply),
    /// Scores of candidates.
    Score(ScoreReply),
}

/// Scores on its own threads and holds scenes.
pub struct Worker {
    queue: BatchQueue<ModelRequest, ModelReply>,
    engine: Arc<RwLock<Arc<Engine>>>,
    store: SceneStore<HeldScene>,
}

impl Worker {
    /// Starts the thread that owns the order of work. `shares`: what each cell may have of it, where it serves several.
    ///
    /// # Errors
    /// When the operating system gives none.
    pub fn start(engine: Engine, config: &InferenceConfig, shares: Arc<Shares>) -> Result<Self, RuntimeError> {
        let engine = Arc::new(RwLock::new(Arc::new(engine)));
        let settings = QueueSettings {
            name: "inference".to_owned(),
            capacity: config.queue_capacity,
            threads: 1,
            max_batch: config.max_batch,
            max_weight: config.max_batch_candidates,
            max_wait: Duration::from_millis(config.max_wait_ms),
            shares,
        };
        let queue = BatchQueue::start_weighed(settings, ModelRequest::weight, |_| {
            let engine = engine.clone();
            // One batch is answered by one set of weights.
            move |jobs| answer_together(&current(&engine), jobs)
        })?;
        Ok(Self { queue, engine, store: SceneStore::new(config.scenes, config.scenes_bytes, HeldScene::bytes) })
    }

    /// Asks a question and waits for its answer.
    ///
    /// # Errors
    /// The engine's, and those of the queue.
    pub async fn ask(&self, context: JobContext, question: ModelRequest) -> Result<ModelReply, CallError> {
        self.queue.run(context, question).await
    }

    /// The engine in service.
    pub fn engine(&self) -> Arc<Engine> {
        current(&self.engine)
    }

    /// Serves with another engine from the next batch on.
    pub fn serve_with(&self, engine: Engine) {
        *self.engine.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(engine);
    }

    /// The scenes held.
    pub fn store(&self) -> &SceneStore<HeldScene> {
        &self.store
    }

    /// Holds a scene that a request enclosed. Hashes it: not for async code.
    ///
    /// # Errors
    /// `invalid_argument` on `scene.scene_id` when its content has another id.
    pub fn hold(&self, scene_id: &str, scene: Scene) -> Result<Arc<HeldScene>, CallError> {
        self.store.admit(scene_id, scene, |scene| HeldScene::new(scene_id.to_owned(), Arc::new(scene)))
    }

    /// How much waits and runs.
    pub fn gauge(&self) -> Arc<LoadGauge> {
        self.queue.gauge()
    }

    /// Requests that may wait.
    pub fn capacity(&self) -> usize {
        self.queue.capacity()
    }
}

fn current(engine: &RwLock<Arc<Engine>>) -> Arc<Engine> {
    Arc::clone(&engine.read().unwrap_or_else(PoisonError::into_inner))
}

/// A request to score that waits for its reply.
struct PendingScore {
    request: ScoreRequest,
    held: Arc<HeldScene>,
    context: JobContext,
    /// Taken by the answer.
    reply: Mutex<Option<JobReply<ModelReply>>>,
}

impl PendingScore {
    /// Whether to continue.
    fn check(&self) -> Result<(), CallError> {
        let reply = self.reply.lock().unwrap_or_else(PoisonError::into_inner);
        match reply.as_ref().is_some_and(JobReply::is_awaited) {
            true => self.context.check(),
            false => Err(CallError::new(ErrorCode::Cancelled, "the caller has gone")),
        }
    }

    fn finish(&self, answer: Result<ScoreReply, CallError>) {
        if let Some(reply) = self.reply.lock().unwrap_or_else(PoisonError::into_inner).take() {
            reply.finish(answer.map(ModelReply::Score));
        }
    }
}

fn answer_together(engine: &Engine, jobs: Vec<Job<ModelRequest, ModelReply>>) {
    let mut scores = Vec::new();
    for job in jobs {
        let Job { request, context, reply, .. } = job;
        match request {
            ModelRequest::Prior(request, held) => {
                let answer = context.check().and_then(|()| engine.prior(&request, &held));
                reply.finish(answer.map(ModelReply::Prior));
            }
            ModelRequest::Score(request, held) => scores.push(PendingScore { request, held, context, reply: Mutex::new(Some(reply)) }),
        }
    }
    let checks: Vec<_> = scores.iter().map(|pending| || pending.check()).collect();
    let jobs: Vec<ScoreJob<'_>> =
        scores.iter().zip(&checks).map(|(pending, check)| ScoreJob { request: &pending.request, held: &pending.held, check }).collect();
    engine.score_together(&jobs, |i, answer| scores[i].finish(answer));
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use repose_proto::SceneRef;
    use repose_proto::scoring::RealismBy;
    use tokio_util::sync::CancellationToken;

    use super::*;

    #[test]
    fn a_scoring_job_continues_as_long_as_someone_waits_for_it() {
        let (sender, jobs) = mpsc::channel();
        let queue = BatchQueue::<(), ModelReply>::start(QueueSettings::default(), |_| {
            let sender = sender.clone();
            move |jobs| jobs.into_iter().for_each(|job: Job<(), ModelReply>| sender.send(job).unwrap())
        })
        .unwrap();
        let scoring = |context: JobContext| {
            let pending = queue.submit(context, ()).unwrap();
            let Job { context, reply, .. } = jobs.recv().unwrap();
            let request = ScoreRequest {
                scene: SceneRef { scene_id: "scene".to_owned() },
                view_yaw_rad: 0.0,
                query: 1,
                anchors: Vec::new(),
                realism: true,
                realism_by: RealismBy::Discriminator,
                relations: false,
                candidates: Vec::new(),
            };
            let held = Arc::new(HeldScene::new("scene".to_owned(), Arc::new(crate::held_scene::tests::scene(1, 0.0))));
            (pending, PendingScore { request, held, context, reply: Mutex::new(Some(reply)) })
        };
        let minute = Duration::from_secs(60);
        let (pending, gone) = scoring(JobContext::within(minute));
        gone.check().unwrap();
        drop(pending);
        assert_eq!(gone.check().unwrap_err().code, ErrorCode::Cancelled);
        let token = CancellationToken::new();
        let (_pending, cancelled) = scoring(JobContext::new(std::time::Instant::now() + minute, token.clone()));
        cancelled.check().unwrap();
        token.cancel();
        assert_eq!(cancelled.check().unwrap_err().code, ErrorCode::Cancelled);
    }
}
