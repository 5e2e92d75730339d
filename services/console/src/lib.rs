//! The live page of a cell: what its cameras see, what is found there, where things could go, and what the robot does.
//!
//! [`run`] serves it over HTTP and WebSockets to any number of viewers. The page's files are in the program ([`page`]). Everything a viewer
//! is told goes through its [`viewers::Outbox`], where a newer message of a kind takes the place of an older one that still waits, so that a
//! slow viewer slows nobody; over a slow link the page keeps a [`pace`]. [`cell`] follows a cell while somebody looks; [`endpoints`] answers what viewers ask. [`access`] says who may.
//! A console that is to end waits for the moves that it has begun ([`Moves`](repose_runtime::Moves)).

pub mod access;
pub mod activity;
pub mod arm;
pub mod arrangement;
pub mod cell;
pub mod config;
pub mod endpoints;
pub mod messages;
pub mod pace;
pub mod page;
pub mod parts;
pub mod robots;
pub mod stage;
pub mod system;
pub mod tls;
pub mod view;
pub mod viewers;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use repose_runtime::{CertificateReading, RuntimeError, Session, Shutdown, serve_http, watch_certificate};
use tokio::net::TcpListener;

pub use config::ConsoleConfig;

/// Why the console could not run.
#[derive(Debug, thiserror::Error)]
pub enum ConsoleError {
    /// A field of the configuration that cannot be used.
    #[error("[console] {field}: {message}")]
    Config {
        /// Which.
        field: &'static str,
        /// What was expected, and what came.
        message: String,
    },
    /// The address could not be listened at.
    #[error("[console] listen: {address}: {source}")]
    Listen {
        /// Where.
        address: SocketAddr,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// Serving ended.
    #[error("serving pages: {0}")]
    Serve(#[from] std::io::Error),
    /// The network refused.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
}

/// Serves the page as [`Console::serve`] does.
///
/// # Errors
/// When the configuration is unusable, the address is taken, or the network refuses.
pub async fn run(session: Session, config: ConsoleConfig, drain: Duration, shutdown: Shutdown) -> Result<(), ConsoleError> {
    let console = Console::open(session, config).await?;
    tracing::info!(url = console.url(), "serving the page");
    console.serve(drain, shutdown).await
}

/// A console that listens and does not serve yet.
pub struct Console {
    listener: TcpListener,
    tls: Option<tls::Acceptor>,
    state: Arc<endpoints::AppState>,
    address: SocketAddr,
}

impl Console {
    /// Checks the configuration and takes the address.
    ///
    /// # Errors
    /// As [`run`].
    pub async fn open(session: Session, config: ConsoleConfig) -> Result<Self, ConsoleError> {
        config.validate()?;
        let access = access::Access::read(&config)?;
        let tls = config.certificate_and_key().map(|(certificate, key)| tls::Acceptor::read(certificate, key)).transpose()?;
        if let Some(certificate) = config.certificate.as_deref() {
            watch_certificate(certificate, CertificateReading::Again);
        }
        let address = config.listen;
        let listener = TcpListener::bind(address).await.map_err(|source| ConsoleError::Listen { address, source })?;
        let address = listener.local_addr()?;
        let state = endpoints::AppState::new(session, config, access, tls.is_some());
        Ok(Self { listener, tls, state: Arc::new(state), address })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What to type into a browser on this machine.
    pub fn url(&self) -> String {
        url(self.address, self.tls.is_some())
    }

    /// Serves until `shutdown`, and then until the moves under way are over, at most for `drain`: until then the pages show them, and stop the robots.
    ///
    /// # Errors
    /// When the listener fails.
    pub async fn serve(self, drain: Duration, shutdown: Shutdown) -> Result<(), ConsoleError> {
        let Self { listener, tls, state, .. } = self;
        let pages_end = Shutdown::new();
        let pages = endpoints::router(state.clone(), pages_end.clone());
        let ending = async {
            shutdown.requested().await;
            endpoints::end(&state, drain, &pages_end).await;
        };
        match tls {
            None => tokio::join!(ending, serve_http(listener, pages, &pages_end)),
            Some(acceptor) => {
                let listener = tls::Listener::new(listener, acceptor)?;
                tokio::join!(ending, serve_http(listener, pages, &pages_end))
            }
        };
        Ok(())
    }
}

/// The page's address.
pub fn url(address: SocketAddr, over_tls: bool) -> String {
    format!("{}://{address}/", if over_tls { "https" } else { "http" })
}
