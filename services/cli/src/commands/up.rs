//! `repose up`: a router and every service as processes of their own on this machine, until interrupted.
//!
//! Each is this program as `repose serve …`. One that ends is started again after a pause; all end with this process, however it ends.

use std::net::TcpListener;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Args;
use repose_console::ConsoleConfig;
use repose_proto::Service;
use repose_runtime::{RuntimeConfig, Session, Shutdown};
use tokio::process::{Child, Command};
use tokio::task::JoinSet;

use crate::client::{self, ENDPOINT, SystemArgs, client_config};
use crate::failure::{Failure, Outcome};
use crate::output::Output;
use crate::processes::{Labelled, service_process};
use crate::services::ServiceConfigs;
use crate::values::parse_count;

/// Arguments of `up`.
#[derive(Debug, Args)]
pub struct UpArgs {
    /// Where the router listens. For clients on other machines: tcp/0.0.0.0:7447.
    #[arg(long, default_value = ENDPOINT, env = "REPOSE_LISTEN")]
    pub listen: String,
    /// The robot cell. Default: the configuration's, or "cell".
    #[arg(long, env = "REPOSE_CELL")]
    pub cell: Option<String>,
    /// Inference processes.
    #[arg(long, default_value_t = 1, value_parser = parse_count)]
    pub inference: usize,
    /// Planner processes.
    #[arg(long, default_value_t = 1, value_parser = parse_count)]
    pub planners: usize,
    /// Without the simulated cell: a camera and a robot of your own join (services/python has drivers).
    #[arg(long, conflicts_with = "seed")]
    pub no_simulator: bool,
    /// Seed of the simulated scene. Default: the configuration's, or 0.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Configuration of the services (TOML).
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// What the page's process serves.
const CONSOLE: &str = "console";
/// How long to wait before an ended process is started again.
const RESTART_PAUSE: Duration = Duration::from_secs(1);
/// How long the services may take to come up.
const READY_WITHIN: Duration = Duration::from_secs(60);
/// How long a process may take to drain before it is killed.
const STOP_WITHIN: Duration = Duration::from_secs(15);

/// Runs until interrupted.
pub async fn run(args: &UpArgs, output: Output) -> Outcome {
    let shutdown = Shutdown::on_signals()?;
    let processes = processes(args);
    // What no process could start with is said at once, and by its field.
    let system = SystemArgs { connect: Some(args.listen.clone()), cell: args.cell.clone(), config: args.config.clone() };
    let config = client_config(&system)?;
    let cell = config.session.cell.clone();
    let configs = ServiceConfigs::load(args.config.as_deref())?;
    let (camera, console) = (configs.simulator.camera, console_of(configs.console)?);
    let page = console.url();
    is_free(&args.listen)?;
    let is_up = Arc::new(AtomicBool::new(false));
    let mut watchers = JoinSet::new();
    for (what, name) in &processes {
        watchers.spawn(keep_running(command(args, &cell, &console, what)?, name.clone(), is_up.clone(), shutdown.clone()));
    }
    let names: Vec<&str> = processes.iter().map(|(_, name)| name.as_str()).collect();
    let up = tokio::select! {
        up = ready(args, config, &camera, &shutdown) => up,
        Some(ended) = watchers.join_next() => ended.map_err(Failure::other)?,
    };
    is_up.store(true, Ordering::Release);
    if up.is_ok() && !shutdown.is_requested() {
        let document = serde_json::json!({"listen": args.listen, "cell": cell, "processes": names, "console": page});
        output
            .print(&document, || format!("up: {} at {}, cell {cell}; the page is {page}; Ctrl-C ends it", names.join(", "), args.listen))?;
        shutdown.requested().await;
    }
    shutdown.trigger();
    while let Some(ended) = watchers.join_next().await {
        ended.map_err(Failure::other)??;
    }
    up
}

/// Every process: what it serves, and its name in the log.
fn processes(args: &UpArgs) -> Vec<(String, String)> {
    let mut processes = vec![("router".to_owned(), "router".to_owned())];
    for service in Service::ALL {
        let (what, count) = (service.as_str(), count_of(args, service));
        processes.extend((1..=count).map(|k| (what.to_owned(), if count == 1 { what.to_owned() } else { format!("{what}-{k}") })));
    }
    processes.push((CONSOLE.to_owned(), CONSOLE.to_owned()));
    processes
}

fn count_of(args: &UpArgs, service: Service) -> usize {
    match service {
        Service::Inference => args.inference,
        Service::Planner => args.planners,
        Service::Simulator if args.no_simulator => 0,
        _ => 1,
    }
}

/// Refuses an address that something else listens at: a second system would join the first, with two of every camera and robot.
fn is_free(endpoint: &str) -> Outcome {
    let Some(address) = endpoint.strip_prefix("tcp/") else { return Ok(()) };
    let taken = |e: std::io::Error| Failure::bad_input("listen", format!("{endpoint}: {e}"));
    TcpListener::bind(address).map(drop).map_err(taken)
}

/// Waits until every service has its workers, and the simulated camera its first scene: from then on anything can be asked. For a camera that
/// somebody else starts nobody waits.
async fn ready(args: &UpArgs, config: RuntimeConfig, camera: &str, shutdown: &Shutdown) -> Outcome {
    let session = Session::open(config).await?;
    let is_up = async {
        for service in Service::ALL {
            session.caller(service).await?.wait_for_workers(count_of(args, service), READY_WITHIN).await?;
        }
        match args.no_simulator {
            true => Ok(()),
            false => client::newest_scene(&session, camera, READY_WITHIN, READY_WITHIN).await.map(drop),
        }
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

fn command(args: &UpArgs, cell: &str, console: &ConsoleConfig, what: &str) -> Result<Command, Failure> {
    let mut command = service_process(&args.listen, cell, args.config.as_deref(), what)?;
    if let Some(seed) = args.seed.filter(|_| what == Service::Simulator.as_str()) {
        command.env("REPOSE_SIMULATOR__SEED", seed.to_string());
    }
    if what == CONSOLE {
        command.env("REPOSE_CONSOLE__LISTEN", console.listen.to_string());
    }
    Ok(command)
}

/// Starts a process again whenever it ends, until `shutdown`; then tells it to drain. One that ends before the system is up always would.
async fn keep_running(mut command: Command, name: String, is_up: Arc<AtomicBool>, shutdown: Shutdown) -> Outcome {
    while !shutdown.is_requested() {
        let mut process = Labelled::spawn(&mut command, &name).map_err(|e| Failure::other(format!("{name} could not be started: {e}")))?;
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
                stop(&mut process.child, &name).await;
                process.rest_of_log().await;
                return Ok(());
            }
        }
        tokio::select! {
            () = tokio::time::sleep(RESTART_PAUSE) => {}
            () = shutdown.requested() => {}
        }
    }
    Ok(())
}

async fn stop(child: &mut Child, name: &str) {
    if let Some(id) = child.id().and_then(|id| i32::try_from(id).ok()) {
        // SAFETY: a plain system call on a child that has not been waited for, so its id is still its own.
        unsafe { libc::kill(id, libc::SIGTERM) };
    }
    if tokio::time::timeout(STOP_WITHIN, child.wait()).await.is_err() {
        tracing::warn!("{name} did not drain in {} s and is killed", STOP_WITHIN.as_secs());
        if let Err(error) = child.kill().await {
            tracing::error!("{name} could not be killed: {error}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_that_is_taken_is_refused_before_anything_starts() {
        let other = TcpListener::bind("127.0.0.1:0").expect("a port");
        let endpoint = format!("tcp/{}", other.local_addr().expect("an address"));
        let refused = is_free(&endpoint).expect_err("it is taken");
        assert_eq!((refused.exit_code(), refused.error().and_then(|e| e.field.as_deref())), (2, Some("listen")));
        drop(other);
        assert!(is_free(&endpoint).is_ok() && is_free("unixsock-stream//tmp/x").is_ok());
    }

    #[test]
    fn a_second_system_on_this_machine_has_its_page_at_another_port() {
        let first = TcpListener::bind("127.0.0.1:0").expect("a port");
        let config = ConsoleConfig { listen: first.local_addr().expect("an address"), ..ConsoleConfig::default() };
        let second = console_of(config.clone()).expect("another port");
        assert!(second.listen.port() != config.listen.port() && second.listen.ip() == config.listen.ip());
    }
}
