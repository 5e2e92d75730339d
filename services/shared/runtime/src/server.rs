//! One worker of a service on the network: takes calls, reports its load, and drains when asked to stop.

mod answerer;
mod calls;
mod load_metrics;

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use repose_proto::load::WorkerLoad;
use repose_proto::{Cell, Payload, Service, keys, limits};
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use self::load_metrics::LoadMetrics;
use crate::RuntimeError;
use crate::call::Handler;
use crate::call_key::CallKey;
use crate::config::WorkerConfig;
use crate::gauge::LoadGauge;
use crate::journal::{COPIES_WAIT, Journal};
use crate::namesakes::{self, NAMESAKE_CAPACITY};
use crate::registry::Registry;
use crate::robots::now_ns;
use crate::tally::Tally;
use crate::transport::{Guard, IncomingQueries, Subscription, Traffic, Transport};

/// Calls that may wait to be looked at; looking takes microseconds.
const INCOMING_CAPACITY: usize = 1024;
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
            namesakes::wait_until_free(transport.as_ref(), &cell, service, &worker, &config).await?;
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
        let (places, queue) = (shared.config.max_open_calls, shared.handler.load().queue_capacity);
        if queue >= places {
            tracing::warn!(%service, places, queue, "[worker] max_open_calls is no more than the queue takes: interactive calls displace no batch calls");
        }
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

    /// How long [`Server::drain`] takes at most.
    pub fn longest_drain(config: &WorkerConfig) -> Duration {
        Duration::from_millis(config.drain_notice_ms) + Duration::from_millis(config.drain_ms) + cut_off_time(config) + COPIES_WAIT
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
            drop(tokio::time::timeout(cut_off_time(config), shared.calls.wait()).await);
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

/// How long calls that are cut off may take to end: each does within its grace.
fn cut_off_time(config: &WorkerConfig) -> Duration {
    Duration::from_millis(config.cancel_grace_ms) + Duration::from_millis(100)
}

/// A name that no other process has.
fn made_up_name() -> String {
    format!("w-{}", &uuid::Uuid::new_v4().simple().to_string()[..12])
}

async fn take_calls(shared: Arc<Shared>, mut queries: IncomingQueries, call_key: CallKey) {
    while let Some(query) = queries.next().await {
        shared.calls.spawn(calls::answer(shared.clone(), query, call_key));
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
    let mut metrics = LoadMetrics::of(shared.service, &shared.worker);
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
        metrics.tell(&load);
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
