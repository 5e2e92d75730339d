//! A seeded network in memory, for tests: it loses, delays and repeats messages, kills nodes, and stops and resumes them.
//!
//! Links keep their order, as Zenoh's do. A killed node vanishes at once: its tokens, its queries and what is on its way. A stopped one
//! (SIGSTOP) keeps its tokens; what it sends and what is sent to it waits until it resumes. Under Tokio's paused clock on one thread the
//! same seed gives the same schedule.

mod network_state;
mod node;

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

use rand::SeedableRng;
use rand_pcg::Pcg64;
use tokio::sync::Notify;
use tokio::time::Instant;

use crate::mailbox::MailboxSender;
use crate::transport::{IncomingQuery, Transport};
use network_state::{Declaration, NetworkState, NodeCondition, Shared};
use node::FakeTransport;

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

/// The network. Must be made inside a Tokio runtime.
pub struct FakeNetwork {
    shared: Arc<Shared>,
}

impl FakeNetwork {
    /// A network without nodes.
    pub fn new(settings: FakeSettings) -> Self {
        let state = NetworkState {
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
        self.shared.with(|state| state.conditions.insert(name.to_owned(), NodeCondition::Running));
        Arc::new(FakeTransport { shared: self.shared.clone(), node: name.to_owned(), since: Instant::now() })
    }

    /// Kills a node (SIGKILL): everyone sees its tokens vanish and its streams end.
    pub fn kill(&self, node: &str) {
        self.shared.with(|state| {
            state.conditions.insert(node.to_owned(), NodeCondition::Killed);
            let (dead, living) = std::mem::take(&mut state.servers).into_iter().partition(|(_, d)| d.node == node);
            state.servers = living;
            let dead: BTreeMap<u64, Declaration<MailboxSender<IncomingQuery>>> = dead;
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
        self.shared.with(|state| state.conditions.insert(node.to_owned(), NodeCondition::Stopped));
    }

    /// Resumes a stopped node: what waited goes on.
    pub fn resume(&self, node: &str) {
        self.shared.with(|state| {
            state.conditions.insert(node.to_owned(), NodeCondition::Running);
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
