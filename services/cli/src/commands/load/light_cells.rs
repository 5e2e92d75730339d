//! The light cells of a run: all of them started at once, what they put and hear, and how long the pool takes to be found among them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use repose_proto::{Scene, Service};
use repose_runtime::{RuntimeConfig, Session};
use tokio::task::JoinSet;

use super::light::{Counts, LightCell, Rates, name};
use super::report::{LightReport, OfSome, Percentiles, percentiles};
use crate::client;
use crate::failure::Failure;

/// Clients that come when all cells are there, and look for the pool's workers.
const SEARCHES: usize = 9;
/// How long a search may take.
const FOUND_WITHIN: Duration = Duration::from_secs(30);

/// The cells.
pub struct LightCells {
    /// By name.
    pub cells: BTreeMap<String, LightCell>,
    counts: Arc<Counts>,
    up: Duration,
    discovery_ms: Percentiles,
    began: Instant,
}

impl LightCells {
    /// Starts so many, whose scenes are hardly others than the camera's, and searches for the pool when all are there. `config` is a client's.
    pub async fn start(count: usize, camera: Arc<Scene>, config: &RuntimeConfig, rates: Rates) -> Result<Self, Failure> {
        let (counts, begin) = (Arc::<Counts>::default(), Instant::now());
        let mut starting = JoinSet::new();
        for k in 1..=count {
            let (camera, config, counts) = (camera.clone(), config.clone(), counts.clone());
            starting.spawn(async move { LightCell::start(k, camera, &config, rates, counts).await.map(|cell| (name(k), cell)) });
        }
        let mut cells = BTreeMap::new();
        while let Some(started) = starting.join_next().await {
            cells.extend([started.map_err(Failure::other)??]);
        }
        let up = begin.elapsed();
        // From here on everything that is counted goes on evenly.
        for count in [&counts.states_put, &counts.states_heard, &counts.summaries_put] {
            count.store(0, Ordering::Relaxed);
        }
        let began = Instant::now();
        let discovery_ms = discovery(config).await?;
        Ok(Self { cells, counts, up, discovery_ms, began })
    }

    /// Ends them.
    pub async fn close(self) {
        let mut closing: JoinSet<()> = self.cells.into_values().map(LightCell::close).collect();
        while let Some(closed) = closing.join_next().await {
            if let Err(error) = closed {
                tracing::warn!(%error, "a light cell did not close");
            }
        }
    }

    /// What they did so far; `kinds` are requests by kind, one a cell at least.
    pub fn report(&self, kinds: &BTreeMap<String, OfSome>) -> LightReport {
        let seconds = self.began.elapsed().as_secs_f64();
        let rate = |of: &AtomicU64| (of.load(Ordering::Relaxed) as f64 / seconds * 10.0).round() / 10.0;
        let medians: Vec<f64> = kinds.values().filter_map(|kind| kind.answered_ms.get("p50").copied()).collect();
        let (least, most) = medians.iter().fold((f64::INFINITY, 0.0_f64), |(least, most), ms| (least.min(*ms), most.max(*ms)));
        LightReport {
            cells: self.cells.len(),
            up_ms: self.up.as_secs_f64() * 1e3,
            discovery_ms: self.discovery_ms.clone(),
            states_put_per_s: rate(&self.counts.states_put),
            states_heard_per_s: rate(&self.counts.states_heard),
            summaries_put_per_s: rate(&self.counts.summaries_put),
            scenes_sent: self.counts.scenes_sent.load(Ordering::Relaxed),
            slowest_over_fastest: (medians.len() > 1 && least > 0.0).then(|| most / least),
        }
    }
}

/// How long clients take from their start until they have found all of a pool's planners and inference workers.
async fn discovery(config: &RuntimeConfig) -> Result<Percentiles, Failure> {
    let pool = [Service::Planner, Service::Inference];
    let session = Session::open(config.clone()).await?;
    let mut workers = Vec::new();
    for service in pool {
        let caller = session.caller(service).await?;
        caller.wait_for_workers(1, FOUND_WITHIN).await?;
        workers.push(caller.workers().len());
    }
    client::close(session).await;
    let mut times_ms = Vec::new();
    for _ in 0..SEARCHES {
        let begin = Instant::now();
        let session = Session::open(config.clone()).await?;
        for (service, count) in pool.into_iter().zip(&workers) {
            session.caller(service).await?.wait_for_workers(*count, FOUND_WITHIN).await?;
        }
        times_ms.push(begin.elapsed().as_secs_f64() * 1e3);
        client::close(session).await;
    }
    percentiles(times_ms.into_iter())
}

impl std::fmt::Display for LightReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let found = self.discovery_ms.get("p50").copied().unwrap_or_default();
        write!(
            f,
            "{} light cells, up in {:.1} s; a client finds the pool in {found:.0} ms; states {:.0}/s put and {:.0}/s heard, summaries {:.0}/s; \
             {} scenes sent",
            self.cells,
            self.up_ms / 1e3,
            self.states_put_per_s,
            self.states_heard_per_s,
            self.summaries_put_per_s,
            self.scenes_sent
        )?;
        self.slowest_over_fastest.iter().try_for_each(|ratio| write!(f, "; the slowest cell's median is {ratio:.2} times the fastest's"))
    }
}
