//! The small interface that callers, workers and publishers sit on, so that a fake network can stand in for Zenoh in tests.
//!
//! Semantics that both implementations keep: a query reaches the one worker that serves its key; its replies arrive in order;
//! the stream ends when the worker has let go of the query, or at once when there is no such worker or it dies; nothing here blocks a
//! receiving thread, and every buffer is bounded.

use std::collections::BTreeSet;
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use repose_proto::{Payload, Priority};
use tokio::sync::watch;
use tokio::time::Instant;

use crate::RuntimeError;
use crate::mailbox::MailboxReceiver;

/// What a message is, which decides its priority and what happens under congestion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Traffic {
    /// Before everything; waits for room, never dropped.
    EmergencyStop,
    /// Before everything else; dropped when it would be late.
    RobotCommand,
    /// High; dropped under congestion, the next one comes soon.
    RobotState,
    /// Low; waits for a moment, and is dropped where that is not enough: the next frame is newer.
    Frame,
    /// High; waits for room.
    Scene,
    /// Calls, their replies and cancels; waits for room.
    Call(Priority),
    /// Copies for whoever records: below calls; dropped where a link or a recorder does not keep up, which shows in their numbers.
    Journal,
    /// Lowest; dropped under congestion.
    Load,
}

/// A call on its way out.
#[derive(Debug, Clone)]
pub struct OutgoingQuery {
    /// The request.
    pub payload: Payload,
    /// Its attachment.
    pub attachment: Bytes,
    /// Who waits.
    pub priority: Priority,
    /// When the transport gives the query up.
    pub timeout: Duration,
}

/// What comes back on a query. After the last of these the stream ends.
#[derive(Debug)]
pub enum ReplyEvent {
    /// A reply.
    Reply {
        /// The reply's message.
        payload: Payload,
        /// Its attachment; empty without one.
        attachment: Bytes,
    },
    /// The transport gave the query up.
    TimedOut,
}

/// Held for as long as something is declared; dropping it takes the declaration back.
pub type Guard = Box<dyn Send + Sync>;

/// The replies of one query. Dropping it forgets the query: later replies go nowhere.
pub struct ReplyStream {
    pub(crate) replies: MailboxReceiver<ReplyEvent>,
    pub(crate) _query: Guard,
}

impl ReplyStream {
    /// The next reply, or none at the end. Cancel safe.
    pub async fn next(&mut self) -> Option<ReplyEvent> {
        self.replies.recv().await
    }
}

/// The way back of one incoming query. Dropping it ends the caller's stream.
#[async_trait]
pub trait Replier: Send + Sync {
    /// Sends one reply.
    ///
    /// # Errors
    /// When the network refuses; the caller then sees the stream end.
    async fn reply(&self, payload: Payload, attachment: Bytes) -> Result<(), RuntimeError>;
}

/// A call that arrived.
pub struct IncomingQuery {
    /// The key that it was sent to, one of those served.
    pub key: String,
    /// The request; an empty encoding and no bytes where the caller sent none.
    pub payload: Payload,
    /// Its attachment; empty without one.
    pub attachment: Bytes,
    /// The way back.
    pub replier: Box<dyn Replier>,
}

/// The calls to one key.
pub struct IncomingQueries {
    pub(crate) queries: MailboxReceiver<IncomingQuery>,
    pub(crate) _declaration: Guard,
}

impl IncomingQueries {
    /// The next call, or none when the transport has closed. Cancel safe.
    pub async fn next(&mut self) -> Option<IncomingQuery> {
        self.queries.recv().await
    }
}

/// A message of a subscription.
#[derive(Debug, Clone)]
pub struct Sample {
    /// The key that it was put to.
    pub key: String,
    /// The message.
    pub payload: Payload,
}

/// A subscription with a bounded buffer that drops the oldest.
pub struct Subscription {
    pub(crate) samples: MailboxReceiver<Sample>,
    pub(crate) _declaration: Guard,
}

impl Subscription {
    /// The next message, or none when the transport has closed. Cancel safe.
    pub async fn recv(&mut self) -> Option<Sample> {
        self.samples.recv().await
    }

    /// The next message if one is there.
    pub fn try_recv(&mut self) -> Option<Sample> {
        self.samples.try_recv()
    }

    /// How many messages were dropped because nobody took them in time.
    pub fn dropped(&self) -> u64 {
        self.samples.dropped()
    }
}

/// The liveliness tokens that match a key, kept up to date.
pub struct AliveWatch {
    pub(crate) keys: watch::Receiver<BTreeSet<String>>,
    pub(crate) _declaration: Guard,
}

impl AliveWatch {
    /// The keys alive now.
    pub fn current(&mut self) -> BTreeSet<String> {
        self.keys.borrow_and_update().clone()
    }

    /// Waits until that has changed; false when the transport has closed. Cancel safe.
    pub async fn changed(&mut self) -> bool {
        self.keys.changed().await.is_ok()
    }
}

/// Whether this session is connected to the network, and since when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConnectionStatus {
    /// Whether it can now. A client without its router cannot.
    pub is_up: bool,
    /// Since when that is so.
    pub since: Instant,
    /// How often it has come up: the same number twice says that it never went away between.
    pub number: u64,
}

/// A network.
#[async_trait]
pub trait Transport: Send + Sync + 'static {
    /// Sends a query to the one worker that serves `key`.
    ///
    /// # Errors
    /// When the network refuses. A worker that is not there is no error: the stream ends at once.
    async fn query(&self, key: &str, query: OutgoingQuery) -> Result<ReplyStream, RuntimeError>;

    /// Serves `key`, which may have `*` for chunks: at most `capacity` calls wait to be taken; the next are let go, which their callers see as a
    /// stream that ends.
    ///
    /// # Errors
    /// When the network refuses.
    async fn serve(&self, key: &str, capacity: usize) -> Result<IncomingQueries, RuntimeError>;

    /// Puts a message.
    ///
    /// # Errors
    /// When the message is larger than a message may be, or the network refuses.
    async fn put(&self, key: &str, payload: Payload, traffic: Traffic) -> Result<(), RuntimeError>;

    /// Puts messages one after the other, as quickly as they can go; gives up at the first that is refused.
    ///
    /// # Errors
    /// As [`Transport::put`].
    async fn put_all(&self, key: &str, payloads: Vec<Payload>, traffic: Traffic) -> Result<(), RuntimeError> {
        for payload in payloads {
            self.put(key, payload, traffic).await?;
        }
        Ok(())
    }

    /// Subscribes with room for `capacity` messages; 1 keeps the newest only.
    ///
    /// # Errors
    /// When the network refuses.
    async fn subscribe(&self, key: &str, capacity: usize) -> Result<Subscription, RuntimeError>;

    /// Declares a liveliness token, which everyone sees vanish when the guard, the session or the process goes.
    ///
    /// # Errors
    /// When the network refuses.
    async fn declare_alive(&self, key: &str) -> Result<Guard, RuntimeError>;

    /// Watches the liveliness tokens that match `key`. Those declared before are in it when this returns.
    ///
    /// # Errors
    /// When the network refuses.
    async fn watch_alive(&self, key: &str) -> Result<AliveWatch, RuntimeError>;

    /// Whether this end is let in as a user, who sees some cells only.
    fn is_user(&self) -> bool {
        false
    }

    /// Whether messages get through now, as far as this end knows.
    fn connection(&self) -> ConnectionStatus;

    /// The locators that others can connect to.
    async fn locators(&self) -> Vec<String>;

    /// Closes every declaration and link.
    ///
    /// # Errors
    /// When that takes longer than `bound`.
    async fn close(&self, bound: Duration) -> Result<(), RuntimeError>;
}
