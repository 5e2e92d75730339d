//! `repose bench planner`: how long a placement takes on this machine, in this process and through the services.
//!
//! Scenes are simulated ones of the validation split; everything is warm. The services are processes of their own behind a router, as
//! `repose up` starts them. What the network costs is measured request by request: the same request here and there.

use std::cell::Cell;
use std::net::TcpListener;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use repose_dataset::Split;
use repose_evaluation::scenes::problem::{Problem, ProblemSettings};
use repose_evaluation::statistics::quantile::Sorted;
use repose_planner::{Forecasts, PlacementModels, PreparedScene, plan};
use repose_proto::place::Variant;
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, PlaceRequest, PlaceResult, Scene, Service};
use repose_runtime::{CallOptions, Caller, RuntimeConfig, Session, SessionMode};
use serde_json::json;
use tokio::process::Child;

use crate::asynchronous::in_runtime;
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::processes::service_process;
use crate::values::parse_count;
use repose_local::LocalModels;

/// How long anything may take.
const PATIENCE: Duration = Duration::from_secs(300);

/// Arguments of `bench planner`.
#[derive(Debug, Args)]
pub struct BenchPlannerArgs {
    /// Number of scenes, used in turn.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=100))]
    pub scenes: u64,
    /// Placements with `best`.
    #[arg(long, default_value_t = 60, value_parser = parse_count)]
    pub runs: usize,
    /// Placements with `full`; 0 skips it.
    #[arg(long, default_value_t = 10)]
    pub full_runs: usize,
    /// Requests through the services, first one after another, then all at once; 0 skips the services.
    #[arg(long, default_value_t = 16)]
    pub requests: usize,
}

/// Runs the command.
pub fn run(args: &BenchPlannerArgs, output: Output) -> CommandResult {
    let wishes = wishes(args.scenes)?;
    let models = Counted { models: LocalModels::embedded()?, scored: AtomicU64::new(0), micros: AtomicU64::new(0) };
    let best = timed(&wishes, Variant::Best, args.runs, &models)?;
    let full = if args.full_runs > 0 { Some(timed(&wishes, Variant::Full, args.full_runs, &models)?) } else { None };
    let services = Cell::new(None);
    if args.requests > 0 {
        in_runtime(async {
            services.set(Some(through_services(&wishes, args.requests, &models.models).await?));
            Ok(())
        })?;
    }
    let services = services.into_inner();
    let document = document(&best, full.as_ref(), services, args.requests, wishes.len());
    output.print(&document, || {
        let mut lines = vec![format!("best: {}", best.text())];
        lines.extend(full.as_ref().map(|f| format!("full: {}", f.text())));
        lines.extend(services.map(|s| {
            let busy = |share: Option<f64>| share.map_or_else(String::new, |b| format!(" (cores {:.0} % busy)", b * 100.0));
            format!(
                "services: p50 {:.0} ms; {:.2}/s in sequence{}, {:.2}/s of {} at once{}, {:.2} times; messages {:.1} ms, {:.1} %; {:.1} ms more than here",
                s.sequence_p50_ms,
                s.sequence_per_s,
                busy(s.busy_in_sequence),
                s.concurrent_per_s,
                args.requests,
                busy(s.busy_at_once),
                s.concurrent_speedup,
                s.transport_p50_ms,
                s.transport_share * 100.0,
                s.beyond_p50_ms
            )
        }));
        lines.join("\n")
    })
}

/// What is printed as JSON.
fn document(best: &Times, full: Option<&Times>, services: Option<ThroughServices>, requests: usize, scenes: usize) -> serde_json::Value {
    json!({
        "p50_ms": best.p50_ms, "p99_ms": best.p99_ms,
        "concurrent_speedup": services.map(|s| s.concurrent_speedup),
        "transport_share": services.map(|s| s.transport_share),
        "best": best.json(), "full": full.map(Times::json),
        "services": services.map(|s| json!({
            "requests": requests, "sequence_p50_ms": s.sequence_p50_ms, "sequence_per_s": s.sequence_per_s, "concurrent_per_s": s.concurrent_per_s,
            "busy_in_sequence": s.busy_in_sequence, "busy_at_once": s.busy_at_once,
            "transport_p50_ms": s.transport_p50_ms, "beyond_this_process_p50_ms": s.beyond_p50_ms,
        })),
        "scenes": scenes, "threads": std::thread::available_parallelism().map_or(1, usize::from),
    })
}

/// A scene, prepared, and what is asked on it.
struct Wish {
    prepared: PreparedScene,
    request: PlaceRequest,
}

impl Wish {
    fn request(&self, variant: Variant, seed: usize) -> PlaceRequest {
        PlaceRequest { variant, seed: seed as u64, ..self.request.clone() }
    }
}

fn wishes(scenes: u64) -> Result<Vec<Wish>, Failure> {
    const SEEDS: u64 = 1000;
    let settings = ProblemSettings::default();
    let problems = (0..SEEDS).filter_map(|i| Problem::of_split(Split::Validation, i, &settings));
    let wish = |problem: Problem| {
        let prepared = PreparedScene::new(Arc::new(problem.observed));
        let request = PlaceRequest::new(prepared.scene_id.clone(), problem.query, vec![problem.goal]);
        Wish { prepared, request }
    };
    // A request that is refused (its object carries another) says nothing of speed.
    let wishes: Vec<Wish> = problems.map(wish).filter(|w| w.prepared.movable(w.request.query).is_ok()).take(scenes as usize).collect();
    if wishes.is_empty() { Err(Failure::other("no seed gave a scene")) } else { Ok(wishes) }
}

/// Times of placements in this process.
#[derive(Debug, Clone, Copy)]
struct Times {
    runs: usize,
    p50_ms: f64,
    p99_ms: f64,
    mean_ms: f64,
    /// Candidates that the discriminator was asked about, per placement.
    scored: f64,
    /// Share of the time spent in the networks.
    networks: f64,
    found: usize,
}

impl Times {
    fn json(&self) -> serde_json::Value {
        json!({
            "runs": self.runs, "found": self.found, "p50_ms": self.p50_ms, "p99_ms": self.p99_ms, "mean_ms": self.mean_ms,
            "scored_per_placement": self.scored, "share_in_networks": self.networks,
        })
    }

    fn text(&self) -> String {
        format!(
            "p50 {:.0} ms, p99 {:.0} ms, mean {:.0} ms ({} placements, {} found); {:.0} candidates to the discriminator each, {:.0} % of the time in the networks",
            self.p50_ms,
            self.p99_ms,
            self.mean_ms,
            self.runs,
            self.found,
            self.scored,
            self.networks * 100.0
        )
    }
}

fn timed(wishes: &[Wish], variant: Variant, runs: usize, models: &Counted) -> Result<Times, Failure> {
    let mut times_ms = Vec::with_capacity(runs);
    let (mut found, mut scored, mut in_networks_ms) = (0, 0, 0.0);
    let mut warm = None;
    for run in 0..runs {
        let k = scene_of(run, runs, wishes.len());
        if warm != Some(k) {
            // The first request on a scene prepares it.
            placed(&wishes[k], &wishes[k].request(variant, runs), models)?;
            warm = Some(k);
        }
        models.reset();
        let begin = Instant::now();
        let result = placed(&wishes[k], &wishes[k].request(variant, run), models)?;
        times_ms.push(begin.elapsed().as_secs_f64() * 1e3);
        found += usize::from(!result.placements.is_empty());
        scored += models.scored.load(Ordering::Relaxed);
        in_networks_ms += models.micros.load(Ordering::Relaxed) as f64 / 1e3;
    }
    let total_ms: f64 = times_ms.iter().sum();
    let times_ms = Sorted::new(times_ms);
    Ok(Times {
        runs,
        p50_ms: times_ms.at_or_nan(0.5),
        p99_ms: times_ms.at_or_nan(0.99),
        mean_ms: total_ms / runs as f64,
        scored: scored as f64 / runs as f64,
        networks: in_networks_ms / total_ms,
        found,
    })
}

/// Which of `scenes` the `i`-th of `runs` is on: all of one scene come one after the other, as few are held at once.
fn scene_of(i: usize, runs: usize, scenes: usize) -> usize {
    i * scenes / runs.max(1)
}

fn placed(wish: &Wish, request: &PlaceRequest, models: &dyn PlacementModels) -> Result<PlaceResult, Failure> {
    Ok(plan(&wish.prepared, request, models, &mut |_| ControlFlow::Continue(()))?)
}

/// The models, and how much they were asked.
struct Counted {
    models: LocalModels,
    scored: AtomicU64,
    micros: AtomicU64,
}

impl Counted {
    fn reset(&self) {
        self.scored.store(0, Ordering::Relaxed);
        self.micros.store(0, Ordering::Relaxed);
    }

    fn timed<T>(&self, ask: impl FnOnce() -> T) -> T {
        let begin = Instant::now();
        let answer = ask();
        self.micros.fetch_add(begin.elapsed().as_micros() as u64, Ordering::Relaxed);
        answer
    }
}

impl PlacementModels for Counted {
    fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError> {
        self.timed(|| self.models.prior(request, scene))
    }

    fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        if request.realism {
            self.scored.fetch_add(request.candidates.len() as u64, Ordering::Relaxed);
        }
        self.timed(|| self.models.score(request, scene))
    }

    fn forecasts(&self) -> Result<Arc<Forecasts>, CallError> {
        self.models.forecasts()
    }
}

/// What the services make of it.
#[derive(Debug, Clone, Copy)]
struct ThroughServices {
    sequence_p50_ms: f64,
    sequence_per_s: f64,
    concurrent_per_s: f64,
    concurrent_speedup: f64,
    /// Share of all cores' time that was not idle while requests came one after the other, whoever used it.
    busy_in_sequence: Option<f64>,
    /// The same while they came at once.
    busy_at_once: Option<f64>,
    /// Time that a placement in sequence spends neither in its search nor in the networks: encoding, the network, decoding, and being handed
    /// from thread to thread at either end; milliseconds (median), and as a share of all of it (of the sums).
    transport_p50_ms: f64,
    transport_share: f64,
    /// What a placement through the services takes longer than in this process, milliseconds (the median over pairs: negative where other
    /// work on the machine hides it): the messages, and that its work is spread over processes which find the caches cold.
    beyond_p50_ms: f64,
}

async fn through_services(wishes: &[Wish], requests: usize, models: &LocalModels) -> Result<ThroughServices, Failure> {
    let port = TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr()).map_err(Failure::other)?.port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let start = |what: &str| -> Result<Child, Failure> { service_process(&endpoint, "bench", None, what)?.spawn().map_err(Failure::other) };
    // They end with this function, however it ends: children are killed when dropped.
    let _processes = [start("router")?, start(Service::Inference.as_str())?, start(Service::Planner.as_str())?];
    let mut config = RuntimeConfig::load(None)?;
    config.session.mode = SessionMode::Client;
    config.session.connect = vec![endpoint.clone()];
    config.session.cell = "bench".to_owned();
    let session = Session::open(config).await?;
    for service in [Service::Inference, Service::Planner] {
        session.caller(service).await?.wait_for_workers(1, PATIENCE).await?;
    }
    let planner = session.caller(Service::Planner).await?;
    for wish in wishes {
        ask(&planner, &wish.request(Variant::Best, 0), &wish.prepared.scene).await?;
    }

    let (mut sequence, mut beyond_ms) = (Vec::new(), Vec::new());
    let wish = |i: usize| &wishes[scene_of(i, requests, wishes.len())];
    let cores = CoreTime::now();
    for i in 0..requests {
        sequence.push(ask(&planner, &wish(i).request(Variant::Best, i), &wish(i).prepared.scene).await?);
    }
    let busy_in_sequence = cores.and_then(CoreTime::busy_since);
    // One here and one there in turn, so that whatever else the machine does meets both alike.
    for i in 0..requests {
        let request = wish(i).request(Variant::Best, i);
        if i == 0 || !std::ptr::eq(wish(i), wish(i - 1)) {
            tokio::task::block_in_place(|| placed(wish(i), &request, models))?;
        }
        let begin = Instant::now();
        tokio::task::block_in_place(|| placed(wish(i), &request, models))?;
        let here_ms = begin.elapsed().as_secs_f64() * 1e3;
        beyond_ms.push(ask(&planner, &request, &wish(i).prepared.scene).await?.total_ms - here_ms);
    }
    let (begin, cores) = (Instant::now(), CoreTime::now());
    let together: Vec<_> = (0..requests)
        .map(|i| {
            let (planner, request, scene) = (planner.clone(), wish(i).request(Variant::Best, i), wish(i).prepared.scene.clone());
            tokio::spawn(async move { ask(&planner, &request, &scene).await })
        })
        .collect();
    for one in together {
        one.await.map_err(Failure::other)??;
    }
    let concurrent_per_s = requests as f64 / begin.elapsed().as_secs_f64();
    let busy_at_once = cores.and_then(CoreTime::busy_since);
    session.close().await?;

    let sum = |of: fn(&Asked) -> f64| sequence.iter().map(of).sum::<f64>();
    let sequence_per_s = requests as f64 / (sum(|a| a.total_ms) / 1e3);
    let transport_share = sum(|a| a.transport_ms) / sum(|a| a.total_ms);
    let median = |times: Vec<f64>| Sorted::new(times).at_or_nan(0.5);
    Ok(ThroughServices {
        sequence_p50_ms: median(sequence.iter().map(|a| a.total_ms).collect()),
        sequence_per_s,
        concurrent_per_s,
        concurrent_speedup: concurrent_per_s / sequence_per_s,
        busy_in_sequence,
        busy_at_once,
        transport_p50_ms: median(sequence.iter().map(|a| a.transport_ms).collect()),
        transport_share,
        beyond_p50_ms: median(beyond_ms),
    })
}

/// How long a placement through the services took.
#[derive(Debug, Clone, Copy)]
struct Asked {
    total_ms: f64,
    /// What is left of it without the search and the networks.
    transport_ms: f64,
}

/// Asks for a placement.
async fn ask(planner: &Caller, request: &PlaceRequest, scene: &Scene) -> Result<Asked, Failure> {
    let begin = Instant::now();
    let (_, answer) = planner.place(request, Some(scene), CallOptions::within(PATIENCE)).await?;
    let total_ms = begin.elapsed().as_secs_f64() * 1e3;
    // The search waits for `inference`, of which `networks` was spent in them.
    let stage = |name: &str| answer.timing_ms.get(name).copied().unwrap_or(0.0);
    Ok(Asked { total_ms, transport_ms: total_ms - stage("search") + stage("inference") - stage("networks") })
}

/// What all cores have done since the machine started, in the system's ticks.
#[derive(Debug, Clone, Copy)]
struct CoreTime {
    idle: u64,
    all: u64,
}

impl CoreTime {
    /// None where the system does not tell.
    fn now() -> Option<Self> {
        let stat = std::fs::read_to_string("/proc/stat").ok()?;
        let ticks: Vec<u64> = stat.lines().next()?.split_whitespace().skip(1).take(8).filter_map(|t| t.parse().ok()).collect();
        Some(Self { idle: ticks.get(3)? + ticks.get(4)?, all: ticks.iter().sum() })
    }

    fn busy_since(self) -> Option<f64> {
        let now = Self::now()?;
        let all = now.all.checked_sub(self.all).filter(|all| *all > 0)?;
        Some(1.0 - now.idle.saturating_sub(self.idle) as f64 / all as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_placement_is_timed_and_the_networks_share_is_told() {
        let wishes = wishes(1).unwrap_or_else(|e| panic!("{e:?}"));
        let models = LocalModels::embedded().unwrap_or_else(|e| panic!("{e:?}"));
        let models = Counted { models, scored: AtomicU64::new(0), micros: AtomicU64::new(0) };
        let times = timed(&wishes, Variant::Best, 2, &models).unwrap_or_else(|e| panic!("{e:?}"));
        assert!(times.p50_ms > 0.0 && times.p99_ms >= times.p50_ms && (0.0..=1.0).contains(&times.networks), "{times:?}");
        let geometric = timed(&wishes, Variant::Geometric, 1, &models).unwrap_or_else(|e| panic!("{e:?}"));
        assert_eq!((geometric.scored, geometric.networks), (0.0, 0.0));
        let services = ThroughServices {
            sequence_p50_ms: 100.0,
            sequence_per_s: 10.0,
            concurrent_per_s: 15.0,
            concurrent_speedup: 1.5,
            busy_in_sequence: None,
            busy_at_once: None,
            transport_p50_ms: 4.0,
            transport_share: 0.04,
            beyond_p50_ms: 10.0,
        };
        let document = document(&times, None, Some(services), 16, 1);
        for key in ["p50_ms", "p99_ms", "concurrent_speedup", "transport_share"] {
            assert!(document[key].is_f64(), "the contract's {key}: {document}");
        }
    }
}
