//! The fake network's state: who is where, what is on its way, and when it arrives.

use std::cmp::{Ordering, Reverse};
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rand::RngExt;
use rand_pcg::Pcg64;
use tokio::sync::{Notify, watch};
use tokio::time::Instant;

use super::FakeSettings;
use crate::mailbox::MailboxSender;
use crate::transport::{IncomingQuery, ReplyEvent, Sample};

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum NodeCondition {
    Running,
    Stopped,
    Killed,
}

pub(super) type ScheduledAction = Box<dyn FnOnce(&mut NetworkState) + Send>;

pub(super) struct Scheduled {
    pub(super) at: Instant,
    pub(super) seq: u64,
    pub(super) from: String,
    pub(super) to: String,
    /// The network itself says it, whatever has become of the sender.
    pub(super) from_network: bool,
    pub(super) action: ScheduledAction,
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

pub(super) struct Declaration<T> {
    pub(super) node: String,
    pub(super) key: String,
    pub(super) to: T,
}

pub(super) struct NetworkState {
    pub(super) settings: FakeSettings,
    pub(super) random: Pcg64,
    pub(super) next_id: u64,
    pub(super) conditions: BTreeMap<String, NodeCondition>,
    pub(super) schedule: BinaryHeap<Reverse<Scheduled>>,
    /// What waits for a stopped node, in order.
    pub(super) parked: Vec<Scheduled>,
    /// When the newest message of a link arrives: the next may not overtake it.
    pub(super) arrivals: BTreeMap<(String, String), Instant>,
    pub(super) servers: BTreeMap<u64, Declaration<MailboxSender<IncomingQuery>>>,
    pub(super) subscribers: BTreeMap<u64, Declaration<MailboxSender<Sample>>>,
    pub(super) tokens: BTreeMap<u64, Declaration<()>>,
    pub(super) watches: BTreeMap<u64, Declaration<watch::Sender<BTreeSet<String>>>>,
    /// Open queries: the asker, and the node that was asked in `key`.
    pub(super) queries: BTreeMap<u64, Declaration<MailboxSender<ReplyEvent>>>,
    /// What may take the state's lock when it is dropped, and so is dropped outside of it.
    pub(super) garbage: Vec<Box<dyn Send>>,
}

pub(super) struct Shared {
    pub(super) state: Mutex<NetworkState>,
    pub(super) scheduled: Arc<Notify>,
}

impl Shared {
    pub(super) fn state(&self) -> MutexGuard<'_, NetworkState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the state and wakes the driver.
    pub(super) fn with<T>(&self, change: impl FnOnce(&mut NetworkState) -> T) -> T {
        let mut state = self.state();
        let result = change(&mut state);
        let garbage = std::mem::take(&mut state.garbage);
        drop(state);
        drop(garbage);
        self.scheduled.notify_one();
        result
    }
}

impl NetworkState {
    pub(super) fn condition(&self, node: &str) -> NodeCondition {
        self.conditions.get(node).copied().unwrap_or(NodeCondition::Running)
    }

    pub(super) fn new_id(&mut self) -> u64 {
        self.next_id += 1;
        self.next_id
    }

    pub(super) fn happens(&mut self, probability: f64) -> bool {
        self.random.random::<f64>() < probability
    }

    /// Lets something arrive at `to` after a random delay, behind everything sent before on the same link.
    pub(super) fn send(&mut self, from: &str, to: &str, from_network: bool, action: ScheduledAction) {
        let (least, most) = (self.settings.min_delay, self.settings.max_delay);
        let delay = least + most.saturating_sub(least).mul_f64(self.random.random::<f64>());
        let link = (from.to_owned(), to.to_owned());
        let at = (Instant::now() + delay).max(self.arrivals.get(&link).copied().unwrap_or_else(Instant::now));
        self.arrivals.insert(link, at);
        self.schedule_at(at, from, to, from_network, action);
    }

    pub(super) fn schedule_at(&mut self, at: Instant, from: &str, to: &str, from_network: bool, action: ScheduledAction) {
        let seq = self.new_id();
        self.schedule.push(Reverse(Scheduled { at, seq, from: from.to_owned(), to: to.to_owned(), from_network, action }));
    }

    pub(super) fn deliver(&mut self, message: Scheduled) {
        let sender = if message.from_network { NodeCondition::Running } else { self.condition(&message.from) };
        match (sender, self.condition(&message.to)) {
            (NodeCondition::Killed, _) | (_, NodeCondition::Killed) => self.garbage.push(Box::new(message)),
            (NodeCondition::Stopped, _) | (_, NodeCondition::Stopped) => self.parked.push(message),
            _ => (message.action)(self),
        }
    }

    /// Tells every watch about a token.
    pub(super) fn announce(&mut self, node: &str, key: &str, alive: bool) {
        let watches: Vec<(u64, String)> =
            self.watches.iter().filter(|(_, w)| matches(&w.key, key)).map(|(id, w)| (*id, w.node.clone())).collect();
        for (id, watcher) in watches {
            let key = key.to_owned();
            let change = move |state: &mut NetworkState| {
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
    pub(super) fn end_query(&mut self, query: u64) {
        if let Some((asker, asked)) = self.queries.get(&query).map(|q| (q.node.clone(), q.key.clone())) {
            let end = move |state: &mut NetworkState| drop(state.queries.remove(&query));
            self.send(&asked, &asker, true, Box::new(end));
        }
    }
}

/// Whether a key matches an expression whose `*` stands for one chunk.
pub(super) fn matches(expression: &str, key: &str) -> bool {
    let (mut expected, mut chunks) = (expression.split('/'), key.split('/'));
    loop {
        match (expected.next(), chunks.next()) {
            (None, None) => return true,
            (Some(e), Some(c)) if e == "*" || e == c => {}
            _ => return false,
        }
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
