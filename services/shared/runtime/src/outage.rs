//! Waiting for a first worker, and through an outage of the router.

use std::sync::Arc;
use std::time::Duration;

use repose_proto::{CallError, ErrorCode, Service};
use tokio::time::Instant;

use crate::config::CallerConfig;
use crate::transport::Transport;

/// How often a call that waits for a worker looks whether the network is there.
pub(crate) const LOOK: Duration = Duration::from_millis(50);

/// How long a caller waits for a worker to appear.
pub(crate) struct Patience {
    transport: Arc<dyn Transport>,
    service: Service,
    worker_wait: Duration,
    return_wait: Duration,
}

impl Patience {
    pub(crate) fn new(transport: Arc<dyn Transport>, service: Service, config: &CallerConfig) -> Self {
        let (worker_wait, return_wait) = (Duration::from_millis(config.worker_wait_ms), Duration::from_millis(config.return_wait_ms));
        Self { transport, service, worker_wait, return_wait }
    }

    /// What is said where no worker appears.
    pub(crate) fn nobody(&self) -> CallError {
        CallError::new(ErrorCode::Unavailable, format!("no suitable {} worker is alive", self.service))
    }

    /// What is said where the deadline comes first: of the router, if it is away.
    pub(crate) fn at_deadline(&self, otherwise: CallError) -> CallError {
        if self.transport.connection().is_up {
            return otherwise;
        }
        let message = format!("the router was away until the deadline: no {} worker could be reached", self.service);
        CallError::new(ErrorCode::Unavailable, message)
    }

    /// Whether one that began to wait then has waited long enough. Workers come back a while after their router: they reconnect as we did.
    pub(crate) fn is_over(&self, began: Instant) -> bool {
        let connection = self.transport.connection();
        let bound = match connection.number {
            1 => began + self.worker_wait,
            _ => (began + self.worker_wait).max(connection.since + self.return_wait),
        };
        connection.is_up && Instant::now() >= bound
    }
}
