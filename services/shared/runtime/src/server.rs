//! One worker of a service on the network: takes calls, answers each exactly once, reports its load, and drains when asked to stop.
//!
//! A call runs in a task of its own; its terminal reply is the first of: what the handler returns, the deadline, the end of the grace
//! after a cancel, the end of the drain. The way back is dropped right after it, which is what ends the caller's stream.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use repose_proto::load::WorkerLoad;
use repose_proto::{
    CallAttachment, CallError, Cell, ErrorCode, JournalKind, Payload, ReplyAttachment, ReplyKind, Service, keys, limits, message,
};
use tokio::sync::{Notify, watch};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tracing::Instrument;

use crate::RuntimeError;
use crate::call::{Call, Handler};
use crate::call_key::CallKey;
use crate::config::WorkerConfig;
use crate::gauge::LoadGauge;
use crate::journal::{COPIES_WAIT, Journal};
use crate::mailbox::{MailboxReceiver, mailbox};
use crate::namesakes;
use crate::registry::{Admission, CallResult, Registry};
use crate::robots::now_ns;
use crate::shares::ForCell;
use crate::stages::Stages;
use crate::tally::Tally;
use crate::transport::{Guard, IncomingQueries, IncomingQuery, Replier, Subscription, Traffic, Transport};

/// Progress replies of one call that may wait to be sent.
const PROGRESS_CAPACITY: usize = 64;
/// Calls that may wait to be looked at; looking takes microseconds.
const INCOMING_CAPACITY: usize = 1024;
/// Loads under this worker's name that may wait to be looked at.
const NAMESAKE_CAPACITY: usize = 8;
/// Cancels that may wait to be looked at.
const CANCEL_CAPACITY: usize = 4096;

/// A worker that serves until it is drained. Dropping it without draining takes no further calls; open ones are still answered.
pub struct Server {
    shared: Arc<Shared>,
    alive: Option<Guard>,
    name_taken: CancellationToken,
    stop: CancellationToken,
    _stop_on_drop: tokio_util::sync::DropGuard,
}

struct Shared {
    transport: Arc<dyn Transport>,
    cell: Cell,
    service: Service,
    worker: String,
    loads_told: Arc<AtomicU64>,
    handler: Arc<dyn Handler>,
    config: WorkerConfig,
    registry: Mutex<Registry>,
    gauge: LoadGauge,
    journal: Journal,
    tally: Tally,
    draining: AtomicBool,
    refusing: AtomicBool,
    load_changed: Arc<Notify>,
    calls: TaskTracker,
}

impl Server {
    /// Declares the worker: its call key, its cancels, its load, and last its liveliness token, so that whoever sees it can call it.
    ///
    /// # Errors
    /// When the network refuses, or the configured name is no chunk of a key.
    pub async fn start(
        transport: Arc<dyn Transport>,
        cell: Cell,
        service: Service,
        handler: Arc<dyn Handler>,
        config: WorkerConfig,
    ) -> Result<Self, RuntimeError> {
        let worker = config.name.clone().unwrap_or_else(made_up_name);
        keys::validate_chunk("name", &worker).map_err(|e| RuntimeError::transport("naming the worker", e))?;
        if config.name.is_some() {
            namesakes::wait_until_free(transport.as_ref(), &cell, service, &worker, Duration::from_millis(config.name_wait_ms)).await?;
        }
        let queries = transport.serve(&cell.call(service, &worker), INCOMING_CAPACITY).await?;
        let operations = match service.has_operations() {
            true => Some(transport.serve(&cell.operate(service, &worker), INCOMING_CAPACITY).await?),
            false => None,
        };
        let for_others = match service.is_poolable() {
            true => Some(transport.serve(&cell.calls_for_others(service, &worker), INCOMING_CAPACITY).await?),
            false => None,
        };
        let cancels = transport.subscribe(&cell.cancels(service, &worker), CANCEL_CAPACITY).await?;
        let (stop, load_changed) = (CancellationToken::new(), Arc::new(Notify::new()));
        let journal = Journal::follow(transport.clone(), &cell, (service, &worker), load_changed.clone(), stop.clone()).await?;
        let shared = Arc::new(Shared {
            registry: Mutex::new(Registry::new(config.max_open_calls, config.outcomes_kept)),
            gauge: LoadGauge::default(),
            tally: Tally::default(),
            draining: AtomicBool::new(false),
            refusing: AtomicBool::new(false),
            load_changed,
            journal,
            calls: TaskTracker::new(),
            transport,
            cell,
            service,
            loads_told: Arc::default(),
            worker,
            handler,
            config,
        });
        let name_taken = CancellationToken::new();
        if shared.config.name.is_some() {
            let loads = shared.transport.subscribe(&shared.cell.load(service, &shared.worker), NAMESAKE_CAPACITY).await?;
            let found = namesakes::find(loads, shared.loads_told.clone(), name_taken.clone());
            tokio::spawn(stop.clone().run_until_cancelled_owned(found));
        }
        let call_keys = [(Some(queries), CallKey::Call), (operations, CallKey::Operate), (for_others, CallKey::ForOthers)];
        for (queries, call_key) in call_keys.into_iter().filter_map(|(queries, call_key)| Some((queries?, call_key))) {
            tokio::spawn(stop.clone().run_until_cancelled_owned(take_calls(shared.clone(), queries, call_key)));
        }
        tokio::spawn(stop.clone().run_until_cancelled_owned(take_cancels(shared.clone(), cancels)));
        tokio::spawn(stop.clone().run_until_cancelled_owned(report_load(shared.clone())));
        let alive = shared.transport.declare_alive(&shared.cell.live(service, &shared.worker)).await?;
        tracing::info!(%service, worker = shared.worker, "serving");
        Ok(Self { shared, alive: Some(alive), name_taken, _stop_on_drop: stop.clone().drop_guard(), stop })
    }

    /// Waits until another process turns out to serve under the same name, and this one is the younger: it must stop.
    pub async fn name_taken(&self) -> RuntimeError {
        self.name_taken.cancelled().await;
        namesakes::taken(self.shared.service, &self.shared.worker)
    }

    /// The worker's name in the key space.
    pub fn worker(&self) -> &str {
        &self.shared.worker
    }

    /// Stops serving: vanishes from the callers' sight, waits until they have noticed, refuses what still comes, lets open calls finish
    /// within a bound, cancels what is left.
    pub async fn drain(mut self) {
        let (shared, config) = (self.shared.clone(), &self.shared.config);
        shared.draining.store(true, Ordering::Release);
        shared.load_changed.notify_one();
        self.alive = None;
        tokio::time::sleep(Duration::from_millis(config.drain_notice_ms)).await;
        shared.refusing.store(true, Ordering::Release);
        shared.calls.close();
        let drained = tokio::time::timeout(Duration::from_millis(config.drain_ms), shared.calls.wait()).await;
        if drained.is_err() {
            tracing::warn!(service = %shared.service, worker = shared.worker, "calls are cut off by the end of the drain");
            shared.registry().cancel_all();
            // Each ends within its grace.
            let grace = Duration::from_millis(config.cancel_grace_ms + 100);
            drop(tokio::time::timeout(grace, shared.calls.wait()).await);
        }
        // The copies of the last answers, too.
        drop(tokio::time::timeout(COPIES_WAIT, shared.journal.flush()).await);
        self.stop.cancel();
        tracing::info!(service = %shared.service, worker = shared.worker, "drained");
    }
}

impl Shared {
    fn registry(&self) -> MutexGuard<'_, Registry> {
        self.registry.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A name that no other process has.
fn made_up_name() -> String {
    format!("w-{}", &uuid::Uuid::new_v4().simple().to_string()[..12])
}

async fn take_calls(shared: Arc<Shared>, mut queries: IncomingQueries, call_key: CallKey) {
    while let Some(query) = queries.next().await {
        shared.calls.spawn(answer(shared.clone(), query, call_key));
    }
}

async fn take_cancels(shared: Arc<Shared>, mut cancels: Subscription) {
    while let Some(sample) = cancels.recv().await {
        shared.registry().cancel(keys::last_chunk(&sample.key));
    }
}

async fn report_load(shared: Arc<Shared>) {
    let key = shared.cell.load(shared.service, &shared.worker);
    let period = Duration::from_millis(shared.config.load_period_ms);
    for seq in 1.. {
        shared.loads_told.store(seq, Ordering::Release);
        let mut load: WorkerLoad = shared.handler.load();
        load.v = limits::VERSION;
        load.seq = seq;
        load.draining = shared.draining.load(Ordering::Acquire);
        load.operates = shared.service.has_operations();
        load.journals = shared.journal.is_on();
        (load.version, load.stamp_ns) = (Some(env!("CARGO_PKG_VERSION").to_owned()), Some(now_ns()));
        (load.ended, load.failed) = shared.tally.so_far();
        if load.in_flight == 0 && load.queue_depth == 0 {
            load.in_flight = shared.registry().open_calls();
        }
        if load.queue_capacity == 0 {
            load.queue_capacity = shared.config.max_open_calls;
        }
        if load.service_ms == 0.0 {
            load.service_ms = shared.gauge.service_ms();
        }
        gauges(&shared, &load);
        match Payload::json(&load) {
            Ok(payload) => {
                if let Err(error) = shared.transport.put(&key, payload, Traffic::Load).await {
                    tracing::warn!(%error, "the load could not be published");
                }
            }
            Err(error) => tracing::error!(%error, "the load could not be encoded"),
        }
        // Early when there is news; the next one comes a whole period later.
        drop(tokio::time::timeout(period, shared.load_changed.notified()).await);
    }
}

/// The load as metrics.
fn gauges(shared: &Shared, load: &WorkerLoad) {
    let (service, worker) = (shared.service.as_str(), shared.worker.as_str());
    let labels = [("service", service.to_owned()), ("worker", worker.to_owned())];
    metrics::gauge!("repose_queue_waiting", &labels).set(load.queue_depth as f64);
    metrics::gauge!("repose_calls_running", &labels).set(load.in_flight as f64);
    metrics::gauge!("repose_draining", &labels).set(f64::from(u8::from(load.draining)));
    let (weights, kernel) = (load.weights_hash.clone(), load.kernel.clone());
    let version = env!("CARGO_PKG_VERSION");
    metrics::gauge!(
        "repose_worker_info", "service" => service, "worker" => worker.to_owned(), "weights" => weights, "kernel" => kernel, "version" => version
    )
    .set(1.0);
}

/// The way back of one call, with what every reply carries.
struct Answerer {
    replier: Box<dyn Replier>,
    attachment: ReplyAttachment,
    /// Takes copies, where somebody records and the call was copied too.
    journal: Option<Journal>,
}

impl Answerer {
    async fn send(&self, payload: Payload, attachment: &ReplyAttachment) {
        let encoded = Bytes::from(attachment.encode());
        if let Some(journal) = &self.journal {
            journal.copy(JournalKind::Reply, &encoded, &payload);
        }
        // The caller sees a stream that ends, and calls again or not.
        if let Err(error) = self.replier.reply(payload, encoded).await {
            tracing::warn!(%error, id = attachment.id, "a reply could not be sent");
        }
    }

    async fn progress(&mut self, payload: Payload) {
        let n = self.attachment.n.unwrap_or(0) + 1;
        self.attachment.n = Some(n);
        let progress = ReplyAttachment {
            kind: ReplyKind::Progress,
            n: Some(n),
            worker: None,
            attempt: None,
            timing_ms: BTreeMap::new(),
            ..self.attachment.clone()
        };
        self.send(payload, &progress).await;
    }

    /// The one terminal reply. Consumes the way back, which ends the stream.
    async fn finish(self, outcome: CallResult, timing_ms: BTreeMap<String, f64>) {
        let outcome = outcome.and_then(|payload| {
            let size = payload.bytes.len();
            payload.within_limit().map_err(|_| CallError::internal(format!("the result has {size} bytes, more than a message may have")))
        });
        let (kind, payload) = match outcome {
            Ok(payload) => (ReplyKind::Result, payload),
            Err(error) => (ReplyKind::Error, error_payload(&error)),
        };
        let attachment = ReplyAttachment { kind, n: None, timing_ms, ..self.attachment.clone() };
        self.send(payload, &attachment).await;
    }
}

fn error_payload(error: &CallError) -> Payload {
    Payload::json(error).unwrap_or_else(|cause| {
        tracing::error!(%cause, "an error reply could not be encoded");
        Payload { encoding: String::new(), bytes: Bytes::new() }
    })
}

/// The id of an attachment that could not be read whole, so that the reply can carry it.
fn id_of(attachment: &[u8]) -> String {
    let value: Option<serde_json::Value> = serde_json::from_slice(attachment).ok();
    value.and_then(|v| Some(v.get("id")?.as_str()?.to_owned())).unwrap_or_default()
}

async fn answer(shared: Arc<Shared>, query: IncomingQuery, call_key: CallKey) {
    let IncomingQuery { key, payload, attachment, replier } = query;
    let received = Instant::now();
    let mut reply = ReplyAttachment {
        v: limits::VERSION,
        id: String::new(),
        kind: ReplyKind::Error,
        n: None,
        worker: Some(shared.worker.clone()),
        attempt: None,
        timing_ms: BTreeMap::new(),
    };
    let decoded = match attachment.is_empty() {
        true => Err(CallError::invalid("attachment", "a call needs an attachment")),
        false => CallAttachment::decode(&attachment).and_then(|a| message::check_size(payload.bytes.len()).map(|()| a)),
    };
    let call = match decoded {
        Ok(call) => call,
        Err(error) => {
            reply.id = id_of(&attachment);
            return Answerer { replier, attachment: reply, journal: None }.finish(Err(error), BTreeMap::new()).await;
        }
    };
    reply.id.clone_from(&call.id);
    reply.attempt = Some(call.attempt);
    let journal = Some(&shared.journal).filter(|journal| journal.is_on() && shared.service.journals(&call.method)).cloned();
    if let Some(journal) = &journal {
        journal.copy(JournalKind::Call, &attachment, &payload);
    }
    let answerer = Answerer { replier, attachment: reply, journal };
    let deadline = received + Duration::from_millis(call.remaining_ms);
    let entered = shared.may_enter(call_key, &call.method).and_then(|()| call_key.cell(&key, &shared.cell));
    let cell = match entered {
        Ok(cell) => cell,
        Err(error) => return answerer.finish(Err(error), BTreeMap::new()).await,
    };
    let admission = shared.registry().admit(&call, &cell, &payload);
    let error = match admission {
        Admission::Compute { cancelled } => {
            let admitted = Admitted { attachment: call, cell, payload, deadline, cancelled };
            return compute(shared, admitted, answerer).await;
        }
        Admission::Join { outcome } => return join(outcome, deadline, answerer).await,
        Admission::Cancelled => CallError::new(ErrorCode::Cancelled, "the caller cancelled before the call came"),
        Admission::Conflict => CallError::precondition("this id belongs to a different request").at("id"),
        Admission::Full => {
            let message = format!("{} calls are open already", shared.config.max_open_calls);
            CallError::new(ErrorCode::ResourceExhausted, message).retry_after(shared.retry_after_ms())
        }
        Admission::CellFull { open } => {
            let name = cell.as_deref().unwrap_or_default();
            let message = format!("{open} calls of cell {name} are open already, as many as places are left for others");
            CallError::new(ErrorCode::ResourceExhausted, message).at("cell").retry_after(shared.retry_after_ms())
        }
    };
    let span = span_of(&shared, &call, &cell);
    let refused = Err(error);
    span.in_scope(|| shared.tally.count(shared.service, &call.method, &refused, received.elapsed()));
    answerer.finish(refused, BTreeMap::new()).await;
}

impl Shared {
    /// Whether a call of a method may arrive on a key now.
    fn may_enter(&self, call_key: CallKey, method: &str) -> Result<(), CallError> {
        if self.refusing.load(Ordering::Acquire) {
            return Err(CallError::new(ErrorCode::Unavailable, "this worker is stopping"));
        }
        call_key.takes(method, self.service, self.config.operate_only)
    }

    fn retry_after_ms(&self) -> u64 {
        let load = self.handler.load();
        let service_ms = if load.service_ms > 0.0 { load.service_ms } else { self.gauge.service_ms() };
        (service_ms * self.config.max_open_calls as f64 / 2.0).clamp(1.0, 10_000.0) as u64
    }
}

/// A call that was let in.
struct Admitted {
    attachment: CallAttachment,
    cell: ForCell,
    payload: Payload,
    deadline: Instant,
    cancelled: CancellationToken,
}

async fn compute(shared: Arc<Shared>, admitted: Admitted, mut answerer: Answerer) {
    let Admitted { attachment, cell, payload, deadline, cancelled } = admitted;
    let (progress, mut progressed) = mailbox(PROGRESS_CAPACITY);
    let span = span_of(&shared, &attachment, &cell);
    let call = Call {
        id: attachment.id,
        method: attachment.method,
        payload,
        priority: attachment.priority,
        attempt: attachment.attempt,
        // A call made on behalf of this one belongs under this one's span.
        traceparent: crate::trace::traceparent(&span).or(attachment.traceparent),
        caller: attachment.caller,
        cell,
        deadline,
        cancelled: cancelled.clone(),
        progress,
        stages: Stages::default(),
    };
    let (id, stages) = (call.id.clone(), call.stages.clone());
    let at_most_once = shared.handler.at_most_once(&call.method);
    let started = Instant::now();
    shared.gauge.started(1);
    let handler = shared.handler.clone();
    let method = call.method.clone();
    let task = tokio::spawn(async move { handler.call(call).await }.instrument(span.clone()));
    let mut outcome = supervise(&shared, task, deadline, &cancelled, &mut progressed, &mut answerer).await;
    shared.gauge.finished(1, started.elapsed());
    while let Some(payload) = progressed.try_recv() {
        answerer.progress(payload).await;
    }
    {
        let mut registry = shared.registry();
        let was_cancelled = outcome.as_ref().is_err_and(|error| error.code == ErrorCode::Cancelled);
        if was_cancelled && !registry.is_cancelled_by_caller(&id) {
            // The end of a drain: another worker may do it, unless it may have been done here.
            let error = CallError::new(ErrorCode::Unavailable, "this worker stopped before the work was done");
            outcome = Err(CallError { retryable: !at_most_once, ..error });
        }
        registry.finish(&id, outcome.clone(), at_most_once);
    }
    let mut timing_ms = stages.take();
    timing_ms.insert("total".to_owned(), started.elapsed().as_secs_f64() * 1e3);
    span.in_scope(|| shared.tally.count(shared.service, &method, &outcome, started.elapsed()));
    answerer.finish(outcome, timing_ms).await;
}

/// The span of a call, under the caller's where it sent one.
fn span_of(shared: &Shared, call: &CallAttachment, cell: &ForCell) -> tracing::Span {
    let (service, worker) = (shared.service.as_str(), shared.worker.as_str());
    let (id, method, attempt) = (call.id.as_str(), call.method.as_str(), call.attempt);
    let cell = cell.as_deref().unwrap_or(shared.cell.name());
    let span = tracing::info_span!("call", id, method, caller = call.caller, attempt, service, worker, cell);
    crate::trace::continue_from(&span, call.traceparent.as_deref());
    span
}

/// Waits for the handler, for its deadline and for a cancel, and forwards progress meanwhile.
async fn supervise(
    shared: &Shared,
    mut task: tokio::task::JoinHandle<CallResult>,
    deadline: Instant,
    cancelled: &CancellationToken,
    progressed: &mut MailboxReceiver<Payload>,
    answerer: &mut Answerer,
) -> CallResult {
    let grace = Duration::from_millis(shared.config.cancel_grace_ms);
    let mut give_up: Option<Instant> = None;
    loop {
        let end = give_up.unwrap_or(deadline).min(deadline);
        tokio::select! {
            biased;
            done = &mut task => {
                return done.unwrap_or_else(|failure| {
                    tracing::error!(%failure, "a handler panicked");
                    Err(CallError::internal("the handler panicked"))
                });
            }
            Some(payload) = progressed.recv() => answerer.progress(payload).await,
            () = cancelled.cancelled(), if give_up.is_none() => give_up = Some(Instant::now() + grace),
            () = tokio::time::sleep_until(end) => {
                cancelled.cancel();
                let abort = task.abort_handle();
                if end == deadline {
                    // The caller is answered now; the handler may still clean up.
                    tokio::spawn(async move {
                        drop(tokio::time::timeout(grace, task).await);
                        abort.abort();
                    });
                    return Err(CallError::new(ErrorCode::DeadlineExceeded, "the deadline passed before the work was done"));
                }
                abort.abort();
                return Err(CallError::new(ErrorCode::Cancelled, "the caller cancelled"));
            }
        }
    }
}

/// Answers a repeated call with the outcome of the first.
async fn join(mut outcome: watch::Receiver<Option<CallResult>>, deadline: Instant, answerer: Answerer) {
    // Taken out of the channel's guard at once, which must not be held across an await.
    let waited = tokio::time::timeout_at(deadline, async { outcome.wait_for(Option::is_some).await.ok().and_then(|o| o.clone()) }).await;
    let outcome = match waited {
        Ok(outcome) => outcome.unwrap_or_else(|| Err(CallError::internal("the call ended without an outcome"))),
        Err(_) => Err(CallError::new(ErrorCode::DeadlineExceeded, "the deadline passed before the work was done")),
    };
    answerer.finish(outcome, BTreeMap::new()).await;
}
