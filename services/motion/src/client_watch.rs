//! Whether the client of an execution is still there.
//!
//! A client that wants its execution stopped when it dies holds a liveliness token named after its request, from before the call to its end. The
//! network takes the token back when the client's session goes, however it goes. A client that holds none cannot be missed.

use repose_proto::keys;
use repose_runtime::{Session, transport::AliveWatch};

/// The token of one request's client.
pub struct ClientWatch {
    key: String,
    alive: AliveWatch,
}

impl ClientWatch {
    /// Looks for the token of a request; none when its client holds none.
    pub async fn of(session: &Session, request: &str) -> Option<Self> {
        keys::validate_chunk("id", request).ok()?;
        let key = session.cell().live_client(request);
        let mut alive = match session.transport().watch_alive(&key).await {
            Ok(alive) => alive,
            Err(error) => {
                tracing::warn!(request, %error, "whether the client is there cannot be seen");
                return None;
            }
        };
        alive.current().contains(&key).then_some(Self { key, alive })
    }

    /// Waits until the client is gone.
    pub async fn gone(&mut self) {
        while self.alive.current().contains(&self.key) {
            if !self.alive.changed().await {
                return;
            }
        }
    }
}
