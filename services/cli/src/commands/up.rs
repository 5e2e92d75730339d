//! `repose up`: a router and every service as processes of their own on this machine, until interrupted.
//!
//! Each is this program as `repose serve …`. One that ends is started again after a pause; all end with this process, however it ends. With `--cells`
//! there are several simulated cells, and one pool of planners and inference workers that serves them all.

use std::net::TcpListener;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Args;
use repose_console::ConsoleConfig;
use repose_proto::{Service, keys};
use repose_runtime::{RuntimeConfig, Server, Session, Shutdown};
use tokio::process::{Child, Command};
use tokio::task::{JoinError, JoinSet};

use crate::client::{self, ENDPOINT, SystemArgs, check_endpoint, client_config};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::processes::{LabelledProcess, service_process};
use crate::services::ServiceConfigs;
use crate::values::parse_count;

/// Arguments of `up`.
#[derive(Debug, Args)]
pub struct UpArgs {
    /// The address that the router listens on. For clients on other machines: tcp/0.0.0.0:7447.
    #[arg(long, default_value = ENDPOINT, env = "REPOSE_LISTEN")]
    pub listen: String,
    /// The robot cell. Default: the configuration's, or "cell".
    #[arg(long, env = "REPOSE_CELL")]
    pub cell: Option<String>,
    /// Start this many simulated cells, CELL-1, CELL-2, …, each with its own camera, robot, perception and motion; one pool of planners and
    /// inference workers serves them all. The live page shows the first cell.
    #[arg(long, value_parser = parse_count)]
    pub cells: Option<usize>,
    /// The pool of those cells.
    #[arg(long, default_value = "rack", requires = "cells", value_name = "NAME")]
    pub pool: String,
    /// Inference processes. Default: 1, or none where the configuration has a pool serve the cell.
    #[arg(long, value_parser = parse_count)]
    pub inference: Option<usize>,
    /// Planner processes. Default: 1, or none where the configuration has a pool serve the cell.
    #[arg(long, value_parser = parse_count)]
    pub planners: Option<usize>,
    /// Do not start the simulated cell: your own camera and robot connect instead (services/python has drivers).
    #[arg(long, conflicts_with = "seed")]
    pub no_simulator: bool,
    /// Seed of the simulated scene. Default: the configuration's, or 0.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Configuration of the services (TOML).
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// What the router's process is.
const ROUTER: &str = "router";
/// What the page's process serves.
const CONSOLE: &str = "console";
/// How long to wait before an ended process is started again.
const RESTART_PAUSE: Duration = Duration::from_secs(1);
/// How long the services may take to come up.
const READY_WITHIN: Duration = Duration::from_secs(60);
/// How much longer than its configuration lets it a process may take to end before it is killed: where all end at once, the machine is busy.
const STOP_MARGIN: Duration = Duration::from_secs(2);

/// Runs until interrupted.
pub async fn run(args: &UpArgs, output: Output) -> CommandResult {
    let shutdown = Shutdown::on_signals()?;
    // What no process could start with is said at once, and by its field.
    check_endpoint("listen", &args.listen)?;
    let system = SystemArgs { connect: Some(args.listen.clone()), cell: args.cell.clone(), pool: None, config: args.config.clone() };
    let mut config = client_config(&system)?;
    let layout = Layout::of(args, &config)?;
    config.caller.pool.clone_from(&layout.pool);
    let stop_within = stop_within(&config);
    let configs = ServiceConfigs::load(args.config.as_deref())?;
    let (camera, seed) = (configs.simulator.camera, args.seed.unwrap_or(configs.simulator.seed));
    let console = console_of(configs.console)?;
    let page = console.url();
    is_free(&args.listen)?;
    let parts = layout.parts(args, seed);
    let is_up = Arc::new(AtomicBool::new(false));
    let mut watchers = JoinSet::new();
    for part in &parts {
        let command = part.command(args, &layout, &console)?;
        watchers.spawn(keep_running(command, part.name.clone(), is_up.clone(), stop_within, shutdown.clone()));
    }
    let names: Vec<&str> = parts.iter().map(|part| part.name.as_str()).collect();
    let mut up = tokio::select! {
        up = ready(args, config, &layout, &camera, &shutdown) => up,
        Some(ended) = watchers.join_next() => outcome(ended),
    };
    is_up.store(true, Ordering::Release);
    if up.is_ok() && !shutdown.is_requested() {
        let Layout { cells, pool } = &layout;
        let document = serde_json::json!({
            "listen": args.listen, "cell": cells[0], "cells": cells, "pool": pool, "processes": names, "console": page,
        });
        up = output
            .print(&document, || format!("up: {} at {}, {layout}; the page is {page}; Ctrl-C ends it", names.join(", "), args.listen));
        if up.is_ok() {
            shutdown.requested().await;
        }
    }
    shutdown.trigger();
    while let Some(ended) = watchers.join_next().await {
        // Those that are left drain, whatever became of this one: with their watchers they would be killed.
        up = up.and(outcome(ended));
    }
    up
}

fn outcome(ended: Result<CommandResult, JoinError>) -> CommandResult {
    ended.unwrap_or_else(|failure| Err(Failure::other(failure)))
}

/// Which cells there are, and the pool that serves them.
struct Layout {
    cells: Vec<String>,
    pool: Option<String>,
}

impl Layout {
    fn of(args: &UpArgs, config: &RuntimeConfig) -> Result<Self, Failure> {
        let cell = &config.session.cell;
        let Some(count) = args.cells else {
            // A pool is no other's: it has its workers itself.
            let pool = config.caller.pool.clone().filter(|pool| pool != cell);
            let mut of_pool = [("inference", args.inference), ("planners", args.planners)].into_iter();
            if let (Some(pool), Some((option, _))) = (&pool, of_pool.find(|(_, count)| count.is_some())) {
                return Err(Failure::bad_input(
                    option,
                    format!("the configuration has the pool {pool} serve the cell: they are started there"),
                ));
            }
            return Ok(Self { cells: vec![cell.clone()], pool });
        };
        let cells: Vec<String> = (1..=count).map(|k| format!("{cell}-{k}")).collect();
        keys::validate_chunk("pool", &args.pool)?;
        keys::validate_chunk("cell", &cells[count - 1])?;
        if cells.contains(&args.pool) {
            return Err(Failure::bad_input("pool", format!("{} is the name of a cell", args.pool)));
        }
        Ok(Self { cells, pool: Some(args.pool.clone()) })
    }

    /// Where workers of a service run: in every cell, or in the pool. A pool that somebody else runs is left to them.
    fn homes(&self, args: &UpArgs, service: Service) -> Vec<&str> {
        match &self.pool {
            Some(_) if service.is_poolable() && args.cells.is_none() => Vec::new(),
            Some(pool) if service.is_poolable() => vec![pool],
            _ => self.cells.iter().map(String::as_str).collect(),
        }
    }

    /// Every process. The simulated cells' scenes differ.
    fn parts(&self, args: &UpArgs, seed: u64) -> Vec<Part> {
        let part = |what: &str, name: String, cell: &str| Part { what: what.to_owned(), name, cell: cell.to_owned(), seed };
        let mut parts = vec![part(ROUTER, ROUTER.to_owned(), &self.cells[0])];
        for service in Service::ALL {
            let (what, count) = (service.as_str(), count_of(args, service));
            for (home, seed) in self.homes(args, service).into_iter().zip(seed..) {
                let base = if self.cells.len() == 1 { what.to_owned() } else { format!("{home}/{what}") };
                let names = (1..=count).map(|k| if count == 1 { base.clone() } else { format!("{base}-{k}") });
                parts.extend(names.map(|name| Part { seed, ..part(what, name, home) }));
            }
        }
        parts.push(part(CONSOLE, CONSOLE.to_owned(), &self.cells[0]));
        parts
    }
}

impl std::fmt::Display for Layout {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let cells = if self.cells.len() == 1 { "cell" } else { "cells" };
        write!(f, "{cells} {}", self.cells.join(", "))?;
        self.pool.iter().try_for_each(|pool| write!(f, ", pool {pool}"))
    }
}

fn count_of(args: &UpArgs, service: Service) -> usize {
    match service {
        Service::Inference => args.inference.unwrap_or(1),
        Service::Planner => args.planners.unwrap_or(1),
        Service::Simulator if args.no_simulator => 0,
        _ => 1,
    }
}

/// A process to be.
struct Part {
    /// What it serves.
    what: String,
    /// What it is called in the log.
    name: String,
    cell: String,
    /// Of a simulated scene.
    seed: u64,
}

impl Part {
    fn command(&self, args: &UpArgs, layout: &Layout, console: &ConsoleConfig) -> Result<Command, Failure> {
        let mut command = service_process(&args.listen, &self.cell, args.config.as_deref(), &self.what)?;
        if let Some(pool) = layout.pool.as_ref().filter(|pool| **pool != self.cell) {
            command.env("REPOSE_CALLER__POOL", pool);
        }
        if self.what == Service::Simulator.as_str() {
            command.env("REPOSE_SIMULATOR__SEED", self.seed.to_string());
        }
        if self.what == CONSOLE {
            command.env("REPOSE_CONSOLE__LISTEN", console.listen.to_string());
        }
        Ok(command)
    }
}

/// Refuses an address that something else listens at: a second system would join the first, with two of every camera and robot.
fn is_free(endpoint: &str) -> CommandResult {
    let Some(address) = endpoint.strip_prefix("tcp/") else { return Ok(()) };
    let taken = |e: std::io::Error| Failure::bad_input("listen", format!("{endpoint}: {e}"));
    TcpListener::bind(address).map(drop).map_err(taken)
}

/// Waits until every service has its workers, and each simulated camera its first scene: from then on anything can be asked. For a camera that
/// somebody else starts nobody waits.
async fn ready(args: &UpArgs, config: RuntimeConfig, layout: &Layout, camera: &str, shutdown: &Shutdown) -> CommandResult {
    let session = Session::open(config).await?;
    let is_up = async {
        for cell in &layout.cells {
            let session = session.in_cell(cell)?;
            for service in Service::ALL {
                session.caller(service).await?.wait_for_workers(count_of(args, service), READY_WITHIN).await?;
            }
            if !args.no_simulator {
                client::newest_scene(&session, camera, READY_WITHIN, READY_WITHIN).await?;
            }
        }
        Ok::<_, Failure>(())
    };
    let up = tokio::select! {
        up = is_up => up,
        () = shutdown.requested() => Ok(()),
    };
    client::close(session).await;
    up
}

/// The console's configuration, at a port that is free: where its own is taken, as by another system on this machine, the system chooses.
fn console_of(mut config: ConsoleConfig) -> Result<ConsoleConfig, Failure> {
    config.validate().map_err(|e| Failure::bad_input("console", e))?;
    let is_taken = |e: std::io::Error| Failure::bad_input("console.listen", format!("{}: {e}", config.listen));
    config.listen = match TcpListener::bind(config.listen) {
        Err(e) if e.kind() == std::io::ErrorKind::AddrInUse => TcpListener::bind((config.listen.ip(), 0)).and_then(|l| l.local_addr()),
        bound => bound.and_then(|l| l.local_addr()),
    }
    .map_err(is_taken)?;
    Ok(config)
}

/// Starts a process again whenever it ends, until `shutdown`; then tells it to drain, and gives it `stop_within` for that. One that ends before the
/// system is up always would, and one that cannot be started then never could; later the machine may be out of something for a moment, or the program
/// is just being replaced.
async fn keep_running(
    mut command: Command,
    name: String,
    is_up: Arc<AtomicBool>,
    stop_within: Duration,
    shutdown: Shutdown,
) -> CommandResult {
    while !shutdown.is_requested() {
        let mut process = match LabelledProcess::spawn(&mut command, &name) {
            Ok(process) => process,
            Err(error) if is_up.load(Ordering::Acquire) => {
                tracing::warn!("{name} could not be started, and is tried again: {error}");
                pause(&shutdown).await;
                continue;
            }
            Err(error) => return Err(Failure::other(format!("{name} could not be started: {error}"))),
        };
        tokio::select! {
            ended = process.child.wait() => {
                process.rest_of_log().await;
                if !shutdown.is_requested() {
                    let status = ended.map_or_else(|e| e.to_string(), |status| status.to_string());
                    if !is_up.load(Ordering::Acquire) {
                        return Err(Failure::other(format!("{name} ended before the system was up: {status}")));
                    }
                    tracing::warn!("{name} ended ({status}) and is started again");
                }
            }
            () = shutdown.requested() => {
                stop(&mut process.child, &name, stop_within).await;
                process.rest_of_log().await;
                return Ok(());
            }
        }
        pause(&shutdown).await;
    }
    Ok(())
}

/// Waits before a process is started again.
async fn pause(shutdown: &Shutdown) {
    tokio::select! {
        () = tokio::time::sleep(RESTART_PAUSE) => {}
        () = shutdown.requested() => {}
    }
}

/// How long a process may take to end: as long as its worker drains and its session closes, and some more.
fn stop_within(config: &RuntimeConfig) -> Duration {
    Server::longest_drain(&config.worker) + Duration::from_millis(config.session.close_timeout_ms) + STOP_MARGIN
}

async fn stop(child: &mut Child, name: &str, within: Duration) {
    if let Some(id) = child.id().and_then(|id| i32::try_from(id).ok()) {
        // SAFETY: a plain system call on a child that has not been waited for, so its id is still its own.
        unsafe { libc::kill(id, libc::SIGTERM) };
    }
    if tokio::time::timeout(within, child.wait()).await.is_err() {
        tracing::warn!("{name} did not drain in {:.1} s and is killed", within.as_secs_f64());
        if let Err(error) = child.kill().await {
            tracing::error!("{name} could not be killed: {error}");
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use repose_runtime::WorkerConfig;

    use super::*;

    type Line = crate::testing::Line<UpArgs>;

    #[test]
    fn planners_are_started_here_unless_another_pool_has_them_and_then_asking_for_some_is_refused() {
        let layout = |pool: Option<&str>, options: &[&str]| {
            let mut config = RuntimeConfig::default();
            (config.session.cell, config.caller.pool) = ("rack".to_owned(), pool.map(str::to_owned));
            let args = Line::parse_from(["up"].iter().chain(options)).args;
            let planners = |layout: Layout| layout.parts(&args, 0).iter().filter(|part| part.what == Service::Planner.as_str()).count();
            Layout::of(&args, &config).map(planners).map_err(|refused| refused.error().and_then(|e| e.field.clone()))
        };
        assert_eq!((layout(None, &[]), layout(None, &["--planners", "3"])), (Ok(1), Ok(3)));
        assert_eq!(layout(Some("rack"), &["--planners", "3"]), Ok(3), "the pool itself");
        assert_eq!(layout(Some("hall"), &[]), Ok(0));
        assert_eq!(layout(Some("hall"), &["--planners", "3"]), Err(Some("planners".to_owned())));
        assert_eq!(layout(Some("hall"), &["--cells", "2", "--planners", "3"]), Ok(3));
    }

    #[test]
    fn an_address_that_is_taken_is_refused_before_anything_starts() {
        let other = TcpListener::bind("127.0.0.1:0").expect("a port");
        let endpoint = format!("tcp/{}", other.local_addr().expect("an address"));
        let refused = is_free(&endpoint).expect_err("it is taken");
        assert_eq!((refused.exit_code(), refused.error().and_then(|e| e.field.as_deref())), (2, Some("listen")));
        drop(other);
        assert!(is_free(&endpoint).is_ok() && is_free("unixsock-stream//tmp/x").is_ok());
    }

    #[tokio::test(start_paused = true)]
    async fn a_process_of_a_running_system_that_cannot_be_started_is_tried_again_until_the_end() {
        let run = |is_up: bool, shutdown: &Shutdown| {
            let command = Command::new("/nowhere/repose");
            keep_running(command, "planner".to_owned(), Arc::new(AtomicBool::new(is_up)), Duration::ZERO, shutdown.clone())
        };
        let shutdown = Shutdown::new();
        assert!(run(false, &shutdown).await.is_err(), "before it is up, the system cannot come up");
        let tries = tokio::spawn(run(true, &shutdown));
        tokio::time::sleep(3 * RESTART_PAUSE).await;
        assert!(!tries.is_finished(), "it is not given up");
        shutdown.trigger();
        assert!(tries.await.expect("no panic").is_ok());
    }

    #[test]
    fn no_process_is_killed_while_its_configuration_lets_it_drain() {
        let mut config = RuntimeConfig::default();
        config.worker.drain_ms = 60_000;
        let WorkerConfig { drain_notice_ms, drain_ms, cancel_grace_ms, .. } = config.worker;
        let drains = drain_notice_ms + drain_ms + cancel_grace_ms + config.session.close_timeout_ms;
        assert!(stop_within(&config) > Duration::from_millis(drains));
    }

    #[test]
    fn a_second_system_on_this_machine_has_its_page_at_another_port() {
        let first = TcpListener::bind("127.0.0.1:0").expect("a port");
        let config = ConsoleConfig { listen: first.local_addr().expect("an address"), ..ConsoleConfig::default() };
        let second = console_of(config.clone()).expect("another port");
        assert!(second.listen.port() != config.listen.port() && second.listen.ip() == config.listen.ip());
    }
}
