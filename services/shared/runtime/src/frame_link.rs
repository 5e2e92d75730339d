//! The session by which a client's frames go, beside the one for all else.
//!
//! What must not be lost waits for room on a link, and a link on which it waits too long is closed, with everything that goes by it: a camera on a slow
//! network would take its robot's stop with it. And as long as a message waits, Zenoh cannot give up the link of a router that has died; when both have
//! ended it, its client looks for a router twice, and the second search never ends, since the first has found one. So frames go by a session on which
//! each part of a frame waits for a moment. What does not get through is dropped: the next frame is newer.

use std::time::Duration;

use tokio::sync::OnceCell;

use crate::RuntimeError;
use crate::config::{SessionConfig, SessionMode};
use crate::zenoh_session::{open_session, zenoh_config};

/// How long each part of a frame, 64 KiB, waits for room: links of 5 Mbit/s carry frames.
const PART_WAIT: Duration = Duration::from_millis(100);

/// Opens the session when the first frame is put.
pub(crate) struct FrameLink {
    config: SessionConfig,
    session: OnceCell<zenoh::Session>,
}

impl FrameLink {
    /// None where frames go by the same session: without a router there is nothing to reconnect to.
    pub(crate) fn of(config: &SessionConfig) -> Option<Self> {
        (config.mode == SessionMode::Client).then(|| Self { config: config.clone(), session: OnceCell::new() })
    }

    /// The session.
    ///
    /// # Errors
    /// As for opening any other.
    pub(crate) async fn session(&self) -> Result<&zenoh::Session, RuntimeError> {
        self.session.get_or_try_init(|| self.open()).await
    }

    /// The session if there was a frame.
    pub(crate) fn opened(&self) -> Option<&zenoh::Session> {
        self.session.get()
    }

    async fn open(&self) -> Result<zenoh::Session, RuntimeError> {
        let mut zenoh_config = zenoh_config(&self.config)?;
        let waits = [("wait_before_drop", PART_WAIT), ("max_wait_before_drop_fragments", Duration::from_millis(self.config.lease_ms))];
        for (key, wait) in waits {
            zenoh_config
                .insert_json5(&format!("transport/link/tx/queue/congestion_control/drop/{key}"), &wait.as_micros().to_string())
                .map_err(|e| RuntimeError::transport(format!("setting {key} for frames"), e))?;
        }
        open_session(&self.config, zenoh_config).await
    }
}
