//! Unique worker names: two processes under one name would share calls and cancels, so the younger one stops.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use repose_proto::load::WorkerLoad;
use repose_proto::{Cell, Service};
use tokio_util::sync::CancellationToken;

use crate::RuntimeError;
use crate::transport::{Subscription, Transport};

/// The error of a worker whose name another one has.
pub(crate) fn taken(service: Service, worker: &str) -> RuntimeError {
    RuntimeError::NameTaken { service, worker: worker.to_owned() }
}

/// Waits until no token of that name is there: that of a process that has died goes within its lease.
pub(crate) async fn wait_until_free(
    transport: &dyn Transport,
    cell: &Cell,
    service: Service,
    worker: &str,
    bound: Duration,
) -> Result<(), RuntimeError> {
    let mut alive = transport.watch_alive(&cell.live(service, worker)).await?;
    let free = async {
        while !alive.current().is_empty() {
            if !alive.changed().await {
                return;
            }
        }
    };
    tokio::time::timeout(bound, free).await.map_err(|_| taken(service, worker))
}

/// Looks at the loads told under this worker's name, for two that started at once and did not see each other. `loads_told` counts this
/// worker's: one that counts further is of another process, which is the older. Triggers `name_taken` then.
pub(crate) async fn find(mut loads: Subscription, loads_told: Arc<AtomicU64>, name_taken: CancellationToken) {
    while let Some(sample) = loads.recv().await {
        let Ok(load) = sample.payload.decode_json::<WorkerLoad>() else { continue };
        if load.seq > loads_told.load(Ordering::Acquire) {
            tracing::error!(key = sample.key, "another process serves under this name and was there first: this one stops");
            name_taken.cancel();
            return;
        }
    }
}
