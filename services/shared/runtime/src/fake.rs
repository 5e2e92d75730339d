//! A seeded network in memory, for tests: it loses, delays and repeats messages, kills nodes, and stops and resumes them.
//!
//! Links keep their order, as Zenoh's do. A killed node vanishes at once: its tokens, its queries and what is on its way. A stopped one
//! (SIGSTOP) keeps its tokens; what it sends and what is sent to it waits until it resumes. Under Tokio's paused clock on one thread the
//! same seed gives the same schedule.

use std::cmp::{Ordering, Reverse};
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use repose_proto::Payload;
use tokio::sync::{Notify, watch};
use tokio::time::Instant;

use crate::RuntimeError;
use crate::mailbox::{MailboxSender, mailbox};
use crate::transport::{
    AliveWatch, Guard, IncomingQueries, IncomingQuery, OutgoingQuery, Replier, ReplyEvent, ReplyStream, Sample, Subscription, Traffic,
    Transport,
};

/// How bad the network is.
#[derive(Debug, Clone)]
pub struct FakeSettings {
    /// The source of every random number.
    pub seed: u64,
    /// Probability that a query, a reply or a put is lost. Liveliness is never lost.
    pub loss: f64,
    /// Probability that a query arrives twice.
    pub duplication: f64,
    /// The least time that a message takes.
    pub min_delay: Duration,
    /// The most.
    pub max_delay: Duration,
}

impl Default for FakeSettings {
    fn default() -> Self {
        Self { seed: 0, loss: 0.0, duplication: 0.0, min_delay: Duration::from_micros(100), max_delay: Duration::from_millis(1) }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Condition {
    Running,
    Stopped,
    Killed,
}

type Action = Box<dyn FnOnce(&mut State) + Send>;

struct Scheduled {
    at: Instant,
    seq: u64,
    from: String,
    to: String,
    /// The network itself says it, whatever has become of the sender.
    from_network: bool,
    action: Action,
}

impl PartialEq for Scheduled {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Scheduled {}
impl PartialOrd for Scheduled {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Scheduled {
    fn cmp(&self, other: &Self) -> Ordering {
        (self.at, self.seq).cmp(&(other.at, other.seq))
    }
}

struct Declared<T> {
    node: String,
    key: String,
    to: T,
}

struct State {
    settings: FakeSettings,
    random: Pcg64,
    next_id: u64,
    conditions: BTreeMap<String, Condition>,
    schedule: BinaryHeap<Reverse<Scheduled>>,
    /// What waits for a stopped node, in order.
    parked: Vec<Scheduled>,
    /// When the newest message of a link arrives: the next may not overtake it.
    arrivals: BTreeMap<(String, String), Instant>,
    servers: BTreeMap<u64, Declared<MailboxSender<IncomingQuery>>>,
    subscribers: BTreeMap<u64, Declared<MailboxSender<Sample>>>,
    tokens: BTreeMap<u64, Declared<()>>,
    watches: BTreeMap<u64, Declared<watch::Sender<BTreeSet<String>>>>,
    /// Open queries: the asker, and the node that was asked in `key`.
    queries: BTreeMap<u64, Declared<MailboxSender<ReplyEvent>>>,
    /// What may take the state's lock when it is dropped, and so is dropped outside of it.
    garbage: Vec<Box<dyn Send>>,
}

struct Shared {
    state: Mutex<State>,
    scheduled: Arc<Notify>,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the state and wakes the driver.
    fn with<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        let mut state = self.state();
        let result = change(&mut state);
        let garbage = std::mem::take(&mut state.garbage);
        drop(state);
        drop(garbage);
        self.scheduled.notify_one();
        result
    }
}

impl State {
    fn condition(&self, node: &str) -> Condition {
        self.conditions.get(node).copied().unwrap_or(Condition::Running)
    }

    fn new_id(&mut self) -> u64 {
        self.next_id += 1;
        self.next_id
    }

    fn happens(&mut self, probability: f64) -> bool {
        self.random.random::<f64>() < probability
    }

    /// Lets something arrive at `to` after a random delay, behind everything sent before on the same link.
    fn send(&mut self, from: &str, to: &str, from_network: bool, action: Action) {
        let (least, most) = (self.settings.min_delay, self.settings.max_delay);
        let delay = least + most.saturating_sub(least).mul_f64(self.random.random::<f64>());
        let link = (from.to_owned(), to.to_owned());
        let at = (Instant::now() + delay).max(self.arrivals.get(&link).copied().unwrap_or_else(Instant::now));
        self.arrivals.insert(link, at);
        self.schedule_at(at, from, to, from_network, action);
    }

    fn schedule_at(&mut self, at: Instant, from: &str, to: &str, from_network: bool, action: Action) {
        let seq = self.new_id();
        self.schedule.push(Reverse(Scheduled { at, seq, from: from.to_owned(), to: to.to_owned(), from_network, action }));
    }

    fn deliver(&mut self, message: Scheduled) {
        let sender = if message.from_network { Condition::Running } else { self.condition(&message.from) };
        match (sender, self.condition(&message.to)) {
            (Condition::Killed, _) | (_, Condition::Killed) => self.garbage.push(Box::new(message)),
            (Condition::Stopped, _) | (_, Condition::Stopped) => self.parked.push(message),
            _ => (message.action)(self),
        }
    }

    /// Tells every watch about a token.
    fn announce(&mut self, node: &str, key: &str, alive: bool) {
        let watches: Vec<(u64, String)> =
            self.watches.iter().filter(|(_, w)| matches(&w.key, key)).map(|(id, w)| (*id, w.node.clone())).collect();
        for (id, watcher) in watches {
            let key = key.to_owned();
            let change = move |state: &mut State| {
                if let Some(watch) = state.watches.get(&id) {
                    watch.to.send_modify(|keys| {
                        if alive {
                            keys.insert(key)
                        } else {
                            keys.remove(&key)
                        };
                    });
                }
            };
            self.send(node, &watcher, true, Box::new(change));
        }
    }

    /// Ends the stream of a query, behind the replies sent before.
    fn end_query(&mut self, query: u64) {
        if let Some((asker, asked)) = self.queries.get(&query).map(|q| (q.node.clone(), q.key.clone())) {
            let end = move |state: &mut State| drop(state.queries.remove(&query));
            self.send(&asked, &asker, true, Box::new(end));
        }
    }
}

/// Whether a key matches an expression whose `*` stands for one chunk.
fn matches(expression: &str, key: &str) -> bool {
    let (mut expected, mut chunks) = (expression.split('/'), key.split('/'));
    loop {
        match (expected.next(), chunks.next()) {
            (None, None) => return true,
            (Some(e), Some(c)) if e == "*" || e == c => {}
            _ => return false,
        }
    }
}

/// The network. Must be made inside a Tokio runtime.
pub struct FakeNetwork {
    shared: Arc<Shared>,
}

impl FakeNetwork {
    /// A network without nodes.
    pub fn new(settings: FakeSettings) -> Self {
        let state = State {
            random: Pcg64::seed_from_u64(settings.seed),
            settings,
            next_id: 0,
            conditions: BTreeMap::new(),
            schedule: BinaryHeap::new(),
            parked: Vec::new(),
            arrivals: BTreeMap::new(),
            servers: BTreeMap::new(),
            subscribers: BTreeMap::new(),
            tokens: BTreeMap::new(),
            watches: BTreeMap::new(),
            queries: BTreeMap::new(),
            garbage: Vec::new(),
        };
        let scheduled = Arc::new(Notify::new());
        let shared = Arc::new(Shared { state: Mutex::new(state), scheduled: scheduled.clone() });
        tokio::spawn(drive(Arc::downgrade(&shared), scheduled));
        Self { shared }
    }

    /// A node of the network: what a process would be.
    pub fn node(&self, name: &str) -> Arc<dyn Transport> {
        self.shared.with(|state| state.conditions.insert(name.to_owned(), Condition::Running));
        Arc::new(FakeTransport { shared: self.shared.clone(), node: name.to_owned() })
    }

    /// Kills a node (SIGKILL): everyone sees its tokens vanish and its streams end.
    pub fn kill(&self, node: &str) {
        self.shared.with(|state| {
            state.conditions.insert(node.to_owned(), Condition::Killed);
            let (dead, living) = std::mem::take(&mut state.servers).into_iter().partition(|(_, d)| d.node == node);
            state.servers = living;
            let dead: BTreeMap<u64, Declared<MailboxSender<IncomingQuery>>> = dead;
            state.garbage.push(Box::new(dead));
            state.subscribers.retain(|_, d| d.node != node);
            state.watches.retain(|_, d| d.node != node);
            let dead = |key: &str| key == node;
            let tokens: Vec<(u64, String)> =
                state.tokens.iter().filter(|(_, t)| dead(&t.node)).map(|(id, t)| (*id, t.key.clone())).collect();
            for (id, key) in tokens {
                state.tokens.remove(&id);
                state.announce(node, &key, false);
            }
            state.queries.retain(|_, q| q.node != node);
            let orphans: Vec<u64> = state.queries.iter().filter(|(_, q)| dead(&q.key)).map(|(id, _)| *id).collect();
            orphans.into_iter().for_each(|query| state.end_query(query));
        });
    }

    /// Stops a node (SIGSTOP): it stays alive in everyone's sight and says nothing more.
    pub fn stop(&self, node: &str) {
        self.shared.with(|state| state.conditions.insert(node.to_owned(), Condition::Stopped));
    }

    /// Resumes a stopped node: what waited goes on.
    pub fn resume(&self, node: &str) {
        self.shared.with(|state| {
            state.conditions.insert(node.to_owned(), Condition::Running);
            for message in std::mem::take(&mut state.parked) {
                state.deliver(message);
            }
        });
    }
}

async fn drive(network: Weak<Shared>, scheduled: Arc<Notify>) {
    loop {
        let next = match network.upgrade() {
            Some(shared) => shared.state().schedule.peek().map(|Reverse(m)| m.at),
            None => return,
        };
        match next {
            Some(at) if at <= Instant::now() => {
                if let Some(shared) = network.upgrade() {
                    shared.with(|state| {
                        if let Some(Reverse(message)) = state.schedule.pop() {
                            state.deliver(message);
                        }
                    });
                }
            }
            Some(at) => tokio::select! {
                () = tokio::time::sleep_until(at) => {}
                () = scheduled.notified() => {}
            },
            None => scheduled.notified().await,
        }
    }
}

/// One node's access to the network.
struct FakeTransport {
    shared: Arc<Shared>,
    node: String,
}

type Undo = Box<dyn FnOnce(&mut State) + Send + Sync>;

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
    fn undeclare(&self, undo: impl FnOnce(&mut State) + Send + Sync + 'static) -> Guard {
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
            let arrive = move |state: &mut State| {
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
            let Some((server, asked)) = state.servers.iter().find(|(_, s)| s.key == key).map(|(id, s)| (*id, s.node.clone())) else {
                // Nobody serves this key: the stream ends at once.
                return id;
            };
            state.queries.insert(id, Declared { node: self.node.clone(), key: asked.clone(), to: sender });
            let give_up = move |state: &mut State| {
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
                let (payload, attachment) = (query.payload.clone(), query.attachment.clone());
                let arrive = move |state: &mut State| {
                    let incoming = IncomingQuery { payload, attachment, replier: Box::new(replier) };
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
            state.servers.insert(id, Declared { node: self.node.clone(), key: key.to_owned(), to: sender });
            id
        });
        let undo = move |state: &mut State| {
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
                let arrive = move |state: &mut State| {
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
            state.subscribers.insert(id, Declared { node: self.node.clone(), key: key.to_owned(), to: sender });
            id
        });
        Ok(Subscription { samples, _declaration: self.undeclare(move |state| drop(state.subscribers.remove(&id))) })
    }

    async fn declare_alive(&self, key: &str) -> Result<Guard, RuntimeError> {
        let id = self.shared.with(|state| {
            let id = state.new_id();
            state.tokens.insert(id, Declared { node: self.node.clone(), key: key.to_owned(), to: () });
            state.announce(&self.node, key, true);
            id
        });
        let undo = move |state: &mut State| {
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
            state.watches.insert(id, Declared { node: self.node.clone(), key: key.to_owned(), to: sender });
            (id, keys)
        });
        Ok(AliveWatch { keys, _declaration: self.undeclare(move |state| drop(state.watches.remove(&id))) })
    }

    async fn locators(&self) -> Vec<String> {
        Vec::new()
    }

    async fn close(&self, _bound: Duration) -> Result<(), RuntimeError> {
        FakeNetwork { shared: self.shared.clone() }.kill(&self.node);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_stands_for_one_chunk() {
        assert!(matches("a/*/c", "a/b/c") && matches("a/b", "a/b"));
        assert!(!matches("a/*", "a/b/c") && !matches("a/*/c", "a/c") && !matches("a", "b"));
    }
}
