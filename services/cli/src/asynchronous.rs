//! Where commands that talk to a running system run.

use crate::failure::{CommandResult, Failure};

/// Zenoh needs Tokio's multi-threaded runtime.
pub fn in_runtime(command: impl Future<Output = CommandResult>) -> CommandResult {
    // Before there are threads: they inherit it, Zenoh's too.
    repose_runtime::prefer_messages();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(Failure::other)?;
    runtime.block_on(command)
}
