//! A session on somebody else's key space: keys, payloads and attachments as they are, none of them ours.
//!
//! For bridges: a ROS 2 system over `rmw_zenoh` has its own keys, encodings and liveliness tokens. Nothing is interpreted here; receiving
//! threads never block, buffers are bounded, and what must wait for room does so on threads that may.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, QueryTarget, ReplyKeyExpr};
use zenoh::sample::SampleKind;

use crate::RuntimeError;
use crate::config::SessionConfig;
use crate::mailbox::{MailboxReceiver, mailbox};
use crate::transport::{AliveWatch, Guard, Transport};
use crate::zenoh_session::watch_certificates;
use crate::zenoh_transport::{CancelOnDrop, ZenohTransport, bytes_of, send};

/// Replies of one query that may wait to be read.
const REPLIES: usize = 64;

/// A message on somebody else's key.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RawMessage {
    /// The key that it was put to or answers.
    pub key: String,
    /// Its bytes.
    pub payload: Bytes,
    /// Its attachment; empty without one.
    pub attachment: Bytes,
}

/// A message of a subscription.
#[derive(Debug, Clone)]
pub struct Arrived {
    /// What came.
    pub message: RawMessage,
    /// When it came, on the receiving thread: however long it waits then, this is its age.
    pub arrived: Instant,
}

/// The recipients of a query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum QueryRecipients {
    /// Everybody who serves exactly the key.
    Servers,
    /// Everybody who serves something that the key meets, whatever key they answer under: caches of past messages.
    Caches,
}

/// What happens to a message where there is no room for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Room {
    /// It waits.
    Wait,
    /// It is dropped.
    Drop,
}

/// A connection whose keys are not ours. Cheap to clone.
#[derive(Clone)]
pub struct RawSession {
    transport: Arc<ZenohTransport>,
}

impl RawSession {
    /// Opens a session; the cell of the configuration does not matter.
    ///
    /// # Errors
    /// When the configuration is unusable or the network cannot be reached.
    pub async fn open(config: &SessionConfig) -> Result<Self, RuntimeError> {
        watch_certificates(config)?;
        Ok(Self { transport: Arc::new(ZenohTransport::open(config).await?) })
    }

    /// The session's own id, hexadecimal.
    pub fn id(&self) -> String {
        self.transport.session.zid().to_string()
    }

    /// Where others can connect to.
    pub async fn locators(&self) -> Vec<String> {
        self.transport.locators().await
    }

    /// Puts a message.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn put(&self, message: RawMessage, room: Room) -> Result<(), RuntimeError> {
        let session = self.transport.session.clone();
        let congestion = match room {
            Room::Wait => CongestionControl::Block,
            Room::Drop => CongestionControl::Drop,
        };
        send("putting", room == Room::Wait, move || {
            let put = session.put(message.key, message.payload).congestion_control(congestion);
            put.attachment(attached(message.attachment)).wait()
        })
        .await
    }

    /// Subscribes with room for `capacity` messages; the oldest is dropped and counted when there is no room.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn subscribe(&self, key: &str, capacity: usize) -> Result<RawSubscription, RuntimeError> {
        let (sender, messages) = mailbox(capacity);
        let subscriber = self
            .transport
            .session
            .declare_subscriber(key.to_owned())
            .callback(move |sample| {
                if sample.kind() == SampleKind::Put {
                    let arrived = Instant::now();
                    sender.push(Arrived { message: message_of(&sample), arrived });
                }
            })
            .await
            .map_err(|e| RuntimeError::transport(format!("subscribing to {key}"), e))?;
        Ok(RawSubscription { messages, _declaration: Box::new(subscriber) })
    }

    /// Asks whoever serves a key. The stream ends with the last answer, at once where there is nobody, and after `timeout` at the latest.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn query(&self, asked: QueryRecipients, message: RawMessage, timeout: Duration) -> Result<RawReplies, RuntimeError> {
        let (sender, replies) = mailbox(REPLIES);
        let token = zenoh::cancellation::CancellationToken::default();
        // From here on: one that is given up while it waits for room is not sent, or is forgotten.
        let forgetting = CancelOnDrop(token.clone());
        let (session, cancel) = (self.transport.session.clone(), token);
        let (target, keys) = match asked {
            QueryRecipients::Servers => (QueryTarget::AllComplete, ReplyKeyExpr::MatchingQuery),
            QueryRecipients::Caches => (QueryTarget::All, ReplyKeyExpr::Any),
        };
        send("querying", true, move || {
            session
                .get(message.key)
                .target(target)
                .accept_replies(keys)
                .consolidation(ConsolidationMode::None)
                .congestion_control(CongestionControl::Block)
                .timeout(timeout)
                .payload(message.payload)
                .attachment(attached(message.attachment))
                .cancellation_token(cancel)
                .callback(move |reply| {
                    if let Ok(sample) = reply.result() {
                        sender.push(message_of(sample));
                    }
                })
                .wait()
        })
        .await?;
        Ok(RawReplies { replies, _query: Box::new(forgetting) })
    }

    /// Serves a key, as one who answers for all of it: at most `capacity` queries wait to be taken, the next are let go.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn serve(&self, key: &str, capacity: usize) -> Result<RawQueries, RuntimeError> {
        let (sender, queries) = mailbox(capacity);
        let queryable = self
            .transport
            .session
            .declare_queryable(key.to_owned())
            .complete(true)
            .callback(move |query| {
                let message = RawMessage {
                    key: query.key_expr().to_string(),
                    payload: query.payload().map(bytes_of).unwrap_or_default(),
                    attachment: query.attachment().map(bytes_of).unwrap_or_default(),
                };
                drop(sender.try_push(RawQuery { message, query: Arc::new(query) }));
            })
            .await
            .map_err(|e| RuntimeError::transport(format!("serving {key}"), e))?;
        Ok(RawQueries { queries, _declaration: Box::new(queryable) })
    }

    /// Declares a liveliness token, which everyone sees vanish when the guard, the session or the process goes.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn declare_alive(&self, key: &str) -> Result<Guard, RuntimeError> {
        self.transport.declare_alive(key).await
    }

    /// Watches the liveliness tokens that match a key.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn watch_alive(&self, key: &str) -> Result<AliveWatch, RuntimeError> {
        self.transport.watch_alive(key).await
    }

    /// Closes every declaration and link.
    ///
    /// # Errors
    /// When that takes longer than `bound`.
    pub async fn close(&self, bound: Duration) -> Result<(), RuntimeError> {
        self.transport.close(bound).await
    }
}

/// A subscription with a bounded buffer that drops the oldest.
pub struct RawSubscription {
    messages: MailboxReceiver<Arrived>,
    _declaration: Guard,
}

impl RawSubscription {
    /// The next message, or none when the session has closed. Cancel safe.
    pub async fn recv(&mut self) -> Option<Arrived> {
        self.messages.recv().await
    }

    /// How many messages were dropped because nobody took them in time.
    pub fn dropped(&self) -> u64 {
        self.messages.dropped()
    }
}

/// The answers to one query. Dropping it forgets the query.
pub struct RawReplies {
    replies: MailboxReceiver<RawMessage>,
    _query: Guard,
}

impl RawReplies {
    /// The next answer, or none at the end. Cancel safe.
    pub async fn next(&mut self) -> Option<RawMessage> {
        self.replies.recv().await
    }
}

/// The queries to one key.
pub struct RawQueries {
    queries: MailboxReceiver<RawQuery>,
    _declaration: Guard,
}

impl RawQueries {
    /// The next query, or none when the session has closed. Cancel safe.
    pub async fn next(&mut self) -> Option<RawQuery> {
        self.queries.recv().await
    }
}

/// A query that arrived. Dropping it ends its sender's stream.
pub struct RawQuery {
    /// What came.
    pub message: RawMessage,
    query: Arc<zenoh::query::Query>,
}

impl RawQuery {
    /// Answers under the query's own key.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn reply(self, payload: Bytes, attachment: Bytes) -> Result<(), RuntimeError> {
        let query = self.query;
        send("replying", true, move || {
            let key = query.key_expr().clone();
            query.reply(key, payload).attachment(attached(attachment)).wait()
        })
        .await
    }
}

fn attached(attachment: Bytes) -> Option<ZBytes> {
    (!attachment.is_empty()).then(|| ZBytes::from(attachment))
}

fn message_of(sample: &zenoh::sample::Sample) -> RawMessage {
    RawMessage {
        key: sample.key_expr().to_string(),
        payload: bytes_of(sample.payload()),
        attachment: sample.attachment().map(bytes_of).unwrap_or_default(),
    }
}
