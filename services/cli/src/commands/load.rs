//! `repose load`: many placements asked of a running system, and how long they took.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use hdrhistogram::Histogram;
use repose_proto::place::{Budget, Outcome as SearchOutcome, Variant};
use repose_proto::{GoalTerm, PlaceRequest, Relation, Scene, SceneSummary, Service};
use repose_runtime::{CallOptions, Caller};
use serde::Serialize;

use crate::client::{self, ConnectArgs};
use crate::failure::{Failure, Outcome};
use crate::output::Output;
use crate::values::{parse_count, parse_variant};

/// Arguments of `load`.
#[derive(Debug, Clone, Args)]
pub struct LoadArgs {
    /// Where to ask.
    #[command(flatten)]
    pub connect: ConnectArgs,
    /// Clients that ask at the same time.
    #[arg(long, default_value_t = 4, value_parser = parse_count)]
    pub clients: usize,
    /// Requests in total.
    #[arg(long, default_value_t = 100, value_parser = parse_count)]
    pub requests: usize,
    /// Requests per second to offer. Default: each client asks again as soon as it has its answer.
    #[arg(long)]
    pub rate: Option<f64>,
    /// Which method plans.
    #[arg(long, default_value = "best", value_parser = parse_variant)]
    pub variant: Variant,
    /// Iterations of each search.
    #[arg(long, default_value_t = 1)]
    pub iterations: u32,
    /// Candidates to accept in each iteration.
    #[arg(long, default_value_t = 16)]
    pub batch: u32,
    /// Seed of the first request; each next one has the next.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// The relations asked for, in turn.
const RELATIONS: [Relation; 4] = [Relation::LeftOf, Relation::RightOf, Relation::InFrontOf, Relation::Behind];

#[derive(Default, Serialize)]
struct Report {
    requests: usize,
    /// `result`, `none`, error codes; `lost`: requests that never ended; `duplicate`: terminal replies beyond a call's one.
    outcomes: BTreeMap<String, usize>,
    offered_per_s: f64,
    achieved_per_s: f64,
    latency_ms: BTreeMap<&'static str, f64>,
    per_worker: BTreeMap<String, usize>,
    /// Requests that ended after their deadline.
    late: usize,
}

struct Ended {
    outcome: String,
    worker: Option<String>,
    took: Duration,
}

/// Runs the command.
pub async fn run(args: &LoadArgs, output: Output) -> Outcome {
    if args.rate.is_some_and(|r| !(r > 0.0 && args.requests as f64 / r <= LONGEST_RUN_S)) {
        return Err(Failure::bad_input("rate", format!("expected more than 0 requests per second, and all within {LONGEST_RUN_S:.0} s")));
    }
    let session = client::connect(&args.connect.system).await?;
    let deadline = Duration::from_millis(args.connect.deadline_ms);
    let scene = Arc::new(client::newest_scene(&session, &args.connect.camera, deadline, client::PATIENCE).await?);
    if scene.objects.len() < 2 {
        return Err(Failure::bad_input("camera", format!("the newest scene has {} objects, two are needed", scene.objects.len())));
    }
    // Cameras go on, and services keep a scene for a while only: whoever has lost it gets it whole.
    let whole = Arc::new(client::whole_scene(&session, &scene.scene_id, deadline).await?);
    let planner = session.caller(Service::Planner).await?;
    let args = Arc::new(args.clone());
    let next = Arc::new(AtomicUsize::new(0));
    let started = Instant::now();
    let clients: Vec<_> = (0..args.clients)
        .map(|_| tokio::spawn(client(args.clone(), planner.clone(), (scene.clone(), whole.clone()), next.clone(), started)))
        .collect();
    let mut ended = Vec::new();
    for client in clients {
        ended.extend(client.await.map_err(Failure::other)?);
    }
    let report = report(&args, &ended, planner.duplicates(), started.elapsed())?;
    client::close(session).await;
    output.print(&report, || {
        let latency = report.latency_ms.iter().map(|(k, v)| format!("{k} {v:.0}")).collect::<Vec<_>>().join(", ");
        format!(
            "{} requests: {}\noffered {:.1}/s, achieved {:.1}/s; latency in ms: {latency}\nanswers by worker: {}",
            report.requests,
            counts(&report.outcomes),
            report.offered_per_s,
            report.achieved_per_s,
            counts(&report.per_worker)
        )
    })?;
    if report.per_worker.is_empty() { Err(Failure::NotAchieved) } else { Ok(()) }
}

fn counts(of: &BTreeMap<String, usize>) -> String {
    of.iter().map(|(name, count)| format!("{name} {count}")).collect::<Vec<_>>().join(", ")
}

/// One client: takes the next request until there are none; with a rate, at its time and not before.
async fn client(
    args: Arc<LoadArgs>,
    planner: Caller,
    (scene, whole): (Arc<SceneSummary>, Arc<Scene>),
    next: Arc<AtomicUsize>,
    started: Instant,
) -> Vec<Ended> {
    let mut ended = Vec::new();
    loop {
        let i = next.fetch_add(1, Ordering::Relaxed);
        if i >= args.requests {
            return ended;
        }
        // Latency counts from when a request was due, so that a slow system cannot hide by slowing its clients down.
        let due = args.rate.map_or_else(Instant::now, |rate| started + Duration::from_secs_f64(i as f64 / rate));
        tokio::time::sleep_until(due.into()).await;
        let deadline = Duration::from_millis(args.connect.deadline_ms);
        let (asked, options) = (request(&args, &scene, i), CallOptions::within(deadline));
        // A placement is one call, or two where the scene has to go along; then every one has ended, or is lost.
        let ends = tokio::time::timeout(2 * deadline + LATE_GRACE, client::place(&planner, &asked, Some(&whole), options)).await;
        let took = due.elapsed();
        let Ok(answered) = ends else {
            ended.push(Ended { outcome: LOST.to_owned(), worker: None, took });
            continue;
        };
        tracing::debug!(request = i, ms = took.as_millis() as u64, "request ended");
        ended.push(match answered {
            Ok((result, answer)) => {
                let outcome = if result.outcome == SearchOutcome::None { "none" } else { "result" };
                Ended { outcome: outcome.to_owned(), worker: Some(answer.worker), took }
            }
            Err(error) => Ended { outcome: error.code.as_str().to_owned(), worker: None, took },
        });
    }
}

fn request(args: &LoadArgs, scene: &SceneSummary, i: usize) -> PlaceRequest {
    let n = scene.objects.len();
    let (query, anchor) = (scene.objects[i % n].id, scene.objects[(i + 1) % n].id);
    let goal = vec![GoalTerm { relation: RELATIONS[i / n % RELATIONS.len()], anchor, holds: true }];
    PlaceRequest {
        seed: args.seed + i as u64,
        variant: args.variant,
        budget: Budget { iterations: Some(args.iterations), batch: Some(args.batch), ..Budget::default() },
        ..PlaceRequest::new(scene.scene_id.clone(), query, goal)
    }
}

fn report(args: &LoadArgs, ended: &[Ended], duplicates: u64, elapsed: Duration) -> Result<Report, Failure> {
    let mut histogram = Histogram::<u64>::new_with_bounds(1, LONGEST_US, 3).map_err(Failure::other)?;
    let mut report = Report { requests: args.requests, ..Report::default() };
    report.outcomes.insert(LOST.to_owned(), 0);
    report.outcomes.insert("duplicate".to_owned(), duplicates as usize);
    for end in ended {
        *report.outcomes.entry(end.outcome.clone()).or_default() += 1;
        if let Some(worker) = &end.worker {
            *report.per_worker.entry(worker.clone()).or_default() += 1;
        }
        report.late += usize::from(end.took > Duration::from_millis(args.connect.deadline_ms) + LATE_GRACE);
        histogram.saturating_record(end.took.as_micros() as u64);
    }
    let seconds = elapsed.as_secs_f64();
    report.offered_per_s = args.rate.unwrap_or(ended.len() as f64 / seconds);
    report.achieved_per_s = ended.len() as f64 / seconds;
    let at = |quantile: f64| histogram.value_at_quantile(quantile) as f64 / 1e3;
    report.latency_ms =
        BTreeMap::from([("p50", at(0.5)), ("p90", at(0.9)), ("p95", at(0.95)), ("p99", at(0.99)), ("max", histogram.max() as f64 / 1e3)]);
    Ok(report)
}

/// The outcome of a request that never ended.
const LOST: &str = "lost";

/// The longest run that a rate may ask for, seconds.
const LONGEST_RUN_S: f64 = 86_400.0;

/// What a loaded machine may take to tell a caller that its time is up.
const LATE_GRACE: Duration = Duration::from_millis(500);

/// The longest latency that is told apart from longer ones, microseconds: the longest deadline, and some.
const LONGEST_US: u64 = 700_000_000;
