//! The threads that a connection and all that came of it share.

use repose_proto::CallError;
use tokio::runtime::{Handle, Runtime};

/// The network's threads, left to themselves at the end: dropping them must not wait.
pub struct Threads {
    runtime: Option<Runtime>,
    /// The process that they run in.
    process: u32,
}

impl Threads {
    /// Of a runtime.
    pub fn new(runtime: Runtime) -> Self {
        Self { runtime: Some(runtime), process: std::process::id() }
    }

    /// The runtime to spawn on.
    ///
    /// # Errors
    /// `failed_precondition` in a process that was forked from theirs: threads are not forked, and whoever waited for them would wait for ever.
    pub fn handle(&self) -> Result<&Handle, CallError> {
        let forked = || CallError::precondition("the connection belongs to the process that this one was forked from; connect anew");
        self.runtime.as_ref().filter(|_| self.are_here()).map(Runtime::handle).ok_or_else(forked)
    }

    fn are_here(&self) -> bool {
        self.process == std::process::id()
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        match self.runtime.take() {
            Some(runtime) if self.are_here() => runtime.shutdown_background(),
            // There are no threads here to end, and a lock that one of them held at the fork stays locked.
            elsewhere => std::mem::forget(elsewhere),
        }
    }
}
