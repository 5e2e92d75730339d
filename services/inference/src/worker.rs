//! The compute side of the service: one thread owns the order of work, takes whatever requests wait together, and spreads their
//! candidates over the engine's threads.

use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;

use repose_proto::CallError;
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_runtime::{BatchQueue, Job, JobContext, LoadGauge, QueueSettings, RuntimeError};

use crate::config::InferenceConfig;
use crate::engine::Engine;
use crate::scene_store::{HeldScene, SceneStore};

/// A question to the networks about a held scene.
pub enum Question {
    /// Draws from the prior.
    Prior(PriorRequest, Arc<HeldScene>),
    /// Scores of candidates.
    Score(ScoreRequest, Arc<HeldScene>),
}

/// Its answer.
pub enum Answer {
    /// Draws from the prior.
    Prior(PriorReply),
    /// Scores of candidates.
    Score(ScoreReply),
}

/// Scores on its own threads and holds scenes.
pub struct Worker {
    queue: BatchQueue<Question, Answer>,
    engine: Arc<RwLock<Arc<Engine>>>,
    store: SceneStore,
}

impl Worker {
    /// Starts the thread that owns the order of work.
    ///
    /// # Errors
    /// When the operating system gives none.
    pub fn start(engine: Engine, config: &InferenceConfig) -> Result<Self, RuntimeError> {
        let engine = Arc::new(RwLock::new(Arc::new(engine)));
        let settings = QueueSettings {
            name: "inference".to_owned(),
            capacity: config.queue_capacity,
            threads: 1,
            max_batch: config.max_batch,
            max_wait: Duration::from_millis(config.max_wait_ms),
        };
        let queue = BatchQueue::start(settings, |_| {
            let engine = engine.clone();
            // One batch is answered by one set of weights.
            move |jobs| answer_together(&current(&engine), jobs)
        })?;
        Ok(Self { queue, engine, store: SceneStore::new(config.scenes, config.scenes_bytes) })
    }

    /// Asks a question and waits for its answer.
    ///
    /// # Errors
    /// The engine's, and those of the queue.
    pub async fn ask(&self, context: JobContext, question: Question) -> Result<Answer, CallError> {
        self.queue.run(context, question).await
    }

    /// The networks that are served now.
    pub fn engine(&self) -> Arc<Engine> {
        current(&self.engine)
    }

    /// Serves other networks from the next batch on.
    pub fn serve_with(&self, engine: Engine) {
        *self.engine.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(engine);
    }

    /// The scenes held.
    pub fn store(&self) -> &SceneStore {
        &self.store
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

fn current(engine: &RwLock<Arc<Engine>>) -> Arc<Engine> {
    Arc::clone(&engine.read().unwrap_or_else(PoisonError::into_inner))
}

fn answer_together(engine: &Engine, jobs: Vec<Job<Question, Answer>>) {
    let mut scores = Vec::new();
    for job in jobs {
        let Job { request, reply, .. } = job;
        match request {
            Question::Prior(request, held) => reply.finish(engine.prior(&request, &held).map(Answer::Prior)),
            Question::Score(request, held) => scores.push((request, held, reply)),
        }
    }
    let requests: Vec<(&ScoreRequest, &HeldScene)> = scores.iter().map(|(request, held, _)| (request, &**held)).collect();
    let answers = engine.score_together(&requests);
    for ((_, _, reply), answer) in scores.into_iter().zip(answers) {
        reply.finish(answer.map(Answer::Score));
    }
}
