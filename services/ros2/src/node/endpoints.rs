//! The node, and what it publishes and subscribes to.

use std::marker::PhantomData;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use repose_ros_messages::{decode, encode};
use repose_runtime::raw::{Arrived, QueryRecipients, RawMessage, RawSession, RawSubscription, Room};
use repose_runtime::{Guard, SessionConfig, now_ns};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use crate::error::BridgeError;
use crate::wire::attachment::Attachment;
use crate::wire::names::{self, Qos};
use crate::wire::token::{EntityKind, NodeName};
use crate::wire::type_hash::{TypeName, type_named};

/// How long past messages may take to arrive.
const HISTORY: Duration = Duration::from_secs(5);

/// A node. Cheap to clone; it is gone for others when the last clone is.
#[derive(Clone)]
pub struct Node {
    inner: Arc<Inner>,
}

struct Inner {
    session: RawSession,
    name: NodeName,
    endpoints: AtomicU64,
    _token: Guard,
}

/// An endpoint that others see, and by which they know who sent something.
pub(super) struct Declared {
    pub key: String,
    pub gid: [u8; 16],
    _token: Guard,
}

impl Node {
    /// Joins a system of ROS 2.
    ///
    /// # Errors
    /// When its router cannot be reached or refuses.
    pub async fn join(session: &SessionConfig, domain: u32, namespace: &str, name: &str) -> Result<Self, BridgeError> {
        let session = RawSession::open(session).await?;
        let name = NodeName { domain, session: session.id(), namespace: namespace.to_owned(), name: name.to_owned() };
        let token = session.declare_alive(&name.token()).await?;
        Ok(Self { inner: Arc::new(Inner { session, name, endpoints: AtomicU64::new(1), _token: token }) })
    }

    /// The session below.
    pub fn session(&self) -> &RawSession {
        &self.inner.session
    }

    /// The domain.
    pub fn domain(&self) -> u32 {
        self.inner.name.domain
    }

    /// A name of the node's own, `/repose/stop`.
    pub fn own(&self, name: &str) -> String {
        let NodeName { namespace, name: node, .. } = &self.inner.name;
        format!("{}/{node}/{name}", namespace.trim_end_matches('/'))
    }

    /// Shows an endpoint to others.
    pub(super) async fn declare(&self, kind: EntityKind, name: &str, of: &TypeName, qos: Qos) -> Result<Declared, BridgeError> {
        names::check(name)?;
        let id = self.inner.endpoints.fetch_add(1, Ordering::Relaxed);
        let token = self.inner.name.endpoint(id, kind, name, of, qos);
        // Any id that is nobody else's: rmw_zenoh takes another hash of the same token.
        let mut gid = [0; 16];
        gid.copy_from_slice(&Sha256::digest(token.as_bytes())[..16]);
        let declared = self.session().declare_alive(&token).await?;
        Ok(Declared { key: names::key(self.domain(), name, of), gid, _token: declared })
    }

    /// Something to publish messages of a type with.
    ///
    /// # Errors
    /// When the name or the type is unknown, or the network refuses.
    pub async fn publisher<T: Serialize>(&self, topic: &str, type_name: &'static str, qos: Qos) -> Result<RosPublisher<T>, BridgeError> {
        let declared = self.declare(EntityKind::Publisher, topic, &type_named(type_name)?, qos).await?;
        let room = if qos.reliable { Room::Wait } else { Room::Drop };
        Ok(RosPublisher { session: self.session().clone(), declared, type_name, room, sent: AtomicI64::new(0), _of: PhantomData })
    }

    /// Subscribes to a topic with room for as many messages as the quality of service says; past ones come first where it says so.
    ///
    /// # Errors
    /// When the name or the type is unknown, or the network refuses.
    pub async fn subscribe<T: DeserializeOwned>(
        &self,
        topic: &str,
        type_name: &'static str,
        qos: Qos,
    ) -> Result<RosSubscription<T>, BridgeError> {
        let of = type_named(type_name)?;
        let key = names::key(self.domain(), topic, &of);
        self.subscribe_to(key, topic, &of, type_name, qos).await
    }

    /// The same for every version of a type: of what their messages begin with alike.
    ///
    /// # Errors
    /// As [`Self::subscribe`].
    pub async fn subscribe_any_version<T: DeserializeOwned>(
        &self,
        topic: &str,
        type_name: &'static str,
        qos: Qos,
    ) -> Result<RosSubscription<T>, BridgeError> {
        let of = type_named(type_name)?;
        let key = names::key_of_hash(self.domain(), topic, &of, "*");
        self.subscribe_to(key, topic, &of, type_name, qos).await
    }

    async fn subscribe_to<T>(
        &self,
        key: String,
        topic: &str,
        of: &TypeName,
        type_name: &'static str,
        qos: Qos,
    ) -> Result<RosSubscription<T>, BridgeError> {
        let declared = self.declare(EntityKind::Subscription, topic, of, qos).await?;
        let messages = self.session().subscribe(&key, qos.depth as usize).await?;
        let mut past = Vec::new();
        if qos.transient_local {
            past = self.past(&key, qos.depth).await?;
        }
        past.reverse();
        Ok(RosSubscription { messages, past, type_name, node: self.clone(), key, depth: qos.depth, _declared: declared, _of: PhantomData })
    }

    /// The last messages of a topic, from its publishers' caches (`AdvancedPublisher`), oldest first.
    async fn past(&self, key: &str, depth: u32) -> Result<Vec<RawMessage>, BridgeError> {
        let message = RawMessage { key: format!("{key}/@adv/**?_max={depth}"), ..RawMessage::default() };
        let mut replies = self.session().query(QueryRecipients::Caches, message, HISTORY).await?;
        let mut past = Vec::new();
        while let Some(reply) = replies.next().await {
            past.push(reply);
        }
        Ok(past)
    }
}

/// Publishes messages of one type on one topic.
pub struct RosPublisher<T> {
    session: RawSession,
    declared: Declared,
    type_name: &'static str,
    room: Room,
    sent: AtomicI64,
    _of: PhantomData<fn(T)>,
}

impl<T: Serialize> RosPublisher<T> {
    /// Publishes a message.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn publish(&self, message: &T) -> Result<(), BridgeError> {
        let payload = encode(message, self.type_name)?.into();
        let sequence = self.sent.fetch_add(1, Ordering::Relaxed) + 1;
        let attachment = Attachment { sequence, stamp_ns: now_ns() as i64, gid: self.declared.gid }.encode();
        Ok(self.session.put(RawMessage { key: self.declared.key.clone(), payload, attachment }, self.room).await?)
    }
}

/// The messages of one topic.
pub struct RosSubscription<T> {
    messages: RawSubscription,
    /// Past messages, the oldest last.
    past: Vec<RawMessage>,
    type_name: &'static str,
    node: Node,
    key: String,
    depth: u32,
    _declared: Declared,
    _of: PhantomData<fn() -> T>,
}

impl<T: DeserializeOwned> RosSubscription<T> {
    /// The next message, or why it cannot be read; none when the session has closed. Cancel safe.
    pub async fn recv(&mut self) -> Option<Result<T, BridgeError>> {
        let message = self.recv_bytes().await?;
        Some(self.decode(&message))
    }

    /// The next message as it came, for [`Self::decode`]: large ones are not read where others wait. Cancel safe.
    pub async fn recv_bytes(&mut self) -> Option<Arrived> {
        match self.past.pop() {
            Some(past) => Some(Arrived { message: past, arrived: Instant::now() }),
            None => self.messages.recv().await,
        }
    }

    /// A message of this topic from its bytes.
    ///
    /// # Errors
    /// When they are none.
    pub fn decode(&self, bytes: &Arrived) -> Result<T, BridgeError> {
        decode(&bytes.message.payload, self.type_name).map_err(BridgeError::from)
    }

    /// Asks for past messages again: a publisher has come that may have published before it was seen.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn recall(&mut self) -> Result<(), BridgeError> {
        let mut past = self.node.past(&self.key, self.depth).await?;
        past.reverse();
        past.append(&mut self.past);
        self.past = past;
        Ok(())
    }

    /// How many messages were dropped because nobody took them in time.
    pub fn dropped(&self) -> u64 {
        self.messages.dropped()
    }
}
