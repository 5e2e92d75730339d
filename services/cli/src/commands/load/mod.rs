//! `repose load`: many placements asked of a running system, how they ended, and how long they took.
//!
//! Closed loop: so many clients, each of which asks as soon as it was answered. Open loop (`--rate`): requests come when they are due, however the
//! system does, and latency counts from then. `--find-capacity` looks for the highest open-loop rate that keeps an objective. `--up` starts a system
//! of the run's own, whose processes and links `--fault` troubles; `--agents` has several processes or machines ask.

mod agents;
mod arrivals;
mod asking;
mod capacity;
mod delay;
mod fault;
mod light;
mod light_cells;
mod mix;
mod own;
mod report;
mod written;

use std::ffi::OsStr;
use std::path::PathBuf;

use clap::Args;
use repose_evaluation::report::written::can_write;
use repose_proto::place::Variant;
use repose_runtime::RuntimeConfig;

use crate::client::{self, ConnectArgs, SystemArgs};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::values::{parse_count, parse_variant};
use agents::{Agents, Part};
use arrivals::Arrivals;
use asking::{Asking, Slice};
use capacity::Objective;
use delay::DelayedLink;
use fault::Fault;
use mix::Kind;
use own::{OwnSystem, Sizes, Troubled};
use report::{Ended, Report};

/// Arguments of `load`.
#[derive(Debug, Clone, Args)]
pub struct LoadArgs {
    /// Where to ask.
    #[command(flatten)]
    pub connect: ConnectArgs,
    /// Number of concurrent clients, each of which sends its next request as soon as the last was answered (closed loop).
    #[arg(long, default_value_t = 4, value_parser = parse_count)]
    pub clients: usize,
    /// Requests in total.
    #[arg(long, default_value_t = 100, value_parser = parse_count)]
    pub requests: usize,
    /// Requests per second, whether or not earlier ones were answered (open loop).
    #[arg(long)]
    pub rate: Option<f64>,
    /// When the requests of an open loop are due.
    #[arg(long, value_enum, default_value_t = Arrivals::Constant)]
    pub arrivals: Arrivals,
    /// Share of the requests that are interactive; the others are batch, and yield to them.
    #[arg(long, default_value_t = 1.0)]
    pub interactive: f64,
    /// Several kinds of requests, each with a share: 3:variant=best --mix 1:method=arrange,priority=batch,deadline_ms=20000. Settings are method
    /// (place, arrange, segment), variant, count, iterations, batch, priority, deadline_ms, cell, and whole=true, which encloses the scene.
    #[arg(long, value_name = "SHARE:SETTING=VALUE,…")]
    pub mix: Vec<Kind>,
    /// Load a pool as this many light cells, each with its own scene, a slight variation of the camera's, and with the traffic of a robot and of
    /// perception, but without physics; the report lists each cell's results. With --up the run's own system is the pool. In a closed loop each
    /// client asks in one cell: take as many clients as cells, or a multiple, for an equal load.
    #[arg(long, value_parser = parse_count, conflicts_with_all = ["secured", "agents"])]
    pub cells: Option<usize>,
    /// Robot states that each light cell puts, a second.
    #[arg(long, default_value_t = 50.0, requires = "cells", conflicts_with_all = ["secured", "agents"], value_name = "RATE", value_parser = parse_rate)]
    pub states: f64,
    /// Scene summaries that each light cell puts, a second.
    #[arg(long, default_value_t = 5.0, requires = "cells", conflicts_with_all = ["secured", "agents"], value_name = "RATE", value_parser = parse_rate)]
    pub summaries: f64,
    /// Warm-up requests, which are not counted.
    #[arg(long, default_value_t = 0)]
    pub warm_up: usize,
    /// Start a separate system on this machine (router, simulated cell, services), and load that one.
    // That it goes with neither --connect nor --config is checked by hand: clap does not ask for --up, which others require, where a conflict
    // rules it out.
    #[arg(long)]
    pub up: bool,
    /// Planner processes of that system.
    #[arg(long, default_value_t = 1, value_parser = parse_count, requires = "up")]
    pub planners: usize,
    /// Inference processes of that system.
    #[arg(long, default_value_t = 1, value_parser = parse_count, requires = "up")]
    pub inference: usize,
    /// Routers of that system. When one is killed, the others carry its traffic.
    #[arg(long, default_value_t = 1, value_parser = parse_count, requires = "up")]
    pub routers: usize,
    /// With users, certificates and access control in that system, over QUIC.
    #[arg(long, requires = "up", conflicts_with = "routers")]
    pub secured: bool,
    /// Inject a fault into that system during the run: kill:SERVICE:PERIOD, stop:SERVICE:PERIOD[:FOR], router:PERIOD[:FOR] or delay:TIME, such as
    /// kill:inference:2s.
    #[arg(long, requires = "up", value_name = "FAULT")]
    pub fault: Vec<Fault>,
    /// Send the requests from this many processes on this machine, or from one process on each of these hosts (a,b,…), which are reached by ssh
    /// and have `repose`.
    #[arg(long, value_name = "COUNT|HOST,…")]
    pub agents: Option<Agents>,
    /// One agent's part, as its coordinator says.
    #[arg(long, hide = true)]
    agent: Option<Part>,
    /// Search for the highest rate that meets the objective, and report it. Each rate is offered for twenty times the objective's bound, and for
    /// `--requests` at least.
    #[arg(long, conflicts_with = "rate")]
    pub find_capacity: bool,
    /// With --find-capacity, the objective: a percentile of the latency and its bound, ten minutes at most; at least 99 % must be answered, too.
    #[arg(long, value_name = "OBJECTIVE", default_value = "p99<1s", requires = "find_capacity")]
    pub slo: Objective,
    /// Write a line for each request, as CSV.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Write a page with the report, and with latency and rates over time.
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// The planning method.
    #[arg(long, default_value = "best", value_parser = parse_variant)]
    pub variant: Variant,
    /// Iterations of each search.
    #[arg(long, default_value_t = 1)]
    pub iterations: u32,
    /// Candidates to accept in each iteration.
    #[arg(long, default_value_t = 16)]
    pub batch: u32,
    /// Seed of the first request, which later requests count up from, and of arrivals and priorities.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

fn parse_rate(text: &str) -> Result<f64, String> {
    let rate: f64 = text.parse().map_err(|e| format!("{e}"))?;
    // Of less than one in a quarter of an hour no run would tell.
    if rate == 0.0 || (1e-3..=1e3).contains(&rate) { Ok(rate) } else { Err("expected 0, or 0.001 to 1000".to_owned()) }
}

/// The longest run that a rate may ask for, seconds.
const LONGEST_RUN_S: f64 = 86_400.0;

/// A run against one system: asked from here, or by agents.
struct Run {
    args: LoadArgs,
    asking: Asking,
    system: SystemArgs,
}

/// Runs the command.
pub async fn run(args: &LoadArgs, output: Output) -> CommandResult {
    check(args)?;
    if let Some(part) = &args.agent {
        return agents::ask_part(args, part).await;
    }
    // A run later would be too late to say so.
    args.csv.iter().chain(&args.html).try_for_each(|path| can_write(path))?;
    let own = match args.up {
        true => {
            let sizes = Sizes { routers: args.routers, planners: args.planners, inference: args.inference };
            Some(OwnSystem::start(sizes, args.seed, args.secured).await?)
        }
        false => None,
    };
    let delay = args.fault.iter().find_map(|fault| if let Fault::Delay(delay) = fault { Some(*delay) } else { None });
    let mut system = own.as_ref().map_or_else(|| args.connect.system.clone(), OwnSystem::args);
    let link = match (delay, &own) {
        (Some(delay), Some(own)) => Some(DelayedLink::to(own.endpoint(), delay).await?),
        _ => None,
    };
    if let Some(link) = &link {
        system.connect = Some(link.endpoint().to_owned());
    }
    if own.is_some() && args.cells.is_some() {
        system.pool = Some(RuntimeConfig::default().session.cell);
    }
    let session = client::connect(&system).await?;
    let asking = Asking::prepare(&session, args, &system, Slice::WHOLE).await?;
    let run = Run { args: args.clone(), asking, system };
    let (report, ended, own) = run.all(own).await?;
    run.asking.close().await;
    client::close(session).await;
    drop(own);
    let asked = std::env::args_os().collect::<Vec<_>>().join(OsStr::new(" "));
    written::write(args.csv.as_deref(), args.html.as_deref(), &asked.to_string_lossy(), &report, &ended)?;
    output.print(&report, || report.to_string())?;
    if report.per_worker.is_empty() { Err(Failure::NotAchieved) } else { Ok(()) }
}

fn check(args: &LoadArgs) -> CommandResult {
    let system = &args.connect.system;
    if args.up && system.connect.is_some() {
        return Err(Failure::bad_input("up", "starts a system of its own, and --connect or REPOSE_CONNECT names another: take one away"));
    }
    if args.up && system.config.is_some() {
        return Err(Failure::bad_input("up", "starts a system of its own, which takes no --config"));
    }
    if let Some(option) = system.chosen().filter(|_| args.up) {
        return Err(Failure::bad_input(option, "is of another system than the one that --up starts"));
    }
    if args.rate.is_some_and(|r| !(r > 0.0 && r.is_finite() && args.requests as f64 / r <= LONGEST_RUN_S)) {
        return Err(Failure::bad_input("rate", format!("expected more than 0 requests per second, and all within {LONGEST_RUN_S:.0} s")));
    }
    if !(0.0..=1.0).contains(&args.interactive) {
        return Err(Failure::bad_input("interactive", format!("expected a share from 0 to 1, got {}", args.interactive)));
    }
    Ok(())
}

impl Run {
    /// Warms up, asks, and causes the faults meanwhile. Gives the system back.
    async fn all(&self, own: Option<OwnSystem>) -> Result<(Report, Vec<Ended>, Option<OwnSystem>), Failure> {
        if self.args.warm_up > 0 {
            self.asking.ask(self.args.warm_up, None).await?;
        }
        let troubled = own.map(|own| Troubled::begin(own, &self.args.fault));
        let asked = match self.args.find_capacity {
            true => capacity::find(self).await,
            false => self.ask(self.args.requests, self.args.rate).await,
        };
        let (own, faults) = match troubled {
            Some(troubled) => troubled.end().await.map(|(own, faults)| (Some(own), faults))?,
            None => (None, Vec::new()),
        };
        let (report, ended) = asked?;
        Ok((Report { faults, ..report }, ended, own))
    }

    /// Asks for so many placements, in a closed loop or at a rate.
    async fn ask(&self, requests: usize, rate: Option<f64>) -> Result<(Report, Vec<Ended>), Failure> {
        let asked = match &self.args.agents {
            Some(agents) => agents::ask_by(agents, &self.system, requests, rate).await?,
            None => self.asking.ask(requests, rate).await?,
        };
        let report = self.asking.report(&asked, rate)?;
        Ok((report, asked.ended))
    }
}
