//! One word for "stop now" that a process, its services and their tasks share.

use tokio_util::sync::{CancellationToken, DropGuard};

use crate::RuntimeError;

/// Asked once, heard by every clone.
#[derive(Debug, Clone, Default)]
pub struct Shutdown(CancellationToken);

impl Shutdown {
    /// Not asked yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Asked by SIGTERM or SIGINT (elsewhere than on Unix, by Ctrl-C). A second signal ends the process as if nobody listened.
    ///
    /// # Errors
    /// When the signals cannot be listened to.
    pub fn on_signals() -> Result<Self, RuntimeError> {
        let mut signals =
            Signals::listen().map_err(|source| RuntimeError::System { operation: "listening for signals".to_owned(), source })?;
        let shutdown = Self::new();
        let asked = shutdown.clone();
        tokio::spawn(async move {
            for count in 0.. {
                let number = signals.next().await;
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

    /// Asks when what this returns is dropped.
    pub(crate) fn on_drop(&self) -> DropGuard {
        self.0.clone().drop_guard()
    }

    /// Whether it was asked.
    pub fn is_requested(&self) -> bool {
        self.0.is_cancelled()
    }

    /// Waits until it is asked.
    pub async fn requested(&self) {
        self.0.cancelled().await;
    }

    /// The same for those who know tokens: it is cancelled when this is asked.
    pub fn token(&self) -> CancellationToken {
        self.0.child_token()
    }

    /// A shutdown that this one triggers, and that can be triggered alone.
    #[must_use]
    pub fn child(&self) -> Self {
        Self(self.0.child_token())
    }
}

/// The signals that ask a process to stop.
#[cfg(unix)]
struct Signals {
    terminate: tokio::signal::unix::Signal,
    interrupt: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    fn listen() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self { terminate: signal(SignalKind::terminate())?, interrupt: signal(SignalKind::interrupt())? })
    }

    /// The number of the next one.
    async fn next(&mut self) -> i32 {
        tokio::select! {
            _ = self.terminate.recv() => libc::SIGTERM,
            _ = self.interrupt.recv() => libc::SIGINT,
        }
    }
}

/// Ctrl-C, where there are no signals.
#[cfg(not(unix))]
struct Signals;

#[cfg(not(unix))]
impl Signals {
    fn listen() -> std::io::Result<Self> {
        Ok(Self)
    }

    async fn next(&mut self) -> i32 {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
        2
    }
}
