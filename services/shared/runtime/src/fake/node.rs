//! One node's access to the fake network.

use std::sync::{Arc, Weak};
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use repose_proto::Payload;
use tokio::sync::watch;
use tokio::time::Instant;

use super::FakeNetwork;
use super::network_state::{Declaration, NetworkState, Shared, matches};
use crate::RuntimeError;
use crate::mailbox::mailbox;
use crate::transport::{
    AliveWatch, ConnectionStatus, Guard, IncomingQueries, IncomingQuery, OutgoingQuery, Replier, ReplyEvent, ReplyStream, Sample,
    Subscription, Traffic, Transport,
};

/// One node's access to the network.
pub(super) struct FakeTransport {
    pub(super) shared: Arc<Shared>,
    pub(super) node: String,
    pub(super) since: Instant,
}

type Undo = Box<dyn FnOnce(&mut NetworkState) + Send + Sync>;

/// Takes a declaration back when dropped.
struct Undeclare(Weak<Shared>, Option<Undo>);

impl Drop for Undeclare {
    fn drop(&mut self) {
        if let (Some(shared), Some(undo)) = (self.0.upgrade(), self.1.take()) {
            shared.with(undo);
        }
    }
}

impl FakeTransport {
    fn undeclare(&self, undo: impl FnOnce(&mut NetworkState) + Send + Sync + 'static) -> Guard {
        Box::new(Undeclare(Arc::downgrade(&self.shared), Some(Box::new(undo))))
    }
}

struct FakeReplier {
    shared: Weak<Shared>,
    query: u64,
}

#[async_trait]
impl Replier for FakeReplier {
    async fn reply(&self, payload: Payload, attachment: Bytes) -> Result<(), RuntimeError> {
        let Some(shared) = self.shared.upgrade() else { return Ok(()) };
        let query = self.query;
        shared.with(|state| {
            let Some((asker, asked)) = state.queries.get(&query).map(|q| (q.node.clone(), q.key.clone())) else { return };
            if state.happens(state.settings.loss) {
                return;
            }
            let arrive = move |state: &mut NetworkState| {
                if let Some(open) = state.queries.get(&query) {
                    open.to.push(ReplyEvent::Reply { payload, attachment });
                }
            };
            state.send(&asked, &asker, false, Box::new(arrive));
        });
        Ok(())
    }
}

/// The stream ends when the last copy of the query has been let go.
struct EndOnDrop(FakeReplier);

impl Drop for EndOnDrop {
    fn drop(&mut self) {
        if let Some(shared) = self.0.shared.upgrade() {
            shared.with(|state| state.end_query(self.0.query));
        }
    }
}

#[async_trait]
impl Replier for Arc<EndOnDrop> {
    async fn reply(&self, payload: Payload, attachment: Bytes) -> Result<(), RuntimeError> {
        self.0.reply(payload, attachment).await
    }
}

#[async_trait]
impl Transport for FakeTransport {
    async fn query(&self, key: &str, query: OutgoingQuery) -> Result<ReplyStream, RuntimeError> {
        let (sender, replies) = mailbox(256);
        let shared = Arc::downgrade(&self.shared);
        let id = self.shared.with(|state| {
            let id = state.new_id();
            let Some((server, asked)) = state.servers.iter().find(|(_, s)| matches(&s.key, key)).map(|(id, s)| (*id, s.node.clone()))
            else {
                // Nobody serves this key: the stream ends at once.
                return id;
            };
            state.queries.insert(id, Declaration { node: self.node.clone(), key: asked.clone(), to: sender });
            let give_up = move |state: &mut NetworkState| {
                if let Some(open) = state.queries.remove(&id) {
                    open.to.push(ReplyEvent::TimedOut);
                }
            };
            state.schedule_at(Instant::now() + query.timeout, &self.node, &self.node, true, Box::new(give_up));
            if state.happens(state.settings.loss) {
                return id;
            }
            let copies = if state.happens(state.settings.duplication) { 2 } else { 1 };
            let replier = Arc::new(EndOnDrop(FakeReplier { shared, query: id }));
            for _ in 0..copies {
                let replier = replier.clone();
                let (key, payload, attachment) = (key.to_owned(), query.payload.clone(), query.attachment.clone());
                let arrive = move |state: &mut NetworkState| {
                    let incoming = IncomingQuery { key, payload, attachment, replier: Box::new(replier) };
                    let refused = match state.servers.get(&server) {
                        Some(server) => server.to.try_push(incoming).err(),
                        None => Some(incoming),
                    };
                    if let Some(refused) = refused {
                        state.garbage.push(Box::new(refused));
                    }
                };
                state.send(&self.node, &asked, false, Box::new(arrive));
            }
            state.garbage.push(Box::new(replier));
            id
        });
        Ok(ReplyStream { replies, _query: self.undeclare(move |state| drop(state.queries.remove(&id))) })
    }

    async fn serve(&self, key: &str, capacity: usize) -> Result<IncomingQueries, RuntimeError> {
        let (sender, queries) = mailbox(capacity);
        let id = self.shared.with(|state| {
            let id = state.new_id();
            state.servers.insert(id, Declaration { node: self.node.clone(), key: key.to_owned(), to: sender });
            id
        });
        let undo = move |state: &mut NetworkState| {
            if let Some(server) = state.servers.remove(&id) {
                state.garbage.push(Box::new(server));
            }
        };
        Ok(IncomingQueries { queries, _declaration: self.undeclare(undo) })
    }

    async fn put(&self, key: &str, payload: Payload, _traffic: Traffic) -> Result<(), RuntimeError> {
        self.shared.with(|state| {
            let receivers: Vec<(u64, String)> =
                state.subscribers.iter().filter(|(_, s)| matches(&s.key, key)).map(|(id, s)| (*id, s.node.clone())).collect();
            for (id, receiver) in receivers {
                if state.happens(state.settings.loss) {
                    continue;
                }
                let sample = Sample { key: key.to_owned(), payload: payload.clone() };
                let arrive = move |state: &mut NetworkState| {
                    if let Some(subscriber) = state.subscribers.get(&id) {
                        subscriber.to.push(sample);
                    }
                };
                state.send(&self.node, &receiver, false, Box::new(arrive));
            }
        });
        Ok(())
    }

    async fn subscribe(&self, key: &str, capacity: usize) -> Result<Subscription, RuntimeError> {
        let (sender, samples) = mailbox(capacity);
        let id = self.shared.with(|state| {
            let id = state.new_id();
            state.subscribers.insert(id, Declaration { node: self.node.clone(), key: key.to_owned(), to: sender });
            id
        });
        Ok(Subscription { samples, _declaration: self.undeclare(move |state| drop(state.subscribers.remove(&id))) })
    }

    async fn declare_alive(&self, key: &str) -> Result<Guard, RuntimeError> {
        let id = self.shared.with(|state| {
            let id = state.new_id();
            state.tokens.insert(id, Declaration { node: self.node.clone(), key: key.to_owned(), to: () });
            state.announce(&self.node, key, true);
            id
        });
        let undo = move |state: &mut NetworkState| {
            if let Some(token) = state.tokens.remove(&id) {
                state.announce(&token.node, &token.key, false);
            }
        };
        Ok(self.undeclare(undo))
    }

    async fn watch_alive(&self, key: &str) -> Result<AliveWatch, RuntimeError> {
        let (id, keys) = self.shared.with(|state| {
            let id = state.new_id();
            let now = state.tokens.values().map(|t| t.key.clone()).filter(|k| matches(key, k)).collect();
            let (sender, keys) = watch::channel(now);
            state.watches.insert(id, Declaration { node: self.node.clone(), key: key.to_owned(), to: sender });
            (id, keys)
        });
        Ok(AliveWatch { keys, _declaration: self.undeclare(move |state| drop(state.watches.remove(&id))) })
    }

    fn connection(&self) -> ConnectionStatus {
        ConnectionStatus { is_up: true, since: self.since, number: 1 }
    }

    async fn locators(&self) -> Vec<String> {
        Vec::new()
    }

    async fn close(&self, _bound: Duration) -> Result<(), RuntimeError> {
        FakeNetwork { shared: self.shared.clone() }.kill(&self.node);
        Ok(())
    }
}
