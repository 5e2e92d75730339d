//! The threads that a connection and all that came of it share.

use tokio::runtime::Runtime;

/// The network's threads, left to themselves at the end: dropping them must not wait.
pub struct Threads(Option<Runtime>);

impl Threads {
    /// Of a runtime.
    pub fn new(runtime: Runtime) -> Self {
        Self(Some(runtime))
    }

    /// The runtime to spawn on.
    pub fn handle(&self) -> Option<&tokio::runtime::Handle> {
        self.0.as_ref().map(Runtime::handle)
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}
