//! `repose driver`: a real robot's own process, on the robot's host.

use clap::{Args, Subcommand};
use repose_franka::{DriverError, FrankaConfig};
use repose_runtime::{HealthServer, Session, Shutdown, load_config, start_metrics};

use crate::client::{self, SystemArgs, client_config};
use crate::failure::{CommandResult, Failure};

/// Arguments of `driver`.
#[derive(Debug, Args)]
pub struct DriverArgs {
    /// The kind of robot.
    #[command(subcommand)]
    pub robot: Driven,
}

/// What is driven.
#[derive(Debug, Subcommand)]
pub enum Driven {
    /// A Franka Panda or Research 3 (FR3), over Franka's control interface: section [franka] of the configuration.
    Franka(SystemArgs),
}

/// What the option of a client means to a driver.
pub fn with_own_help(franka: clap::Command) -> clap::Command {
    let config = "Configuration (TOML): its sections [session], [telemetry] and [franka]; deploy/franka.toml is an example";
    franka.mut_arg("config", |arg| arg.help(config))
}

/// Runs until SIGTERM or SIGINT; an arm that moves comes to rest first.
pub async fn run(args: &DriverArgs) -> CommandResult {
    let Driven::Franka(system) = &args.robot;
    let shutdown = Shutdown::on_signals()?;
    start_metrics()?;
    let config: FrankaConfig = load_config("franka", system.config.as_deref())?;
    config.validate().map_err(of_driver)?;
    let session = Session::open(client_config(system)?).await?;
    let _health = HealthServer::of(&session, false).await?;
    let driven = repose_franka::run(session.clone(), config, shutdown).await;
    client::close(session).await;
    driven.map_err(of_driver)
}

fn of_driver(error: DriverError) -> Failure {
    match error {
        DriverError::Config { field, .. } => Failure::bad_input(&format!("franka.{field}"), error),
        DriverError::Runtime(error) => error.into(),
        DriverError::Call(error) => Failure::Other(error),
        other => Failure::other(other),
    }
}
