//! Waiting for a first worker, and through an outage of the router.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use repose_proto::{CallError, ErrorCode, keys};
use tokio::time::Instant;

use crate::config::CallerConfig;
use crate::target::Target;
use crate::transport::Transport;

/// How often a call that waits for a worker looks whether the network is there.
pub(crate) const LOOK: Duration = Duration::from_millis(50);
/// The longest wait for a pool: its name may be wrong, and who has it so is told within a second.
const POOL_WAIT: Duration = Duration::from_millis(600);
/// How long it may take to find out which others there are.
const NAMES_WITHIN: Duration = Duration::from_millis(300);

/// How long a caller waits for a worker to appear.
pub(crate) struct Patience {
    transport: Arc<dyn Transport>,
    target: Target,
    worker_wait: Duration,
    return_wait: Duration,
}

impl Patience {
    pub(crate) fn new(transport: Arc<dyn Transport>, target: Target, config: &CallerConfig) -> Self {
        let (mut worker_wait, return_wait) = (Duration::from_millis(config.worker_wait_ms), Duration::from_millis(config.return_wait_ms));
        if target.on_behalf_of.is_some() {
            worker_wait = worker_wait.min(POOL_WAIT);
        }
        Self { transport, target, worker_wait, return_wait }
    }

    /// What is said where no worker appears; of a pool, also where there are some.
    pub(crate) async fn nobody(&self) -> CallError {
        let error = CallError::new(ErrorCode::Unavailable, format!("no suitable worker of {} is alive", self.target));
        if self.target.on_behalf_of.is_none() {
            return error;
        }
        // Access control shows a user no other cells, which does not mean that there are none.
        if self.transport.is_user() {
            return error.at("pool");
        }
        let elsewhere = self.cells_with_workers().await.into_iter().filter(|cell| cell != self.target.workers_in.name());
        let elsewhere = elsewhere.collect::<Vec<_>>().join(", ");
        let others = if elsewhere.is_empty() { "none" } else { &elsewhere };
        CallError { message: format!("{}; pools and cells that have one: {others}", error.message), ..error.at("pool") }
    }

    async fn cells_with_workers(&self) -> BTreeSet<String> {
        let lives = keys::lives_everywhere(self.target.service);
        match tokio::time::timeout(NAMES_WITHIN, self.transport.watch_alive(&lives)).await {
            Ok(Ok(mut alive)) => alive.current().iter().filter_map(|key| Some(keys::of_live(key)?.0.to_owned())).collect(),
            _ => BTreeSet::new(),
        }
    }

    /// What is said where the deadline comes first: of the router, if it is away.
    pub(crate) fn at_deadline(&self, otherwise: CallError) -> CallError {
        if self.transport.connection().is_up {
            return otherwise;
        }
        let message = format!("the router was away until the deadline: no worker of {} could be reached", self.target);
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
