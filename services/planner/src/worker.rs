//! The compute side of the service: the bounded queue and the threads that own a search each.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use repose_proto::place::PlaceProgress;
use repose_proto::{CallError, PlaceRequest, PlaceResult};
use repose_runtime::{ComputeQueue, JobContext, LoadGauge, QueueSettings, RuntimeError};

use crate::config::PlannerConfig;
use crate::models::Models;
use crate::plan::{Step, plan};
use crate::scene_cache::{CachedScene, SceneCache};
use crate::search::Stop;

/// Searches on its own threads and keeps prepared scenes.
pub struct Worker {
    queue: ComputeQueue,
    scenes: SceneCache,
    reply_reserve: Duration,
}

impl Worker {
    /// Starts the threads.
    ///
    /// # Errors
    /// When the operating system gives none.
    pub fn start(config: &PlannerConfig) -> Result<Self, RuntimeError> {
        let settings = QueueSettings {
            name: "planner".to_owned(),
            capacity: config.queue_capacity,
            threads: config.threads,
            ..QueueSettings::default()
        };
        Ok(Self {
            queue: ComputeQueue::start(settings)?,
            scenes: SceneCache::new(config.scenes),
            reply_reserve: Duration::from_millis(config.reply_reserve_ms),
        })
    }

    /// Plans on a scene; `progress` is told of every iteration.
    ///
    /// # Errors
    /// Those of [`plan`] and of the queue.
    pub async fn plan(
        &self,
        context: JobContext,
        scene: Arc<CachedScene>,
        request: PlaceRequest,
        models: impl Models + 'static,
        progress: impl Fn(PlaceProgress) + Send + 'static,
    ) -> Result<PlaceResult, CallError> {
        let reserve = self.reply_reserve;
        let search = move |context: &JobContext| {
            let mut last_batch = Instant::now();
            let mut control = |step: Step| {
                // Another batch will take about as long as the last one did: what cannot be finished is not begun.
                let batch = last_batch.elapsed();
                last_batch = Instant::now();
                if let Step::Iteration(done) = step {
                    progress(*done);
                }
                let left = context.remaining();
                if !left.is_zero() && context.cancelled().is_cancelled() {
                    ControlFlow::Break(Stop::Cancelled)
                } else if left < reserve + batch {
                    ControlFlow::Break(Stop::Deadline)
                } else {
                    ControlFlow::Continue(())
                }
            };
            plan(scene.prepared(), &request, &models, &mut control)
        };
        self.queue.run(context, search).await
    }

    /// The scenes kept.
    pub fn scenes(&self) -> &SceneCache {
        &self.scenes
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
