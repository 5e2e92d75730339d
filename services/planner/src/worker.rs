//! The compute side of the service: the bounded queue and the threads that own a search each.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use repose_proto::place::PlaceProgress;
use repose_proto::{ArrangeRequest, ArrangeResult, CallError, PlaceRequest, PlaceResult, Scene};
use repose_runtime::{ComputeQueue, JobContext, LoadGauge, QueueSettings, RuntimeError, SceneStore, Shares};

use crate::arrange::arrange;
use crate::cached_scene::CachedScene;
use crate::config::PlannerConfig;
use crate::learned::models::PlacementModels;
use crate::plan::{SearchStep, plan};
use crate::search::stop::StopReason;

/// Searches on its own threads and keeps prepared scenes.
pub struct Worker {
    queue: ComputeQueue,
    scenes: SceneStore<CachedScene>,
    reply_reserve: Duration,
}

impl Worker {
    /// Starts the threads. `shares`: what each cell may have of them, where they serve several.
    ///
    /// # Errors
    /// When the operating system gives none.
    pub fn start(config: &PlannerConfig, shares: Arc<Shares>) -> Result<Self, RuntimeError> {
        let settings = QueueSettings {
            name: "planner".to_owned(),
            capacity: config.queue_capacity,
            threads: config.threads,
            shares,
            ..QueueSettings::default()
        };
        Ok(Self {
            queue: ComputeQueue::start(settings)?,
            scenes: SceneStore::new(config.scenes, usize::MAX, |_| 0),
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
        models: impl PlacementModels + 'static,
        progress: impl Fn(PlaceProgress) + Send + 'static,
    ) -> Result<PlaceResult, CallError> {
        let reserve = self.reply_reserve;
        let search = move |context: &JobContext| {
            let mut control = in_time(context, reserve, progress);
            plan(scene.prepared(), &request, &models, &mut control)
        };
        self.queue.run(context, search).await
    }

    /// Plans an arrangement on a scene.
    ///
    /// # Errors
    /// Those of [`arrange`] and of the queue.
    pub async fn arrange(
        &self,
        context: JobContext,
        scene: Arc<CachedScene>,
        request: ArrangeRequest,
        models: impl PlacementModels + 'static,
    ) -> Result<ArrangeResult, CallError> {
        let reserve = self.reply_reserve;
        let search = move |context: &JobContext| {
            let mut control = in_time(context, reserve, |_| ());
            arrange(scene.prepared(), &request, &models, &mut control)
        };
        self.queue.run(context, search).await
    }

    /// The scenes kept.
    pub fn scenes(&self) -> &SceneStore<CachedScene> {
        &self.scenes
    }

    /// Keeps a scene that a request enclosed or perception sent. Hashes it: not for async code.
    ///
    /// # Errors
    /// `invalid_argument` on `scene.scene_id` when its content has another id.
    pub fn keep(&self, scene_id: &str, scene: Scene) -> Result<Arc<CachedScene>, CallError> {
        self.scenes.admit(scene_id, scene, |scene| CachedScene::new(scene_id.to_owned(), Arc::new(scene)))
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

/// Lets a search go on until it is cancelled or its time is up; `progress` is told of every iteration.
fn in_time<'a>(
    context: &'a JobContext,
    reserve: Duration,
    progress: impl Fn(PlaceProgress) + 'a,
) -> impl FnMut(SearchStep) -> ControlFlow<StopReason> + 'a {
    let mut pace = Pace::default();
    move |step: SearchStep| {
        // Another batch takes about as long as the last one: a batch that cannot be finished is not begun.
        let batch = pace.since_last(Instant::now());
        if let SearchStep::Iteration(done) = step {
            progress(*done);
        }
        let left = context.remaining();
        if !left.is_zero() && context.cancelled().is_cancelled() {
            ControlFlow::Break(StopReason::Cancelled)
        } else if left < reserve + batch {
            ControlFlow::Break(StopReason::Deadline)
        } else {
            ControlFlow::Continue(())
        }
    }
}

/// The pace of a search. What is done once before its first step (preparing the scene, asking the prior and for the forecasts) tells nothing of how
/// long a batch takes.
#[derive(Debug, Default)]
struct Pace {
    last_step: Option<Instant>,
}

impl Pace {
    /// The time since the step before; none before the first.
    fn since_last(&mut self, now: Instant) -> Duration {
        self.last_step.replace(now).map_or(Duration::ZERO, |last| now.saturating_duration_since(last))
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::ErrorCode;
    use repose_proto::place::{Budget, Outcome, Variant};
    use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
    use repose_runtime::CancellationToken;

    use super::*;
    use crate::learned::forecast::Forecasts;
    use crate::learned::models::NoModels;
    use crate::tests::fake::{BESIDE, Fake};
    use crate::tests::synthetic::SceneBuilder;

    /// A worker, a scene, and a request on it that would take minutes.
    fn long_search() -> (Worker, Arc<CachedScene>, PlaceRequest) {
        let worker = Worker::start(&PlannerConfig { threads: 1, ..PlannerConfig::default() }, Arc::default()).unwrap();
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.25, -0.2], [0.06, 0.05, 0.08]).scene();
        let id = scene.id();
        let cached = worker.keep(&id, scene).unwrap();
        let request = PlaceRequest {
            variant: Variant::Geometric,
            budget: Budget { iterations: Some(100), batch: Some(1000), ..Budget::default() },
            ..PlaceRequest::new(id, 2, vec!["right_of:1".parse().unwrap()])
        };
        (worker, cached, request)
    }

    /// Models that take their time.
    struct Slow(Fake);

    impl PlacementModels for Slow {
        fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError> {
            self.0.prior(request, scene)
        }

        fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError> {
            std::thread::sleep(Duration::from_millis(50));
            self.0.score(request, scene)
        }

        fn forecasts(&self) -> Result<Arc<Forecasts>, CallError> {
            self.0.forecasts()
        }
    }

    #[tokio::test]
    async fn at_the_deadline_the_best_so_far_is_returned_as_partial() {
        let (worker, scene, request) = long_search();
        scene.prepared();
        // Each iteration asks twice at least: a hundred take ten seconds, one a small part of the deadline.
        let request = PlaceRequest { variant: Variant::Full, budget: Budget { iterations: Some(100), ..Budget::default() }, ..request };
        let deadline = Duration::from_secs(3);
        // A machine that stands still about the deadline is late once, and a search that overlooks it always.
        for tries in 1.. {
            let (scene, request, begin) = (scene.clone(), request.clone(), Instant::now());
            let ended = worker.plan(JobContext::within(deadline), scene, request, Slow(Fake::new(&[BESIDE])), |_| ()).await;
            let took = begin.elapsed();
            if took < deadline {
                let result = ended.unwrap();
                assert_eq!((result.outcome, result.placements.len()), (Outcome::Partial, 1));
                assert!((1..100).contains(&result.iterations), "{}", result.iterations);
                break;
            }
            assert!(tries < 5, "{took:?}: {ended:?}");
        }
    }

    #[test]
    fn what_comes_before_the_first_batch_is_no_batch() {
        let (begin, mut pace) = (Instant::now(), Pace::default());
        let at = |s: u64| begin + Duration::from_secs(s);
        assert_eq!([5, 6, 9].map(|s| pace.since_last(at(s)).as_secs()), [0, 1, 3]);
    }

    #[tokio::test]
    async fn a_cancelled_search_ends_before_its_next_batch() {
        let (worker, scene, request) = long_search();
        let token = CancellationToken::new();
        let context = JobContext::new(Instant::now() + Duration::from_secs(600), token.clone());
        let iterations = Arc::new(std::sync::atomic::AtomicU32::new(0));
        let counted = iterations.clone();
        let cancel = move |done: PlaceProgress| {
            counted.store(done.iterations, std::sync::atomic::Ordering::SeqCst);
            if done.iterations == 2 {
                token.cancel();
            }
        };
        let error = worker.plan(context, scene, request, NoModels, cancel).await.unwrap_err();
        assert_eq!(error.code, ErrorCode::Cancelled);
        // The worker's thread ends within the batch; it may have ended after the caller was told.
        while worker.gauge().running() > 0 {
            tokio::task::yield_now().await;
        }
        assert_eq!(iterations.load(std::sync::atomic::Ordering::SeqCst), 2);
    }
}
