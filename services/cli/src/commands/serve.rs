//! `repose serve`: one service, or the router, as this process.

use std::time::Duration;

use clap::Args;
use repose_console::ConsoleError;
use repose_proto::{CallError, ErrorCode, Service};
use repose_ros2::{BridgeError, Ros2Config};
use repose_runtime::{HealthServer, Session, Shutdown, load_config, run_router, start_metrics};

use crate::client::{self, SystemArgs, client_config, router_config};
use crate::failure::{CommandResult, Failure};
use crate::services::ServiceConfigs;

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// perception, inference, planner, motion, simulator, console, ros2, or router.
    #[arg(value_parser = parse_served)]
    pub service: Served,
    /// The system.
    #[command(flatten)]
    pub system: SystemArgs,
    /// This worker's name, unique in its cell. Default: the configuration's, or a new one.
    #[arg(long)]
    pub worker: Option<String>,
    /// Also exit when standard input closes: for a parent process that may die, and for `ssh HOST repose serve …`.
    #[arg(long)]
    pub until_stdin_ends: bool,
}

/// What the options of a client mean to a process that serves.
pub fn with_own_help(serve: clap::Command) -> clap::Command {
    let connect = "The router to connect to; of several, separated by commas, the first that answers is used. `serve router` listens there \
                   instead. Default: the configuration's, or tcp/127.0.0.1:7447";
    let config = "Configuration (TOML): its sections [session], [caller], [worker] and [telemetry], and the service's own, such as [planner]; \
                  deploy/repose.toml says every setting, but those of [ros2]";
    serve.mut_arg("connect", |arg| arg.help(connect)).mut_arg("config", |arg| arg.help(config))
}

/// What a `serve` process is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Served {
    /// A service.
    Service(Service),
    /// The live page.
    Console,
    /// The bridge to a ROS 2 system.
    Ros2,
    /// The router that a deployment's processes meet at.
    Router,
}

fn parse_served(name: &str) -> Result<Served, String> {
    let known = || Service::ALL.map(Service::as_str).join(", ");
    match name {
        "router" => Ok(Served::Router),
        "console" => Ok(Served::Console),
        "ros2" => Ok(Served::Ros2),
        _ => Service::parse(name).map(Served::Service).ok_or_else(|| format!("the services are {}, console, ros2, router", known())),
    }
}

/// Runs until SIGTERM or SIGINT, then drains.
pub async fn run(args: &ServeArgs) -> CommandResult {
    let shutdown = Shutdown::on_signals()?;
    if args.until_stdin_ends {
        end_with_input(std::io::stdin(), shutdown.clone())?;
    }
    start_metrics()?;
    match args.service {
        Served::Router => Ok(run_router(router_config(&args.system)?, shutdown).await?),
        Served::Console => {
            let console = ServiceConfigs::load(args.system.config.as_deref())?.console;
            let config = client_config(&args.system)?;
            let drain = Duration::from_millis(config.worker.drain_ms);
            let session = Session::open(config).await?;
            let _health = HealthServer::of(&session, false).await?;
            let served = repose_console::run(session.clone(), console, drain, shutdown).await;
            client::close(session).await;
            served.map_err(|e| match e {
                ConsoleError::Config { field, .. } => Failure::bad_input(&format!("console.{field}"), e),
                ConsoleError::Listen { .. } => Failure::bad_input("console.listen", e),
                ConsoleError::Runtime(e) => e.into(),
                ConsoleError::Serve(_) => Failure::other(e),
            })
        }
        Served::Ros2 => {
            let bridge: Ros2Config = load_config("ros2", args.system.config.as_deref())?;
            bridge.validate().map_err(of_bridge)?;
            let config = client_config(&args.system)?;
            let drain = Duration::from_millis(config.worker.drain_ms);
            let session = Session::open(config).await?;
            let _health = HealthServer::of(&session, false).await?;
            let served = repose_ros2::run(session.clone(), bridge, drain, shutdown).await;
            client::close(session).await;
            served.map_err(of_bridge)
        }
        Served::Service(service) => {
            let mut config = client_config(&args.system)?;
            if args.worker.is_some() {
                config.worker.name.clone_from(&args.worker);
            }
            let services = ServiceConfigs::load(args.system.config.as_deref())?;
            let cell = config.session.cell.clone();
            let session = Session::open(config).await?;
            let _health = HealthServer::of(&session, true).await?;
            tracing::info!(%service, cell, "serving");
            let served = services.run(service, session.clone(), shutdown).await;
            client::close(session).await;
            served
        }
    }
}

fn of_bridge(error: BridgeError) -> Failure {
    match error {
        BridgeError::Config { ref field, .. } => Failure::bad_input(&format!("ros2.{field}"), error),
        BridgeError::Runtime(error) => error.into(),
        BridgeError::RosSession(_) => Failure::Other(CallError::new(ErrorCode::Unavailable, error.to_string())),
        BridgeError::Call(error) => Failure::Other(error),
        other => Failure::other(other),
    }
}

/// Has a thread ask for the end once `input` ends. What comes over it is read and left.
fn end_with_input(mut input: impl std::io::Read + Send + 'static, shutdown: Shutdown) -> CommandResult {
    let read = move || {
        match std::io::copy(&mut input, &mut std::io::sink()) {
            Ok(_) => tracing::info!("standard input has ended: stopping"),
            Err(error) => tracing::warn!(%error, "standard input cannot be read: stopping"),
        }
        shutdown.trigger();
    };
    std::thread::Builder::new().name("stdin".to_owned()).spawn(read).map(drop).map_err(Failure::other)
}
