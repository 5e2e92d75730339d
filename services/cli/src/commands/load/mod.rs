//! `repose load`: many placements asked of a running system, how they ended, and how long they took.
//!
//! Closed loop: so many clients, each of which asks as soon as it was answered. Open loop (`--rate`): requests come when they are due, however the
//! system does, and latency counts from then. `--find-capacity` looks for the highest open-loop rate that keeps an objective.

mod arrivals;
mod capacity;
mod report;
mod written;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use repose_evaluation::report::written::can_write;
use repose_proto::place::{Budget, Outcome as SearchOutcome, Variant};
use repose_proto::{GoalTerm, PlaceRequest, Relation, Scene, SceneSummary, Service};
use repose_runtime::{CallOptions, Caller};
use tokio::task::JoinSet;

use crate::client::{self, ConnectArgs};
use crate::failure::{Failure, Outcome};
use crate::output::Output;
use crate::values::{parse_count, parse_variant};
use arrivals::Arrivals;
use capacity::Objective;
use report::{Ended, Report};

/// Arguments of `load`.
#[derive(Debug, Clone, Args)]
pub struct LoadArgs {
    /// Where to ask.
    #[command(flatten)]
    pub connect: ConnectArgs,
    /// Clients that ask at the same time, each as soon as it was answered (closed loop).
    #[arg(long, default_value_t = 4, value_parser = parse_count)]
    pub clients: usize,
    /// Requests in total.
    #[arg(long, default_value_t = 100, value_parser = parse_count)]
    pub requests: usize,
    /// Requests a second, whether or not earlier ones were answered (open loop).
    #[arg(long)]
    pub rate: Option<f64>,
    /// When the requests of an open loop are due.
    #[arg(long, value_enum, default_value_t = Arrivals::Constant)]
    pub arrivals: Arrivals,
    /// Share of the requests that are interactive; the others are batch, and yield to them.
    #[arg(long, default_value_t = 1.0)]
    pub interactive: f64,
    /// Requests before those that count.
    #[arg(long, default_value_t = 0)]
    pub warm_up: usize,
    /// Look for the highest rate that keeps the objective, each with this many requests, and report that one.
    #[arg(long)]
    pub find_capacity: bool,
    /// The objective: a percentile of the latency and its bound; at least 99 % must be answered, too.
    #[arg(long, value_name = "OBJECTIVE", default_value = "p99<1s")]
    pub slo: Objective,
    /// Write a line for each request, as CSV.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Write a page with the report, and with latency and rates over time.
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Which method plans.
    #[arg(long, default_value = "best", value_parser = parse_variant)]
    pub variant: Variant,
    /// Iterations of each search.
    #[arg(long, default_value_t = 1)]
    pub iterations: u32,
    /// Candidates to accept in each iteration.
    #[arg(long, default_value_t = 16)]
    pub batch: u32,
    /// Seed of the first request, whose successors have the next ones, and of arrivals and priorities.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// The relations asked for, in turn.
const RELATIONS: [Relation; 4] = [Relation::LeftOf, Relation::RightOf, Relation::InFrontOf, Relation::Behind];
/// The longest run that a rate may ask for, seconds.
const LONGEST_RUN_S: f64 = 86_400.0;
/// What a loaded machine may take to tell a caller that its time is up.
const LATE_GRACE: Duration = Duration::from_millis(500);
/// Requests of an open loop that may be under way at once; further ones are dropped and counted, as the machine that asks would be at its end.
const MOST_UNDER_WAY: usize = 4096;

/// What every client of a run shares.
#[derive(Clone)]
struct Asking {
    args: Arc<LoadArgs>,
    planner: Caller,
    scene: Arc<SceneSummary>,
    /// Cameras go on, and services keep a scene for a while only: whoever has lost it gets it whole.
    whole: Arc<Scene>,
}

/// Runs the command.
pub async fn run(args: &LoadArgs, output: Output) -> Outcome {
    check(args)?;
    // A run later would be too late to say so.
    args.csv.iter().chain(&args.html).try_for_each(|path| can_write(path))?;
    let session = client::connect(&args.connect.system).await?;
    let deadline = Duration::from_millis(args.connect.deadline_ms);
    let scene = Arc::new(client::newest_scene(&session, &args.connect.camera, deadline, client::PATIENCE).await?);
    if scene.objects.len() < 2 {
        return Err(Failure::bad_input("camera", format!("the newest scene has {} objects, two are needed", scene.objects.len())));
    }
    let whole = Arc::new(client::whole_scene(&session, &scene.scene_id, deadline).await?);
    let planner = session.caller(Service::Planner).await?;
    let asking = Asking { args: Arc::new(args.clone()), planner, scene, whole };
    if args.warm_up > 0 {
        asking.ask(args.warm_up, None).await?;
    }
    let (report, ended) = match args.find_capacity {
        true => capacity::find(&asking).await?,
        false => asking.ask(args.requests, args.rate).await?,
    };
    client::close(session).await;
    let asked = std::env::args().collect::<Vec<_>>().join(" ");
    written::write(args.csv.as_deref(), args.html.as_deref(), &asked, &report, &ended)?;
    output.print(&report, || report.to_string())?;
    if report.per_worker.is_empty() { Err(Failure::NotAchieved) } else { Ok(()) }
}

fn check(args: &LoadArgs) -> Outcome {
    if args.rate.is_some_and(|r| !(r > 0.0 && args.requests as f64 / r <= LONGEST_RUN_S)) {
        return Err(Failure::bad_input("rate", format!("expected more than 0 requests per second, and all within {LONGEST_RUN_S:.0} s")));
    }
    if !(0.0..=1.0).contains(&args.interactive) {
        return Err(Failure::bad_input("interactive", format!("expected a share from 0 to 1, got {}", args.interactive)));
    }
    Ok(())
}

impl Asking {
    /// Asks for so many placements, in a closed loop or at a rate.
    async fn ask(&self, requests: usize, rate: Option<f64>) -> Result<(Report, Vec<Ended>), Failure> {
        let duplicates = self.planner.duplicates();
        let started = Instant::now();
        let (ended, dropped) = match rate {
            None => (self.closed_loop(requests, started).await?, 0),
            Some(rate) => self.open_loop(requests, rate, started).await?,
        };
        let elapsed = started.elapsed();
        let duplicates = self.planner.duplicates() - duplicates;
        Ok((Report::new(&ended, rate, elapsed, duplicates as usize, dropped)?, ended))
    }

    async fn closed_loop(&self, requests: usize, started: Instant) -> Result<Vec<Ended>, Failure> {
        let next = Arc::new(AtomicUsize::new(0));
        let mut clients = JoinSet::new();
        for _ in 0..self.args.clients.clamp(1, requests) {
            let (asking, next) = (self.clone(), next.clone());
            clients.spawn(async move {
                let mut ended = Vec::new();
                loop {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    if i >= requests {
                        return ended;
                    }
                    ended.push(asking.one(i, started, Instant::now()).await);
                }
            });
        }
        let mut ended = Vec::new();
        while let Some(of_client) = clients.join_next().await {
            ended.extend(of_client.map_err(Failure::other)?);
        }
        Ok(ended)
    }

    /// What ended, and how many could not even begin.
    async fn open_loop(&self, requests: usize, rate: f64, started: Instant) -> Result<(Vec<Ended>, usize), Failure> {
        let (mut under_way, mut ended, mut dropped) = (JoinSet::new(), Vec::new(), 0);
        for (i, due_s) in self.args.arrivals.due_s(rate, self.args.seed).take(requests).enumerate() {
            let due = started + Duration::from_secs_f64(due_s);
            tokio::time::sleep_until(due.into()).await;
            while let Some(one) = under_way.try_join_next() {
                ended.push(one.map_err(Failure::other)?);
            }
            if under_way.len() >= MOST_UNDER_WAY {
                dropped += 1;
                continue;
            }
            let asking = self.clone();
            under_way.spawn(async move { asking.one(i, started, due).await });
        }
        while let Some(one) = under_way.join_next().await {
            ended.push(one.map_err(Failure::other)?);
        }
        Ok((ended, dropped))
    }

    /// Asks once. Latency counts from when the request was due, so that a slow system cannot hide by slowing its clients down.
    async fn one(&self, i: usize, started: Instant, due: Instant) -> Ended {
        let deadline = Duration::from_millis(self.args.connect.deadline_ms);
        let priority = self.args.arrivals.priority(self.args.interactive, self.args.seed, i);
        let (asked, options) = (self.request(i), CallOptions { priority, ..CallOptions::within(deadline) });
        let sent = Instant::now();
        let ends = tokio::time::timeout(deadline + 2 * LATE_GRACE, self.planner.place(&asked, Some(&self.whole), options)).await;
        let (took, on_the_wire) = (due.elapsed(), sent.elapsed());
        tracing::debug!(request = i, ms = took.as_millis() as u64, "request ended");
        let mut end = Ended {
            priority,
            due: due.saturating_duration_since(started),
            took,
            late: on_the_wire > deadline + LATE_GRACE,
            ..Ended::lost()
        };
        match ends {
            Err(_) => {}
            Ok(Ok((result, answer))) => {
                end.outcome = if result.outcome == SearchOutcome::None { "none" } else { "result" }.to_owned();
                end.stages_ms = report::stages(took, on_the_wire, &answer.timing_ms);
                end.worker = Some(answer.worker);
            }
            Ok(Err(error)) => error.code.as_str().clone_into(&mut end.outcome),
        }
        end
    }

    fn request(&self, i: usize) -> PlaceRequest {
        let (args, scene) = (&self.args, &self.scene);
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
}
