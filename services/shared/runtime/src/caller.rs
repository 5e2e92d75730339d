//! Calls to a service: finds its workers, chooses one, tries again on another where that is safe, and ends each call exactly once.
//!
//! An attempt is left for another worker when its worker refuses or is gone, when the worker's load has been silent, or when the
//! attempt has outlived its share of the deadline and takes much longer than that worker's calls do (its request may be lost). The same
//! request id goes along, so a worker that gets it twice computes it once. What an attempt says after it was left goes nowhere.
//!
//! While the router is away a call waits for it, up to its deadline: attempts that the outage ended do not count. A worker whose token
//! nobody stands behind is left after one try.

mod any;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bytes::Bytes;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_proto::{CallAttachment, CallError, ErrorCode, Payload, Priority, limits, message};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use crate::RuntimeError;
use crate::attempt::{Attempt, Ended};
use crate::call_options::CallOptions;
use crate::cancel::{CancelUnlessDone, cancel_at, given_up};
use crate::config::CallerConfig;
use crate::directory::{Assigned, Directory, Wanted, WorkerView};
use crate::heeded::{self, BatchCall, Refused};
use crate::kept_out::{self, Answered, is_kept_out};
use crate::outage::{LOOK, Patience};
use crate::target::Target;
use crate::transport::{OutgoingQuery, Transport};

/// By how much the network's own time limit of a query outlives the deadline: the caller's clock alone ends a call, and a stream that ends
/// empty before then says that the worker is gone.
const NETWORK_MARGIN: Duration = Duration::from_secs(1);
/// An attempt is slow when it takes this many times what its worker's calls take.
const SLOW_FACTOR: u32 = 3;

/// The result of a call.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The result.
    pub payload: Payload,
    /// The worker that answered.
    pub worker: String,
    /// How many attempts it took.
    pub attempts: u32,
    /// Milliseconds by stage, as the worker counted them.
    pub timing_ms: BTreeMap<String, f64>,
}

/// Calls one service. Cheap to clone.
#[derive(Clone)]
pub struct Caller {
    inner: Arc<Inner>,
}

struct Inner {
    transport: Arc<dyn Transport>,
    target: Target,
    /// The name that this process goes by.
    name: Option<String>,
    config: CallerConfig,
    directory: Directory,
    patience: Patience,
    answered: Answered,
    /// Terminal replies that followed a terminal reply.
    duplicates: Arc<AtomicU64>,
}

impl Caller {
    /// Starts to follow the service's workers.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn new(
        transport: Arc<dyn Transport>,
        target: Target,
        name: Option<String>,
        config: CallerConfig,
    ) -> Result<Self, RuntimeError> {
        let random = Pcg64::seed_from_u64(config.seed.unwrap_or_else(|| uuid::Uuid::new_v4().as_u64_pair().0));
        let suspect_after = Duration::from_millis(config.suspect_after_ms);
        let directory = Directory::follow(transport.as_ref(), &target.workers_in, target.service, suspect_after, random).await?;
        let patience = Patience::new(transport.clone(), target.clone(), &config);
        let (answered, duplicates) = (Answered::default(), Arc::default());
        Ok(Self { inner: Arc::new(Inner { transport, target, name, config, directory, patience, answered, duplicates }) })
    }

    /// How many terminal replies came after the one that ended their call: none, unless a worker breaks the contract.
    pub fn duplicates(&self) -> u64 {
        self.inner.duplicates.load(Ordering::Relaxed)
    }

    /// Whether this process fetches scenes in packed form.
    pub(crate) fn packs_scenes(&self) -> bool {
        self.inner.config.packed_scenes
    }

    /// The workers alive now, by name.
    pub fn workers(&self) -> Vec<WorkerView> {
        self.inner.directory.workers()
    }

    /// Waits until `count` workers are alive and have told their load.
    ///
    /// # Errors
    /// `unavailable` when that takes longer than `bound`.
    pub async fn wait_for_workers(&self, count: usize, bound: Duration) -> Result<(), CallError> {
        let directory = &self.inner.directory;
        let enough = async {
            loop {
                let mut changed = std::pin::pin!(directory.changed());
                changed.as_mut().enable();
                if directory.workers().iter().filter(|w| w.load.is_some()).count() >= count {
                    return;
                }
                changed.await;
            }
        };
        match tokio::time::timeout(bound, enough).await {
            Ok(()) => Ok(()),
            Err(_) => Err(self.inner.patience.nobody().await),
        }
    }

    /// Makes a call. Ends within its deadline, exactly once.
    ///
    /// # Errors
    /// The worker's error, or ours: `invalid_argument` (oversize, deadline out of range), `unavailable` (nobody there, or gone and no
    /// retry left), `deadline_exceeded`, `cancelled`.
    pub async fn call(&self, method: &str, payload: Payload, options: CallOptions) -> Result<Answer, CallError> {
        message::check_size(payload.bytes.len())?;
        let deadline = deadline_of(&options)?;
        let id = options.id.clone().unwrap_or_else(|| uuid::Uuid::new_v4().to_string());
        let ongoing = Ongoing {
            inner: &self.inner,
            method,
            payload,
            options: &options,
            id,
            deadline,
            tried: Vec::new(),
            cancelled_at: Vec::new(),
            left: None,
            attempts: 0,
        };
        // Debug, so that logs have no second span beside the worker's; a collector of traces gets it all the same.
        let span = tracing::debug_span!("request", id = ongoing.id, method, service = self.inner.target.service.as_str());
        crate::trace::continue_from(&span, options.traceparent.as_deref());
        ongoing.run().instrument(span).await
    }
}

/// When a call with these options ends.
fn deadline_of(options: &CallOptions) -> Result<Instant, CallError> {
    match options.deadline.as_millis() {
        0 => Err(too_late()),
        ms if ms > u128::from(limits::MAX_REMAINING_MS) => {
            Err(CallError::invalid("remaining_ms", format!("expected 1 to {} ms, got {ms}", limits::MAX_REMAINING_MS)))
        }
        _ => Ok(Instant::now() + options.deadline),
    }
}

impl Inner {
    /// What `find` finds among the workers, waiting a while for one to appear, and for the router as long as the deadline allows; none at that.
    async fn wait_for<T>(
        &self,
        deadline: Instant,
        cancel: &CancellationToken,
        find: impl Fn() -> Option<T>,
    ) -> Result<Option<T>, CallError> {
        let (directory, patience, began) = (&self.directory, &self.patience, Instant::now());
        loop {
            let mut changed = std::pin::pin!(directory.changed());
            changed.as_mut().enable();
            if let Some(found) = find() {
                return Ok(Some(found));
            }
            tokio::select! {
                () = changed => {}
                () = cancel.cancelled() => return Err(CallError::new(ErrorCode::Cancelled, "cancelled before it was sent")),
                () = tokio::time::sleep_until(deadline.min(Instant::now() + LOOK)) => {
                    if Instant::now() >= deadline {
                        return Ok(None);
                    }
                    if patience.is_over(began) {
                        return Err(patience.nobody().await);
                    }
                }
            }
        }
    }
}

fn too_late() -> CallError {
    CallError::new(ErrorCode::DeadlineExceeded, "the deadline passed before an answer came")
}

/// One call under way.
struct Ongoing<'a> {
    inner: &'a Inner,
    method: &'a str,
    payload: Payload,
    options: &'a CallOptions,
    id: String,
    deadline: Instant,
    tried: Vec<String>,
    /// Workers that were told to forget the request: asked again, they would say that it was cancelled.
    cancelled_at: Vec<String>,
    /// Tells the worker of the attempt that was left last, once the call goes elsewhere or ends: asked again, it has one call of both attempts.
    left: Option<CancelUnlessDone<'a>>,
    attempts: u32,
}

/// What to do after an attempt.
enum Next {
    Done(Result<Answer, CallError>),
    /// Try again; the error stands if there is no other try.
    Again(CallError),
    /// The same, but the attempt does not count: it never reached a worker.
    Unheard(CallError),
    /// The same without a pause: the attempt that was left was one, and a short deadline must not end in it.
    AtOnce(CallError),
}

impl Ongoing<'_> {
    async fn run(mut self) -> Result<Answer, CallError> {
        loop {
            if let Some(stands) = self.inner.directory.refused_by_all(&self.wanted()) {
                metrics::counter!("repose_refusals_heeded_total", "service" => self.inner.target.service.as_str()).increment(1);
                return Err(heeded::refusal(&self.inner.target.to_string(), stands));
            }
            let assigned = self.worker().await?;
            let (error, waited) = match self.attempt(&assigned).await {
                Next::Done(outcome) => return outcome,
                Next::Unheard(error) if self.options.idempotent => {
                    tracing::debug!(id = self.id, worker = assigned.name(), %error, "the attempt reached nobody");
                    continue;
                }
                Next::Again(error) | Next::Unheard(error) => (error, false),
                Next::AtOnce(error) => (error, true),
            };
            self.attempts += 1;
            if !self.may_repeat() {
                return Err(error);
            }
            if !self.tried.iter().any(|name| name == assigned.name()) {
                self.tried.push(assigned.name().to_owned());
            }
            drop(assigned);
            if !waited {
                self.back_off(error).await?;
            }
        }
    }

    /// Whether there is another attempt after `self.attempts`.
    fn may_repeat(&self) -> bool {
        self.options.idempotent && self.attempts <= self.inner.config.retries
    }

    fn remaining(&self) -> Duration {
        self.deadline.saturating_duration_since(Instant::now())
    }

    fn wanted(&self) -> Wanted<'_> {
        let (worker, accept) = (self.options.worker.as_deref(), self.options.accept.as_ref());
        let needs_load = self.inner.target.service.operates(self.method);
        Wanted { worker, accept, tried: &self.tried, never: &self.cancelled_at, needs_load, heeds: self.as_batch() }
    }

    /// The call as refusals see it; none where it asks whatever was refused before.
    fn as_batch(&self) -> Option<BatchCall> {
        let heeds = self.options.priority == Priority::Batch && self.inner.config.heed_refusals_ms > 0;
        heeds.then(|| BatchCall { left: self.remaining(), cell: self.options.cell.clone() })
    }

    /// Notes a refusal, for others like this call.
    fn note_refusal(&self, error: &CallError, worker: &str, call: Option<BatchCall>) {
        let most = Duration::from_millis(self.inner.config.heed_refusals_ms);
        if let Some(refused) = call.and_then(|call| Refused::by(error, call, most)) {
            self.inner.directory.mark_refused(worker, refused);
        }
    }

    /// A worker to ask.
    async fn worker(&self) -> Result<Assigned, CallError> {
        let found = self.inner.wait_for(self.deadline, &self.options.cancel, || self.inner.directory.choose(&self.wanted())).await?;
        found.ok_or_else(|| self.inner.patience.at_deadline(too_late()))
    }

    /// Waits before the same workers are asked again; not at all when another one is there.
    async fn back_off(&self, error: CallError) -> Result<(), CallError> {
        if self.inner.directory.has_alternative(&self.wanted(), None) {
            return Ok(());
        }
        if error.code == ErrorCode::ResourceExhausted {
            // Asking again would only add to the overload: the caller is told at once, and when to come back.
            return Err(error);
        }
        let doubled = self.inner.config.backoff_ms.saturating_mul(1 << self.attempts.min(8));
        let wait_ms = error.retry_after_ms.unwrap_or(0).max(doubled) as f64 * (0.5 + 0.5 * self.inner.directory.random());
        let wait = Duration::from_micros((wait_ms * 1e3) as u64);
        if wait * 2 > self.remaining() {
            return Err(error);
        }
        self.options.pause(wait).await
    }

    async fn attempt(&mut self, assigned: &Assigned) -> Next {
        let (inner, remaining, as_batch) = (self.inner, self.remaining(), self.as_batch());
        if self.options.cancel.is_cancelled() {
            return Next::Done(Err(given_up()));
        }
        if remaining.as_millis() == 0 {
            return Next::Done(Err(too_late()));
        }
        let attachment = CallAttachment {
            v: limits::VERSION,
            id: self.id.clone(),
            method: self.method.to_owned(),
            remaining_ms: u64::try_from(remaining.as_millis()).unwrap_or(limits::MAX_REMAINING_MS),
            priority: self.options.priority,
            attempt: self.attempts,
            traceparent: crate::trace::traceparent(&tracing::Span::current()).or_else(|| self.options.traceparent.clone()),
            caller: inner.name.clone(),
        };
        let query = OutgoingQuery {
            payload: self.payload.clone(),
            attachment: Bytes::from(attachment.encode()),
            priority: self.options.priority,
            timeout: remaining + NETWORK_MARGIN,
        };
        let operates = inner.target.service.operates(self.method) && inner.directory.operates(assigned.name());
        let key = inner.target.call(assigned.name(), operates, self.options.cell.as_deref());
        let connection = inner.transport.connection();
        let (transport, target) = (&inner.transport, &inner.target);
        let mut guard = CancelUnlessDone { transport, target, worker: assigned.name().to_owned(), id: self.id.clone(), armed: true };
        self.end_left(assigned.name());
        // A transport that does not take the query in time is like a worker that does not answer.
        let sent = tokio::select! {
            biased;
            sent = tokio::time::timeout_at(self.deadline, inner.transport.query(&key, query)) => sent,
            () = self.given_up_unsent() => {
                guard.armed = false;
                self.tell_given_up(assigned.name(), self.grace_end()).await;
                return Next::Done(Err(given_up()));
            }
        };
        let replies = match sent {
            Ok(Ok(replies)) => replies,
            Ok(Err(error)) => {
                self.left = Some(guard);
                return Next::Again(error.into());
            }
            Err(_) => return Next::Done(Err(too_late())),
        };
        let attempt = Attempt::new(replies, &self.id, self.options.progress.as_ref());
        let ended = self.watch(attempt, assigned.name(), remaining).await;
        guard.armed = matches!(ended, Ended::Left | Ended::Overdue | Ended::Garbled(_));
        if matches!(ended, Ended::Left) {
            self.left = Some(guard);
        }
        if matches!(ended, Ended::Result { .. } | Ended::Error(_)) {
            inner.answered.note(&key, connection);
        }
        let is_same_link = inner.transport.connection() == connection;
        if matches!(ended, Ended::Empty) && is_same_link && !inner.answered.has(&key, connection) {
            let within = Duration::from_millis(inner.config.suspect_after_ms).min(self.remaining());
            if is_kept_out(inner.transport.as_ref(), &inner.directory, assigned.name(), within).await {
                return Next::Done(Err(kept_out::refusal(&inner.target, assigned.name(), self.method)));
            }
        }
        if matches!(ended, Ended::Empty) && self.options.idempotent {
            let message = format!("{} worker {} is gone", inner.target.service, assigned.name());
            let gone = CallError::new(ErrorCode::Unavailable, message);
            let was_ever_there = inner.directory.has_told_load(assigned.name());
            inner.directory.mark_deserted(assigned.name());
            return if !is_same_link || !was_ever_there { Next::Unheard(gone) } else { Next::Again(gone) };
        }
        if let Ended::Error(error) = &ended {
            self.note_refusal(error, assigned.name(), as_batch);
        }
        self.judge(ended, assigned.name())
    }

    /// Tells the worker of the attempt that was left, unless it is asked again: a cancel would forbid that.
    fn end_left(&mut self, asked: &str) {
        if let Some(mut left) = self.left.take() {
            left.armed = left.worker != asked;
            if left.armed {
                self.cancelled_at.push(left.worker.clone());
            }
        }
    }

    /// Reads replies until the terminal one, the deadline, the cancel, or a reason to leave this worker.
    async fn watch(&self, mut attempt: Attempt<'_>, worker: &str, remaining: Duration) -> Ended {
        let inner = self.inner;
        let last = !self.options.idempotent || self.attempts >= inner.config.retries;
        let started = Instant::now();
        let share = remaining.mul_f64(inner.config.attempt_share);
        let mut look = tokio::time::interval(Duration::from_millis((inner.config.suspect_after_ms / 8).max(10)));
        loop {
            tokio::select! {
                biased;
                ended = attempt.next() => {
                    attempt.count_rest(inner.duplicates.clone());
                    return ended;
                }
                () = self.options.cancel.cancelled() => return self.cancelled(attempt, worker).await,
                () = tokio::time::sleep_until(self.deadline) => return Ended::Overdue,
                _ = look.tick(), if !last => {
                    let silent = inner.directory.is_suspect(worker) && inner.directory.has_alternative(&self.wanted(), Some(worker));
                    let may_leave = self.options.leaves_slow && !attempt.has_progressed();
                    let slow = started.elapsed() >= share && may_leave && self.is_slow(worker, started.elapsed());
                    if silent || slow {
                        return Ended::Left;
                    }
                }
            }
        }
    }

    /// Whether a call takes much longer than its worker's calls do. One that is long because they all are is let be: another worker
    /// would take as long again.
    fn is_slow(&self, worker: &str, elapsed: Duration) -> bool {
        self.inner.directory.expected(worker).is_none_or(|expected| elapsed > expected * SLOW_FACTOR)
    }

    /// Ends a call that its caller gave up. One that must not be repeated tells what came of it, if its worker says so soon.
    async fn cancelled(&self, mut attempt: Attempt<'_>, worker: &str) -> Ended {
        let grace_end = self.grace_end();
        self.tell_given_up(worker, grace_end).await;
        if self.options.idempotent {
            return Ended::Cancelled;
        }
        match tokio::time::timeout_at(grace_end, attempt.next()).await {
            Ok(ended) => ended,
            Err(_) => Ended::Cancelled,
        }
    }

    /// Waits until the caller gives up while a link takes nothing. One that must not be repeated goes on for a while: its worker can tell what came of
    /// what was sent after all.
    async fn given_up_unsent(&self) {
        self.options.cancel.cancelled().await;
        if !self.options.idempotent {
            tokio::time::sleep_until(self.grace_end()).await;
        }
    }

    /// Until when a call that was given up may still take.
    fn grace_end(&self) -> Instant {
        self.deadline.min(Instant::now() + Duration::from_millis(self.inner.config.cancel_grace_ms))
    }

    /// Tells a worker that its call was given up. The cancel is on its way then: whoever gives calls up may close the session next.
    async fn tell_given_up(&self, worker: &str, grace_end: Instant) {
        // By a task, which goes on where a link takes nothing: that holds nobody up for longer.
        let telling = tokio::spawn(cancel_at(&self.inner.transport, &self.inner.target, worker, &self.id));
        drop(tokio::time::timeout_at(grace_end, telling).await);
    }

    fn judge(&self, ended: Ended, worker: &str) -> Next {
        match ended {
            Ended::Result { payload, worker: by, timing_ms } => {
                let worker = by.unwrap_or_else(|| worker.to_owned());
                Next::Done(Ok(Answer { payload, worker, attempts: self.attempts + 1, timing_ms }))
            }
            Ended::Error(error) if error.retryable => Next::Again(error),
            Ended::Error(error) => Next::Done(Err(error)),
            Ended::Empty => {
                let message = format!(
                    "{} worker {worker} is gone; whether request {} was carried out is unknown",
                    self.inner.target.service, self.id
                );
                Next::Done(Err(CallError { retryable: false, ..CallError::new(ErrorCode::Unavailable, message) }))
            }
            Ended::Left => Next::AtOnce(CallError::new(
                ErrorCode::Unavailable,
                format!("{} worker {worker} does not answer", self.inner.target.service),
            )),
            Ended::Garbled(error) => Next::Done(Err(CallError::internal(format!("worker {worker} answered garbage: {error}")))),
            Ended::Cancelled => Next::Done(Err(given_up())),
            Ended::Overdue => Next::Done(Err(too_late())),
        }
    }
}
