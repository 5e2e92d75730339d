//! The two ends of everything that is tried: sessions of every user, and how one knows that the router has dealt with what they sent.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures::future::{join_all, try_join_all};
use repose_proto::{Cell, Payload, Priority, Service};

use super::files::trial_file_of_user;
use super::roles::Roles;
use crate::transport::{OutgoingQuery, ReplyEvent, Transport};
use crate::zenoh_transport::ZenohTransport;
use crate::{RuntimeConfig, RuntimeError, Session, SessionMode};

/// How long the router may take to answer, and what is allowed to come through.
pub(super) const PATIENCE: Duration = Duration::from_secs(5);
/// How much longer than the network a question waits for its end: a trial ends, whatever the network does.
const MARGIN: Duration = Duration::from_secs(1);

/// How long a silent link is believed in: a trial judges rules, not links, and on a busy machine dozens of sessions open at once.
const LEASE_MS: u64 = 10_000;

/// A client's session with a Zenoh file.
async fn open(endpoint: &str, file: PathBuf) -> Result<Session, RuntimeError> {
    let mut config = RuntimeConfig::default();
    config.session.mode = SessionMode::Client;
    config.session.zenoh_file = Some(file);
    config.session.connect = vec![in_one_stream(endpoint)];
    config.session.lease_ms = LEASE_MS;
    // Not as a session of this process: the report says once when everybody's certificates expire.
    let transport = Arc::new(ZenohTransport::open(&config.session).await?);
    Session::over(transport, config)
}

/// The endpoint, with one stream for all priorities where QUIC would have one each: what is sent arrives in order then, declarations too.
fn in_one_stream(endpoint: &str) -> String {
    if !endpoint.starts_with("quic/") {
        return endpoint.to_owned();
    }
    let (address, config) = endpoint.split_at(endpoint.find('#').unwrap_or(endpoint.len()));
    let separator = if address.contains('?') { ';' } else { '?' };
    format!("{address}{separator}multistream=0{config}")
}

async fn close(session: &Session) {
    if let Err(error) = session.close().await {
        tracing::debug!(%error, "a session of the trial did not close in time");
    }
}

/// Two sessions of a user: one that tries, and one at the other end.
struct UserSessions {
    tries: Arc<dyn Transport>,
    witness: Arc<dyn Transport>,
}

/// The sessions of every user.
pub(super) struct TrialSessions {
    sessions: Vec<Session>,
    of_users: BTreeMap<String, UserSessions>,
    /// A key that nobody serves.
    nowhere: String,
}

impl TrialSessions {
    /// Opens them with the files in the folder of a trial.
    pub(super) async fn open(roles: &Roles, endpoint: &str, trial: &Path) -> Result<Self, RuntimeError> {
        let session = |name: &String| open(endpoint, trial_file_of_user(trial, name));
        let opened = roles.users.keys().map(|name| async move { tokio::try_join!(session(name), session(name)) });
        let (mut sessions, mut of_users) = (Vec::new(), BTreeMap::new());
        for (name, (tries, witness)) in roles.users.keys().zip(try_join_all(opened).await?) {
            of_users.insert(name.clone(), UserSessions { tries: tries.transport(), witness: witness.transport() });
            sessions.extend([tries, witness]);
        }
        let cell = Cell::new("check").map_err(|e| RuntimeError::transport("naming the trial's cell", e))?;
        Ok(Self { sessions, of_users, nowhere: cell.call(Service::Inference, "check-nobody") })
    }

    pub(super) async fn close(self) {
        join_all(self.sessions.iter().map(close)).await;
    }

    /// The session with which a user tries.
    pub(super) fn tries(&self, user: &str) -> &dyn Transport {
        self.of_users[user].tries.as_ref()
    }

    /// The session with which a user is at the other end.
    pub(super) fn witness(&self, user: &str) -> &dyn Transport {
        self.of_users[user].witness.as_ref()
    }

    /// Whether the router has dealt with everything that a session has sent, and the session with everything that the router had sent it by then.
    ///
    /// A query that the router refuses, or knows nobody for, it ends itself, at once. Everything goes by one stream in each direction, and of what
    /// waits there the least urgent goes last: a query of the lowest priority is behind all that was sent before it, and its end likewise.
    pub(super) async fn settle(&self, session: &dyn Transport) -> Result<bool, RuntimeError> {
        Ok(ask(session, &self.nowhere).await? == QueryEnd::Ended)
    }
}

/// How a query ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum QueryEnd {
    /// Somebody replied: who.
    Replied(String),
    /// Nobody did, and nobody will.
    Ended,
    /// It was given up.
    TimedOut,
}

/// Asks at a key.
pub(super) async fn ask(transport: &dyn Transport, key: &str) -> Result<QueryEnd, RuntimeError> {
    let query = OutgoingQuery { payload: note("?"), attachment: Bytes::new(), priority: Priority::Batch, timeout: PATIENCE };
    let asked = async { Ok::<_, RuntimeError>(transport.query(key, query).await?.next().await) };
    let Ok(answered) = tokio::time::timeout(PATIENCE + MARGIN, asked).await else {
        tracing::warn!(key, "a question has no end");
        return Ok(QueryEnd::TimedOut);
    };
    Ok(match answered? {
        Some(ReplyEvent::Reply { payload, .. }) => QueryEnd::Replied(String::from_utf8_lossy(&payload.bytes).into_owned()),
        Some(ReplyEvent::TimedOut) => QueryEnd::TimedOut,
        None => QueryEnd::Ended,
    })
}

/// A message of the trial.
pub(super) fn note(text: &str) -> Payload {
    Payload { encoding: String::new(), bytes: Bytes::copy_from_slice(text.as_bytes()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trial_goes_by_one_stream_and_leaves_the_rest_of_an_endpoint_as_it_is() {
        assert_eq!(in_one_stream("quic/a.example:7447"), "quic/a.example:7447?multistream=0");
        assert_eq!(in_one_stream("quic/a.example:7447#bind=0.0.0.0:0"), "quic/a.example:7447?multistream=0#bind=0.0.0.0:0");
        assert_eq!(in_one_stream("quic/a.example:7447?rel=1"), "quic/a.example:7447?rel=1;multistream=0");
        assert_eq!(in_one_stream("tcp/a.example:7447"), "tcp/a.example:7447");
    }
}
