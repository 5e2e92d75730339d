//! The tools of an agent: a cell over the Model Context Protocol.
//!
//! Five tools ([`tools`]): `look`, `plan`, `state` and `stop` for every agent, `execute` where whoever started the server allows it. An agent
//! names objects and relations; joints, poses and keys it never sees. What is carried out is a plan that this server made itself, in the same
//! session, on a scene that still looks as it did ([`execute`]). A [`desk::Desk`] does what tools ask; [`protocol`] is the only file that knows
//! the protocol's kit, [`http`] says who may connect. A server that is to end waits for what it has begun.

pub mod answer;
pub mod arguments;
pub mod asker;
pub mod desk;
pub mod execute;
pub mod http;
pub mod input;
pub mod look;
pub mod per_session;
pub mod plan;
pub mod plans;
pub mod protocol;
pub mod response;
pub mod robot;
pub mod seen;
pub mod settings;
pub mod tools;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use repose_proto::CallError;
use repose_runtime::{RuntimeError, Session, Shutdown};

pub use desk::Desk;
pub use http::HttpSettings;
pub use settings::McpSettings;

/// Why the server could not run.
#[derive(Debug, thiserror::Error)]
pub enum McpError {
    /// A setting that cannot be used.
    #[error("{0}")]
    Setting(CallError),
    /// The address could not be listened at.
    #[error("{address}: {source}")]
    Listen {
        /// Where.
        address: SocketAddr,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// Serving ended.
    #[error("serving agents: {0}")]
    Serve(String),
    /// The network refused.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
}

/// Serves one agent on standard input and output, until it closes them, or until `shutdown` and then until the execution under way is over, at most
/// for `drain`.
///
/// # Errors
/// When a setting is unusable, the network refuses, or what comes is not the protocol.
pub async fn serve_stdio(session: Session, settings: McpSettings, drain: Duration, shutdown: Shutdown) -> Result<(), McpError> {
    let desk = Arc::new(Desk::open(session, settings).await?);
    tracing::info!(execute = desk.settings().allow_execute, "serving an agent on standard input and output");
    protocol::serve_stdio(desk, drain, shutdown).await
}

/// Serves agents over streamable HTTP at `/mcp` until `shutdown`, and then until the execution under way is over, at most for `drain`.
///
/// # Errors
/// When a setting is unusable, the address is taken, or the network refuses.
pub async fn serve_http(
    session: Session,
    settings: McpSettings,
    http: HttpSettings,
    drain: Duration,
    shutdown: Shutdown,
) -> Result<(), McpError> {
    let http = http::BoundServer::open(http).await?;
    let desk = Arc::new(Desk::open(session, settings).await?);
    tracing::info!(url = http.url(), execute = desk.settings().allow_execute, "serving agents");
    http.serve(desk, drain, shutdown).await;
    Ok(())
}
