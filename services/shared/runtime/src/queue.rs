//! The bounded queue and the owned threads that compute: what every service's worker is made of.
//!
//! Async code submits and awaits; compute threads never await. A full queue refuses at once. A job whose caller has gone, whose deadline
//! has passed or whose request was cancelled is never started. Jobs that wait together are handed over together, up to `max_batch` and
//! `max_weight`, so that an inference thread can batch across requests, and a thread may wait a configured time for a fuller batch.
//! Interactive jobs go before batch ones and are not handed over with them, but these get a turn after some were let by. Where jobs are for
//! several cells, these take turns. A panic ends its jobs with `internal` and not the thread.
//!
//! Overload is shed at the door: a job whose wait would not leave it time to be computed before its deadline is refused at once, batch jobs
//! get no more than half of the places, and an interactive job takes the youngest batch job's place where there is none left.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use repose_proto::{CallError, ErrorCode};
use tokio::sync::oneshot;

use crate::RuntimeError;
use crate::cancel::given_up;
use crate::gauge::LoadGauge;
use crate::job::{Job, JobContext, JobReply};
use crate::scheduling::yield_to_messages;
use crate::shares::{ForCell, Shares};
use crate::waiting::{JobBatch, WaitingJobs};

/// Size of a queue and of its crew.
#[derive(Debug, Clone)]
pub struct QueueSettings {
    /// Name of the threads, for a debugger.
    pub name: String,
    /// Jobs that may wait. Higher: longer waits before a refusal.
    pub capacity: usize,
    /// Threads that compute.
    pub threads: usize,
    /// Jobs that a thread takes at once.
    pub max_batch: usize,
    /// What these may weigh together ([`BatchQueue::start_weighed`]); a heavier one is taken alone. Higher: fuller batches, and whoever comes
    /// during one waits longer.
    pub max_weight: usize,
    /// How long the first job of a batch waits for others. Higher: fuller batches when many ask, and every lone job is later by as much.
    pub max_wait: Duration,
    /// What each cell may have of it, where it serves several.
    pub shares: Arc<Shares>,
}

impl Default for QueueSettings {
    fn default() -> Self {
        Self {
            name: "compute".to_owned(),
            capacity: 32,
            threads: 1,
            max_batch: 1,
            max_weight: usize::MAX,
            max_wait: Duration::ZERO,
            shares: Arc::default(),
        }
    }
}

struct State<R, T> {
    jobs: WaitingJobs<R, T>,
    closed: bool,
}

struct Shared<R, T> {
    state: Mutex<State<R, T>>,
    arrived: Condvar,
    gauge: Arc<LoadGauge>,
    settings: QueueSettings,
    weigh: fn(&R) -> usize,
}

impl<R, T> Shared<R, T> {
    fn exhausted(&self, message: &str) -> CallError {
        self.refused(CallError::new(ErrorCode::ResourceExhausted, message))
    }

    /// Counts a refusal, and says when to come back.
    fn refused(&self, error: CallError) -> CallError {
        metrics::counter!("repose_refused_total", "queue" => self.settings.name.clone()).increment(1);
        error.retry_after(self.gauge.retry_after_ms(self.settings.threads))
    }

    fn state(&self) -> MutexGuard<'_, State<R, T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts jobs for these cells as done, which others of theirs may have waited for.
    fn finish(&self, cells: &[ForCell]) {
        let mut state = self.state();
        cells.iter().for_each(|cell| state.jobs.finish(cell));
    }

    /// Waits for jobs; none when the queue is closed and empty.
    fn take(&self) -> Option<Vec<Job<R, T>>> {
        let mut state = self.state();
        let QueueSettings { max_batch, max_weight, max_wait, .. } = self.settings;
        let mut taken = JobBatch::none(max_weight);
        let mut full_by = None;
        loop {
            while let Some(job) = state.jobs.pop(&mut taken, self.settings.threads, &self.gauge) {
                if let Some(job) = job.alive() {
                    state.jobs.start(&job);
                    let waited = job.queued.elapsed();
                    job.context.stages.add("queue", waited.as_secs_f64() * 1e3);
                    metrics::histogram!("repose_queue_seconds", "queue" => self.settings.name.clone()).record(waited.as_secs_f64());
                    let weight = (self.weigh)(&job.request);
                    taken.push(job, weight, max_batch);
                }
            }
            self.gauge.set_waiting(state.jobs.waiting());
            if !taken.jobs.is_empty() {
                let full_by = *full_by.get_or_insert_with(|| Instant::now() + max_wait);
                let left = full_by.saturating_duration_since(Instant::now());
                if taken.is_full || left.is_zero() || state.closed {
                    if state.jobs.waiting() > 0 {
                        // What is left here may have woken no other thread than this.
                        self.arrived.notify_one();
                    }
                    return Some(taken.in_order());
                }
                state = self.arrived.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
                continue;
            }
            if state.closed {
                return None;
            }
            state = self.arrived.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// A bounded queue of requests `R` with answers `T`, and the threads that serve it. Dropping it lets them finish what waits.
pub struct BatchQueue<R, T> {
    shared: Arc<Shared<R, T>>,
}

impl<R: Send + 'static, T: Send + 'static> BatchQueue<R, T> {
    /// Starts the threads. `crew(i)` makes what thread `i` computes with: it owns its state and gets one to `max_batch` jobs at a
    /// time, interactive ones first.
    ///
    /// # Errors
    /// When the operating system gives no thread.
    pub fn start<W>(settings: QueueSettings, crew: impl FnMut(usize) -> W) -> Result<Self, RuntimeError>
    where
        W: FnMut(Vec<Job<R, T>>) + Send + 'static,
    {
        Self::start_weighed(settings, |_| 1, crew)
    }

    /// The same for requests of unlike size: `weigh` says how much of `max_weight` one takes.
    ///
    /// # Errors
    /// When the operating system gives no thread.
    pub fn start_weighed<W>(settings: QueueSettings, weigh: fn(&R) -> usize, mut crew: impl FnMut(usize) -> W) -> Result<Self, RuntimeError>
    where
        W: FnMut(Vec<Job<R, T>>) + Send + 'static,
    {
        let state = Mutex::new(State { jobs: WaitingJobs::new(weigh, settings.shares.clone()), closed: false });
        let shared = Arc::new(Shared { state, arrived: Condvar::new(), gauge: Arc::default(), settings, weigh });
        // Made first, so that the threads end when one of them could not be started.
        let queue = Self { shared: shared.clone() };
        for i in 0..shared.settings.threads.max(1) {
            let (shared, mut work) = (shared.clone(), crew(i));
            let builder = std::thread::Builder::new().name(format!("{}-{i}", shared.settings.name));
            let thread = builder.spawn(move || {
                yield_to_messages();
                while let Some(batch) = shared.take() {
                    let (jobs, started) = (batch.len(), Instant::now());
                    let cells: Vec<ForCell> = batch.iter().map(|job| job.context.cell.clone()).collect();
                    shared.gauge.started(jobs);
                    // Unwinding drops the jobs, which answers them; the crew's state is its own affair.
                    if catch_unwind(AssertUnwindSafe(|| work(batch))).is_err() {
                        tracing::error!(queue = shared.settings.name, "a job panicked");
                    }
                    let elapsed = started.elapsed();
                    shared.gauge.finished(jobs, elapsed);
                    shared.finish(&cells);
                    let name = || shared.settings.name.clone();
                    metrics::histogram!("repose_compute_seconds", "queue" => name()).record(elapsed.as_secs_f64());
                    metrics::histogram!("repose_batch_jobs", "queue" => name()).record(jobs as f64);
                }
            });
            // Detached: it ends with the queue.
            drop(thread.map_err(|source| RuntimeError::System { operation: "starting a compute thread".to_owned(), source })?);
        }
        Ok(queue)
    }

    /// Queues a request.
    ///
    /// # Errors
    /// At once: `resource_exhausted` when there is no place for it or it could not be done before its deadline, `cancelled` or
    /// `deadline_exceeded` when it is too late already.
    pub fn submit(&self, context: JobContext, request: R) -> Result<PendingAnswer<T>, CallError> {
        context.check()?;
        let (reply, answer) = oneshot::channel();
        let mut state = self.shared.state();
        let QueueSettings { capacity, threads, .. } = self.shared.settings;
        state.jobs.drop_abandoned();
        let displaced = state.jobs.displaced_by(context.priority, capacity);
        if let Some(why) = state.jobs.refusal(&context, capacity, threads, &self.shared.gauge) {
            state.jobs.restore(displaced);
            return Err(self.shared.refused(CallError::from(&why)));
        }
        state.jobs.push(Job { queued: Instant::now(), request, context: context.clone(), reply: JobReply(reply) });
        self.shared.gauge.set_waiting(state.jobs.waiting());
        drop(state);
        if let Some(displaced) = displaced {
            displaced.finish(Err(self.shared.exhausted("an interactive call took this batch call's place")));
        }
        self.shared.arrived.notify_one();
        Ok(PendingAnswer { answer, context })
    }

    /// Queues a request and waits for its answer.
    ///
    /// # Errors
    /// Those of [`BatchQueue::submit`] and [`PendingAnswer::answer`].
    pub async fn run(&self, context: JobContext, request: R) -> Result<T, CallError> {
        self.submit(context, request)?.answer().await
    }

    /// What waits and what runs.
    pub fn gauge(&self) -> Arc<LoadGauge> {
        self.shared.gauge.clone()
    }

    /// Jobs that may wait.
    pub fn capacity(&self) -> usize {
        self.shared.settings.capacity
    }
}

impl<R, T> Drop for BatchQueue<R, T> {
    fn drop(&mut self) {
        self.shared.state().closed = true;
        self.shared.arrived.notify_all();
    }
}

/// An answer that is still being computed. Dropping it lets a job that has not started be skipped.
pub struct PendingAnswer<T> {
    answer: oneshot::Receiver<Result<T, CallError>>,
    context: JobContext,
}

impl<T> PendingAnswer<T> {
    /// Waits for the answer, for the deadline, or for the cancel.
    ///
    /// # Errors
    /// The job's own, `internal` when it panicked, `cancelled`, or `deadline_exceeded`.
    pub async fn answer(self) -> Result<T, CallError> {
        let deadline = tokio::time::Instant::from_std(self.context.deadline());
        tokio::select! {
            biased;
            answer = self.answer => answer.unwrap_or_else(|_| Err(CallError::internal("the computation ended without an answer"))),
            () = tokio::time::sleep_until(deadline) => {
                Err(CallError::new(ErrorCode::DeadlineExceeded, "the deadline passed before the work was done"))
            }
            () = self.context.cancelled().cancelled() => Err(given_up()),
        }
    }
}

type Task = Box<dyn FnOnce(&JobContext) + Send>;

/// A [`BatchQueue`] of closures, for services whose requests have nothing to share.
pub struct ComputeQueue {
    queue: BatchQueue<Task, ()>,
}

impl ComputeQueue {
    /// Starts the threads.
    ///
    /// # Errors
    /// When the operating system gives no thread.
    pub fn start(settings: QueueSettings) -> Result<Self, RuntimeError> {
        let settings = QueueSettings { max_batch: 1, ..settings };
        let queue = BatchQueue::start(settings, |_| {
            |jobs: Vec<Job<Task, ()>>| {
                for Job { request, context, reply, .. } in jobs {
                    context.span.in_scope(|| request(&context));
                    reply.finish(Ok(()));
                }
            }
        })?;
        Ok(Self { queue })
    }

    /// Computes `task` on one of the threads and waits for what it returns.
    ///
    /// # Errors
    /// The task's own; `resource_exhausted` at once when the queue is full; `cancelled`, `deadline_exceeded`; `internal` when it panicked.
    pub async fn run<T: Send + 'static>(
        &self,
        context: JobContext,
        task: impl FnOnce(&JobContext) -> Result<T, CallError> + Send + 'static,
    ) -> Result<T, CallError> {
        let (sender, answer) = oneshot::channel();
        let task: Task = Box::new(move |context| {
            // A caller that has gone needs no answer.
            drop(sender.send(task(context)));
        });
        self.queue.submit(context, task)?.answer().await?;
        answer.await.unwrap_or_else(|_| Err(CallError::internal("the computation ended without an answer")))
    }

    /// What waits and what runs.
    pub fn gauge(&self) -> Arc<LoadGauge> {
        self.queue.gauge()
    }

    /// Jobs that may wait.
    pub fn capacity(&self) -> usize {
        self.queue.capacity()
    }
}

#[cfg(test)]
#[path = "queue_tests.rs"]
mod tests;
