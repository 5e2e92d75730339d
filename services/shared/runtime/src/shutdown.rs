//! One word for "stop now" that a process, its services and their tasks share.

use tokio_util::sync::CancellationToken;

use crate::RuntimeError;

/// Asked once, heard by every clone.
#[derive(Debug, Clone, Default)]
pub struct Shutdown(CancellationToken);

impl Shutdown {
    /// Not asked yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Asked by SIGTERM or SIGINT. A second signal ends the process as if nobody listened.
    ///
    /// # Errors
    /// When the signals cannot be listened to.
    pub fn on_signals() -> Result<Self, RuntimeError> {
        use tokio::signal::unix::{SignalKind, signal};
        let listen = |kind| signal(kind).map_err(|source| RuntimeError::System { operation: "listening for signals".to_owned(), source });
        let (mut terminate, mut interrupt) = (listen(SignalKind::terminate())?, listen(SignalKind::interrupt())?);
        let shutdown = Self::new();
        let asked = shutdown.clone();
        tokio::spawn(async move {
            for count in 0.. {
                let number = tokio::select! {
                    _ = terminate.recv() => libc::SIGTERM,
                    _ = interrupt.recv() => libc::SIGINT,
                };
                if count > 0 {
                    // The conventional status of a process that a signal ended.
                    std::process::exit(128 + number);
                }
                tracing::info!("asked to stop");
                asked.trigger();
            }
        });
        Ok(shutdown)
    }

    /// Asks.
    pub fn trigger(&self) {
        self.0.cancel();
    }

    /// Whether it was asked.
    pub fn is_requested(&self) -> bool {
        self.0.is_cancelled()
    }

    /// Waits until it is asked.
    pub async fn requested(&self) {
        self.0.cancelled().await;
    }

    /// A shutdown that this one triggers, and that can be triggered alone.
    #[must_use]
    pub fn child(&self) -> Self {
        Self(self.0.child_token())
    }
}
