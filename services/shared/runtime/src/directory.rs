//! Which workers of a service there are and how loaded each is: liveliness tokens and published loads, kept by a background task.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rand::RngExt;
use rand_pcg::Pcg64;
use repose_proto::load::WorkerLoad;
use repose_proto::{Cell, Payload, Service, keys};
use tokio::sync::Notify;
use tokio::time::Instant;
use tokio_util::sync::{CancellationToken, DropGuard};

use crate::RuntimeError;
use crate::heeded::{BatchCall, Refused};
use crate::transport::{AliveWatch, Subscription, Transport};

/// Loads that may wait to be looked at.
const LOAD_CAPACITY: usize = 1024;
/// How long a worker that is gone is remembered, for calls that it still finishes.
const REMEMBERED: Duration = Duration::from_secs(30);
/// The service time assumed before a worker has told, milliseconds.
const ASSUMED_SERVICE_MS: f64 = 1.0;
/// The longest time for which a call is expected to take, milliseconds: beyond every deadline. A load is somebody else's to write, and may say anything.
const MOST_EXPECTED_MS: f64 = 1e9;

/// Decides by its load whether a worker may take a call: by its weights and kernel, for one.
pub type Accept = Arc<dyn Fn(&WorkerLoad) -> bool + Send + Sync>;

/// What is known of one worker.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkerView {
    /// Its name.
    pub name: String,
    /// Its newest load; none before the first.
    pub load: Option<WorkerLoad>,
    /// How long it has been silent.
    pub silent: Duration,
    /// Calls of this process that it is working on.
    pub outstanding: usize,
}

struct Entry {
    alive: bool,
    load: Option<WorkerLoad>,
    heard: Instant,
    outstanding: usize,
    /// A call found nobody behind its token; until its next load, no further call tries.
    deserted: bool,
    /// The last batch call that it refused.
    refused: Option<Refused>,
}

impl Entry {
    fn new(alive: bool, load: Option<WorkerLoad>) -> Self {
        Self { alive, load, heard: Instant::now(), outstanding: 0, deserted: false, refused: None }
    }

    fn view(&self, name: &str) -> WorkerView {
        WorkerView { name: name.to_owned(), load: self.load.clone(), silent: self.heard.elapsed(), outstanding: self.outstanding }
    }

    /// What another call would have to wait for, roughly, milliseconds. Published depths lag behind, so our own calls count too.
    fn cost_ms(&self) -> f64 {
        let (reported, service_ms) = self.load.as_ref().map_or((0, 0.0), |l| (l.queue_depth.saturating_add(l.in_flight), l.service_ms));
        let service_ms = if service_ms > 0.0 { service_ms } else { ASSUMED_SERVICE_MS };
        (reported.max(self.outstanding) as f64 + 1.0) * service_ms
    }

    fn takes_calls(&self) -> bool {
        self.load.as_ref().is_none_or(|l| !l.draining)
    }
}

struct State {
    workers: BTreeMap<String, Entry>,
    random: Pcg64,
}

impl State {
    /// The workers that are alive, that answered when they were last called, and that a call may go to.
    fn suitable<'a>(&'a self, wanted: &'a Wanted<'_>) -> impl Iterator<Item = (&'a str, &'a Entry)> {
        let present = self.workers.iter().filter(|(_, entry)| entry.alive && !entry.deserted);
        present.map(|(name, entry)| (name.as_str(), entry)).filter(|(name, entry)| wanted.allows(name, entry))
    }
}

struct Shared {
    state: Mutex<State>,
    changed: Notify,
    suspect_after: Duration,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The workers of one service.
pub struct Directory {
    shared: Arc<Shared>,
    _follow: DropGuard,
}

/// What a call asks of its worker.
#[derive(Default, Clone)]
pub struct Wanted<'a> {
    /// This one only.
    pub worker: Option<&'a str>,
    /// Those whose load this accepts.
    pub accept: Option<&'a Accept>,
    /// Preferably none of these, tried already.
    pub tried: &'a [String],
    /// None of these: the request was cancelled there.
    pub never: &'a [String],
    /// Only workers whose load is known, which says how they are to be called.
    pub needs_load: bool,
    /// Heeds what workers have refused calls like this one; none asks them all the same.
    pub(crate) heeds: Option<BatchCall>,
}

impl Wanted<'_> {
    fn allows(&self, name: &str, worker: &Entry) -> bool {
        self.worker.is_none_or(|wanted| wanted == name)
            && self.accept.is_none_or(|accept| worker.load.as_ref().is_some_and(|load| accept(load)))
            && (!self.needs_load || worker.load.is_some())
            && !holds(self.never, name)
    }

    /// For how long a worker's last refusal stands for this call; none where it may be asked.
    fn refused_by(&self, entry: &Entry) -> Option<Duration> {
        entry.refused.as_ref()?.stands_for(self.heeds.as_ref()?)
    }
}

fn holds(names: &[String], name: &str) -> bool {
    names.iter().any(|n| n == name)
}

impl Directory {
    /// Starts to follow. The workers alive now are in it when this returns; their loads follow within one period.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn follow(
        transport: &dyn Transport,
        cell: &Cell,
        service: Service,
        suspect_after: Duration,
        random: Pcg64,
    ) -> Result<Self, RuntimeError> {
        // Loads first, so that none of a worker that is seen alive is missed.
        let loads = transport.subscribe(&cell.loads(service), LOAD_CAPACITY).await?;
        let mut alive = transport.watch_alive(&cell.lives(service)).await?;
        let state = Mutex::new(State { workers: BTreeMap::new(), random });
        let shared = Arc::new(Shared { state, changed: Notify::new(), suspect_after });
        shared.take_alive(&mut alive);
        let stop = CancellationToken::new();
        tokio::spawn(stop.clone().run_until_cancelled_owned(keep(shared.clone(), loads, alive)));
        Ok(Self { shared, _follow: stop.drop_guard() })
    }

    /// Every worker alive, by name.
    pub fn workers(&self) -> Vec<WorkerView> {
        self.shared.state().workers.iter().filter(|(_, e)| e.alive).map(|(name, e)| e.view(name)).collect()
    }

    /// The less loaded of two suitable workers drawn at random, counted as having one more call. Those that were tried, have refused a call like
    /// this, are draining, have never told their load or have been silent come last, in that order. None when no suitable worker is alive.
    pub fn choose(&self, wanted: &Wanted<'_>) -> Option<Assigned> {
        let mut state = self.shared.state();
        let (first, second) = (state.random.random::<f64>(), state.random.random::<f64>());
        let rank = |(name, worker): &(&str, &Entry)| {
            let is_silent = worker.heard.elapsed() >= self.shared.suspect_after;
            let (is_refused, is_tried) = (wanted.refused_by(worker).is_some(), holds(wanted.tried, name));
            (is_silent, worker.load.is_none(), !worker.takes_calls(), is_refused, is_tried)
        };
        let ranked: Vec<_> = state.suitable(wanted).map(|worker| (rank(&worker), worker)).collect();
        let best = ranked.iter().map(|(rank, _)| *rank).min()?;
        let mut equals: Vec<(&str, &Entry)> = ranked.into_iter().filter(|(rank, _)| *rank == best).map(|(_, worker)| worker).collect();
        let mut drawn = equals.swap_remove(share_of(equals.len(), first));
        if !equals.is_empty() {
            let other = equals.swap_remove(share_of(equals.len(), second));
            if other.1.cost_ms() < drawn.1.cost_ms() {
                drawn = other;
            }
        }
        let name = drawn.0.to_owned();
        if let Some(entry) = state.workers.get_mut(&name) {
            entry.outstanding += 1;
        }
        Some(Assigned { shared: self.shared.clone(), name })
    }

    /// Whether a worker has ever told its load.
    pub fn has_told_load(&self, worker: &str) -> bool {
        self.shared.state().workers.get(worker).is_some_and(|e| e.load.is_some())
    }

    /// Whether a worker serves its `operate` key.
    pub fn operates(&self, worker: &str) -> bool {
        self.shared.state().workers.get(worker).and_then(|e| e.load.as_ref()).is_some_and(|load| load.operates)
    }

    /// Notes that nobody answered behind a worker's token: calls leave it until it tells its load again.
    pub fn mark_deserted(&self, worker: &str) {
        if let Some(entry) = self.shared.state().workers.get_mut(worker) {
            entry.deserted = true;
        }
    }

    /// Notes what a worker has refused.
    pub(crate) fn mark_refused(&self, worker: &str, refused: Refused) {
        if let Some(entry) = self.shared.state().workers.get_mut(worker) {
            entry.refused = Some(refused);
        }
    }

    /// For how long every worker that a call could go to has refused calls like it; none where one may be asked, or nobody is there.
    pub(crate) fn refused_by_all(&self, wanted: &Wanted<'_>) -> Option<Duration> {
        wanted.heeds.as_ref()?;
        // `None`, a worker that may be asked, is less than any time.
        self.shared.state().suitable(wanted).map(|(_, worker)| wanted.refused_by(worker)).min().flatten()
    }

    /// Whether a worker has been silent for so long that calls should leave it.
    pub fn is_suspect(&self, worker: &str) -> bool {
        self.shared.state().workers.get(worker).is_none_or(|e| e.heard.elapsed() >= self.shared.suspect_after)
    }

    /// Whether a worker tells its load within a while from now: it lives. At once that it does not where its token is gone.
    pub async fn hears_anew(&self, worker: &str, within: Duration) -> bool {
        let asked = Instant::now();
        let heard = async {
            loop {
                let mut changed = std::pin::pin!(self.changed());
                changed.as_mut().enable();
                match self.shared.state().workers.get(worker) {
                    Some(known) if known.heard > asked => return true,
                    Some(known) if known.alive => {}
                    // Its token is gone, and it with that.
                    _ => return false,
                }
                changed.await;
            }
        };
        tokio::time::timeout(within, heard).await.unwrap_or(false)
    }

    /// How long a call should take on a worker by what it reports of itself; none before it has served one.
    pub fn expected(&self, worker: &str) -> Option<Duration> {
        expected_of(self.shared.state().workers.get(worker)?.load.as_ref()?)
    }

    /// Whether anyone besides `besides` could take a call: alive, heard from, not draining, not tried.
    pub fn has_alternative(&self, wanted: &Wanted<'_>, besides: Option<&str>) -> bool {
        self.shared.state().suitable(wanted).any(|(name, worker)| {
            !holds(wanted.tried, name)
                && besides.is_none_or(|besides| besides != name)
                && worker.takes_calls()
                && worker.heard.elapsed() < self.shared.suspect_after
        })
    }

    /// A number between 0 and 1 from the directory's random source.
    pub fn random(&self) -> f64 {
        self.shared.state().random.random()
    }

    /// Waits until workers or loads have changed. Register before looking: `let changed = directory.changed()`.
    pub fn changed(&self) -> tokio::sync::futures::Notified<'_> {
        self.shared.changed.notified()
    }
}

fn expected_of(load: &WorkerLoad) -> Option<Duration> {
    let ms = (load.queue_depth as f64 + 1.0) * load.service_ms;
    (ms > 0.0).then(|| Duration::from_secs_f64(ms.min(MOST_EXPECTED_MS) / 1e3))
}

/// The index of one of `count` things by a number between 0 and 1.
fn share_of(count: usize, random: f64) -> usize {
    ((count as f64 * random) as usize).min(count - 1)
}

/// A call's claim on its worker, counted until it is dropped.
pub struct Assigned {
    shared: Arc<Shared>,
    name: String,
}

impl Assigned {
    /// The worker's name.
    pub fn name(&self) -> &str {
        &self.name
    }
}

impl Drop for Assigned {
    fn drop(&mut self) {
        if let Some(entry) = self.shared.state().workers.get_mut(&self.name) {
            entry.outstanding = entry.outstanding.saturating_sub(1);
        }
    }
}

impl Shared {
    fn take_alive(&self, alive: &mut AliveWatch) {
        let keys = alive.current();
        let mut state = self.state();
        for entry in state.workers.values_mut() {
            entry.alive = false;
        }
        for key in &keys {
            let name = keys::last_chunk(key).to_owned();
            state.workers.entry(name).or_insert_with(|| Entry::new(true, None)).alive = true;
        }
        state.workers.retain(|_, e| e.alive || e.outstanding > 0 || e.heard.elapsed() < REMEMBERED);
        drop(state);
        self.changed.notify_waiters();
    }

    fn take_load(&self, worker: &str, payload: &Payload) {
        let load: WorkerLoad = match payload.decode_json() {
            Ok(load) => load,
            Err(error) => {
                tracing::warn!(%error, worker, "a load could not be read");
                return;
            }
        };
        let mut state = self.state();
        if let Some(entry) = state.workers.get_mut(worker) {
            (entry.heard, entry.load, entry.deserted) = (Instant::now(), Some(load), false);
        } else {
            // Heard before it is seen alive: kept, so that it is known when it is. Bounded, should it never be.
            state.workers.retain(|_, e| e.alive || e.outstanding > 0 || e.heard.elapsed() < REMEMBERED);
            state.workers.insert(worker.to_owned(), Entry::new(false, Some(load)));
        }
        drop(state);
        self.changed.notify_waiters();
    }
}

async fn keep(shared: Arc<Shared>, mut loads: Subscription, mut alive: AliveWatch) {
    loop {
        tokio::select! {
            sample = loads.recv() => match sample {
                Some(sample) => {
                    if let Some(worker) = keys::worker_of(&sample.key) {
                        shared.take_load(worker, &sample.payload);
                    }
                }
                None => return,
            },
            open = alive.changed() => match open {
                true => shared.take_alive(&mut alive),
                false => return,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_that_tells_of_more_calls_than_can_be_is_not_taken_for_an_idle_one() {
        let told = |queue_depth, in_flight| WorkerLoad { queue_depth, in_flight, service_ms: 1e9, ..WorkerLoad::default() };
        let idle = Entry::new(true, Some(told(0, 0)));
        for load in [told(usize::MAX, usize::MAX), told(usize::MAX, 0), told(1 << 53, 1)] {
            assert!(Entry::new(true, Some(load.clone())).cost_ms() > idle.cost_ms());
            assert_eq!(expected_of(&load), Some(Duration::from_secs(1_000_000)));
        }
    }

    #[test]
    fn a_call_is_expected_to_take_its_turn_and_nothing_is_known_before_the_first() {
        let told = |queue_depth, service_ms| WorkerLoad { queue_depth, service_ms, ..WorkerLoad::default() };
        assert_eq!(expected_of(&told(4, 20.0)), Some(Duration::from_millis(100)));
        assert_eq!([expected_of(&told(4, 0.0)), expected_of(&told(4, -1.0))], [None, None]);
    }
}
