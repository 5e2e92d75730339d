//! A process's place in one cell's network: callers, workers, publishers and subscriptions come from here. Cheap to clone.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use repose_proto::{CallError, Cell, Payload, Service};

use crate::caller::Caller;
use crate::config::{RuntimeConfig, TelemetryConfig};
use crate::lives::Lives;
use crate::shares::Shares;
use crate::target::Target;
use crate::telemetry::REFUSED_KINDS;
use crate::transport::{AliveWatch, Subscription, Traffic, Transport};
use crate::zenoh_session::watch_certificates;
use crate::zenoh_transport::ZenohTransport;
use crate::{Handler, HealthServer, RuntimeError, Server, Shutdown, open_files};

/// A connection to a cell.
#[derive(Clone)]
pub struct Session {
    transport: Arc<dyn Transport>,
    cell: Cell,
    config: Arc<RuntimeConfig>,
    serving: Arc<AtomicUsize>,
}

impl Session {
    /// Opens a session over Zenoh.
    ///
    /// # Errors
    /// When the configuration is unusable or the network cannot be reached.
    pub async fn open(config: RuntimeConfig) -> Result<Self, RuntimeError> {
        config.validate()?;
        watch_certificates(&config.session)?;
        let transport = Arc::new(ZenohTransport::open(&config.session).await?);
        Self::over(transport, config)
    }

    /// Everything that talks in this one process, nothing listening: for `demo` and tests.
    ///
    /// # Errors
    /// When the network cannot be set up.
    pub async fn embedded() -> Result<Self, RuntimeError> {
        Self::open(RuntimeConfig::default()).await
    }

    /// A session over any transport.
    ///
    /// # Errors
    /// When the configured cell is no chunk of a key.
    pub fn over(transport: Arc<dyn Transport>, config: RuntimeConfig) -> Result<Self, RuntimeError> {
        let cell = Cell::new(&config.session.cell).map_err(|e| RuntimeError::transport("naming the cell", e))?;
        Ok(Self { transport, cell, config: Arc::new(config), serving: Arc::default() })
    }

    /// The same connection, in another cell.
    ///
    /// # Errors
    /// When the name is no chunk of a key.
    pub fn in_cell(&self, name: &str) -> Result<Self, CallError> {
        Ok(Self { cell: Cell::new(name)?, ..self.clone() })
    }

    /// The pool that serves this cell, too, if it has one.
    pub fn pool(&self) -> Option<&str> {
        self.config.caller.pool.as_deref().filter(|pool| *pool != self.cell.name())
    }

    /// What this process is to tell of itself.
    pub(crate) fn telemetry(&self) -> &TelemetryConfig {
        &self.config.telemetry
    }

    /// What each cell may have of a worker here that serves several.
    pub fn cell_shares(&self) -> Arc<Shares> {
        Arc::new(self.config.worker.cell_shares())
    }

    /// The cell's keys.
    pub fn cell(&self) -> &Cell {
        &self.cell
    }

    /// Follows a service's workers, to call them: those of the cell's pool, where it has one and a pool may serve that.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn caller(&self, service: Service) -> Result<Caller, RuntimeError> {
        let target = match self.pool().filter(|_| service.is_poolable()) {
            Some(pool) => {
                let pool = Cell::new(pool).map_err(|e| RuntimeError::transport("naming the pool", e))?;
                Target { workers_in: pool, service, on_behalf_of: Some(self.cell.name().into()) }
            }
            None => Target { workers_in: self.cell.clone(), service, on_behalf_of: None },
        };
        Caller::new(self.transport.clone(), target, self.config.session.name.clone(), self.config.caller.clone()).await
    }

    /// Starts a worker of a service; drain it to stop it.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn start(&self, service: Service, handler: Arc<dyn Handler>) -> Result<Server, RuntimeError> {
        Server::start(self.transport.clone(), self.cell.clone(), service, handler, self.config.worker.clone()).await
    }

    /// Serves until `shutdown` is asked, then drains.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn serve(&self, service: Service, handler: Arc<dyn Handler>, shutdown: Shutdown) -> Result<(), RuntimeError> {
        let server = self.start(service, handler).await?;
        self.serving.fetch_add(1, Ordering::AcqRel);
        let ended = tokio::select! {
            () = shutdown.requested() => Ok(()),
            taken = server.name_taken() => Err(taken),
        };
        self.serving.fetch_sub(1, Ordering::AcqRel);
        server.drain().await;
        ended
    }

    /// Workers that serve by [`Session::serve`] and are not draining.
    pub fn serving(&self) -> usize {
        self.serving.load(Ordering::Acquire)
    }

    /// Subscribes to the newest message: one that is not taken before the next comes is dropped and counted.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn subscribe_latest(&self, key: &str) -> Result<Subscription, RuntimeError> {
        self.transport.subscribe(key, 1).await
    }

    /// Subscribes with room for `capacity` messages; the oldest is dropped and counted when there is no room.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn subscribe_queue(&self, key: &str, capacity: usize) -> Result<Subscription, RuntimeError> {
        self.transport.subscribe(key, capacity).await
    }

    /// Follows the liveliness tokens that match a key.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn watch_alive(&self, key: &str) -> Result<AliveWatch, RuntimeError> {
        self.transport.watch_alive(key).await
    }

    /// Follows who is alive in every cell, or in those that this session may look into.
    ///
    /// # Errors
    /// When the network refuses, or the configured pool is no chunk of a key.
    pub async fn watch_lives(&self) -> Result<Lives, RuntimeError> {
        let pool = self.pool().map(Cell::new).transpose().map_err(|e| RuntimeError::transport("naming the pool", e))?;
        Lives::watch(self.transport.as_ref(), &self.cell, pool.as_ref()).await
    }

    /// Whether this session is let in as a user, who sees some cells only.
    pub fn is_user(&self) -> bool {
        self.transport.is_user()
    }

    /// Something to put messages of one kind to one key with.
    pub fn publisher(&self, key: impl Into<String>, traffic: Traffic) -> Publisher {
        Publisher { transport: self.transport.clone(), key: key.into(), traffic }
    }

    /// Puts one message.
    ///
    /// # Errors
    /// When the message is too large or the network refuses.
    pub async fn put(&self, key: &str, payload: Payload, traffic: Traffic) -> Result<(), RuntimeError> {
        self.transport.put(key, payload, traffic).await
    }

    /// Where others can connect to, `tcp/127.0.0.1:38211`.
    pub async fn locators(&self) -> Vec<String> {
        self.transport.locators().await
    }

    /// The transport below.
    pub fn transport(&self) -> Arc<dyn Transport> {
        self.transport.clone()
    }

    /// Closes the session for all its clones, within `close_timeout_ms`.
    ///
    /// # Errors
    /// When it takes longer.
    pub async fn close(&self) -> Result<(), RuntimeError> {
        self.transport.close(Duration::from_millis(self.config.session.close_timeout_ms)).await
    }
}

/// Puts messages of one kind to one key.
#[derive(Clone)]
pub struct Publisher {
    transport: Arc<dyn Transport>,
    key: String,
    traffic: Traffic,
}

impl Publisher {
    /// Puts a message.
    ///
    /// # Errors
    /// When the message is too large or the network refuses.
    pub async fn put(&self, payload: Payload) -> Result<(), RuntimeError> {
        self.transport.put(&self.key, payload, self.traffic).await
    }

    /// The key.
    pub fn key(&self) -> &str {
        &self.key
    }
}

/// Routes for others until `shutdown` is asked: what `repose serve router` is.
///
/// # Errors
/// When the session cannot be opened.
pub async fn run_router(config: RuntimeConfig, shutdown: Shutdown) -> Result<(), RuntimeError> {
    open_files::allow_most();
    let session = Session::open(config).await?;
    for kind in REFUSED_KINDS {
        // Told from the start: of a count that appears with the first refusal Prometheus does not see that it has risen.
        metrics::counter!("repose_router_refused_total", "kind" => kind).increment(0);
    }
    let _health = HealthServer::of(&session, false).await?;
    tracing::info!(locators = ?session.locators().await, "routing");
    shutdown.requested().await;
    session.close().await
}
