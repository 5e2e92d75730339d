//! Where commands that talk to a running system run.

use crate::failure::{Failure, Outcome};

/// Zenoh needs Tokio's multi-threaded runtime.
pub fn in_runtime(command: impl Future<Output = Outcome>) -> Outcome {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(Failure::other)?;
    runtime.block_on(command)
}
