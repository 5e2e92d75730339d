//! Unique worker names: two processes under one name would share calls and cancels, so the younger one stops.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use repose_proto::load::WorkerLoad;
use repose_proto::{Cell, Service};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::RuntimeError;
use crate::config::WorkerConfig;
use crate::transport::{Sample, Subscription, Transport};

/// Loads under a worker's name that may wait to be looked at.
pub(crate) const NAMESAKE_CAPACITY: usize = 8;

/// The error of a worker whose name another one has.
pub(crate) fn taken(service: Service, worker: &str) -> RuntimeError {
    RuntimeError::NameTaken { service, worker: worker.to_owned() }
}

/// A name under which no load was told for this many of its periods has nobody who drains.
const SILENT_PERIODS: u32 = 2;

/// Waits until nobody has a name. The token of a process that has died goes within its lease. One that drains has no token any more, but takes the calls
/// that come to the name, to refuse them, until it has ended; it tells its load until then.
pub(crate) async fn wait_until_free(
    transport: &dyn Transport,
    cell: &Cell,
    service: Service,
    worker: &str,
    config: &WorkerConfig,
) -> Result<(), RuntimeError> {
    let mut loads = transport.subscribe(&cell.load(service, worker), NAMESAKE_CAPACITY).await?;
    let mut alive = transport.watch_alive(&cell.live(service, worker)).await?;
    let bound = Instant::now() + Duration::from_millis(config.name_wait_ms);
    let no_token = async {
        while !alive.current().is_empty() {
            if !alive.changed().await {
                return;
            }
        }
    };
    tokio::time::timeout_at(bound, no_token).await.map_err(|_| taken(service, worker))?;
    let silence = Duration::from_millis(config.load_period_ms) * SILENT_PERIODS;
    while let Ok(Some(sample)) = tokio::time::timeout(silence, loads.recv()).await {
        // A drain ends by itself, in a time of its own.
        if !is_draining(&sample) && Instant::now() >= bound {
            return Err(taken(service, worker));
        }
    }
    Ok(())
}

fn is_draining(sample: &Sample) -> bool {
    sample.payload.decode_json::<WorkerLoad>().is_ok_and(|load| load.draining)
}

/// Looks at the loads told under this worker's name, for two that started at once and did not see each other. `loads_told` counts this
/// worker's: one that counts further is of another process, which is the older. Triggers `name_taken` then, unless that one is about to end.
pub(crate) async fn find(mut loads: Subscription, loads_told: Arc<AtomicU64>, name_taken: CancellationToken) {
    while let Some(sample) = loads.recv().await {
        let Ok(load) = sample.payload.decode_json::<WorkerLoad>() else { continue };
        if load.seq > loads_told.load(Ordering::Acquire) && !load.draining {
            tracing::error!(key = sample.key, "another process serves under this name and was there first: this one stops");
            name_taken.cancel();
            return;
        }
    }
}
