//! `repose mcp`: the tools of an agent, over the Model Context Protocol.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use repose_mcp::{HttpSettings, McpError, McpSettings, serve_http, serve_stdio};
use repose_runtime::{Session, Shutdown};

use crate::client::{self, ConnectArgs, client_config};
use crate::failure::{CommandResult, Failure};

/// Arguments of `mcp`.
#[derive(Debug, Args)]
pub struct McpArgs {
    /// The running system.
    #[command(flatten)]
    pub connect: ConnectArgs,
    /// The robot.
    #[arg(long, default_value = "panda")]
    pub robot: String,
    /// Allow agents to have the robot carry out plans that they were shown. Without it nothing moves; `stop` always works.
    #[arg(long)]
    pub allow_execute: bool,
    /// Serve over streamable HTTP at this address, path /mcp, instead of standard input and output. Beyond loopback it needs --token.
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub http: Option<SocketAddr>,
    /// A file with the token that agents send over HTTP as `Authorization: Bearer …`.
    #[arg(long, value_name = "FILE", requires = "http")]
    pub token: Option<PathBuf>,
    /// A host name, without port, that agents may use over HTTP; this machine's addresses and localhost are always allowed. Repeat for more.
    #[arg(long, value_name = "NAME", requires = "http")]
    pub host: Vec<String>,
}

impl From<McpError> for Failure {
    fn from(error: McpError) -> Self {
        match error {
            McpError::Setting(error) => error.into(),
            McpError::Listen { .. } => Self::bad_input("http", error),
            McpError::Runtime(error) => error.into(),
            McpError::Serve(_) => Self::other(error),
        }
    }
}

/// Runs until the agent leaves (standard input) or the command is interrupted, and then until the execution under way is over.
pub async fn run(args: &McpArgs) -> CommandResult {
    let shutdown = Shutdown::on_signals()?;
    let settings = McpSettings {
        camera: args.connect.camera.clone(),
        robot: args.robot.clone(),
        allow_execute: args.allow_execute,
        deadline: Duration::from_millis(args.connect.deadline_ms),
        ..McpSettings::default()
    };
    settings.validate()?;
    let config = client_config(&args.connect.system)?;
    let drain = Duration::from_millis(config.worker.drain_ms);
    let session = Session::open(config).await?;
    let served = match args.http {
        None => serve_stdio(session.clone(), settings, drain, shutdown).await,
        Some(listen) => {
            let http = HttpSettings { listen, token: args.token.clone(), hosts: args.host.clone() };
            serve_http(session.clone(), settings, http, drain, shutdown).await
        }
    };
    client::close(session).await;
    Ok(served?)
}
