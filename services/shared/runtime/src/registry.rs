//! The calls that a worker knows: open ones, so that a second attempt with the same id joins the first; cancels, so that one that came
//! before its call still counts; and the outcomes of at-most-once calls.

use std::collections::{HashMap, VecDeque};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::time::Duration;

use repose_proto::{CallAttachment, CallError, Payload, Priority, limits};
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::shares::{ForCell, leaves_room};

/// Cancels remembered at once; the oldest go first.
const MAX_CANCELS: usize = 4096;
/// Repetitions of one call that may wait for it to end: more than there are attempts at one.
pub const MAX_JOINED: usize = 16;

/// The result of a call: its payload, or its error.
pub type CallResult = Result<Payload, CallError>;

/// What the registry says to a call that arrives.
pub enum Admission {
    /// New: compute it, then call [`Registry::finish`].
    Compute {
        /// Triggered by a cancel.
        cancelled: CancellationToken,
    },
    /// The same call is open or its outcome is remembered: wait for it.
    Join {
        /// Holds the outcome once there is one.
        outcome: watch::Receiver<Option<CallResult>>,
    },
    /// The same call is open, and many wait for it already.
    Crowded,
    /// Cancelled before it came.
    Cancelled,
    /// The same id with a different request.
    Conflict,
    /// Too many calls are open.
    Full,
    /// Too many of its cell are.
    CellFull {
        /// How many.
        open: usize,
    },
}

struct Entry {
    cell: ForCell,
    fingerprint: Fingerprint,
    cancelled: CancellationToken,
    /// The caller asked for the cancel, rather than a drain or the deadline.
    by_caller: bool,
    outcome: watch::Sender<Option<CallResult>>,
}

/// The calls of one worker.
pub struct Registry {
    open: HashMap<String, Entry>,
    kept: HashMap<String, Entry>,
    kept_order: VecDeque<String>,
    cancels: VecDeque<(Instant, String)>,
    max_open: usize,
    outcomes_kept: usize,
}

impl Registry {
    /// A registry of at most `max_open` open calls that remembers `outcomes_kept` outcomes of at-most-once calls.
    pub fn new(max_open: usize, outcomes_kept: usize) -> Self {
        Self { open: HashMap::new(), kept: HashMap::new(), kept_order: VecDeque::new(), cancels: VecDeque::new(), max_open, outcomes_kept }
    }

    /// Calls being computed.
    pub fn open_calls(&self) -> usize {
        self.open.len()
    }

    /// How many calls may be open when one of a priority comes: batch leaves a quarter of the places to interactive calls.
    fn places(&self, priority: Priority) -> usize {
        match priority {
            Priority::Interactive => self.max_open,
            Priority::Batch => (self.max_open - self.max_open / 4).max(1),
        }
    }

    /// Takes a call in, for a cell; `fingerprint` is its request's.
    pub fn admit(&mut self, call: &CallAttachment, cell: &ForCell, fingerprint: Fingerprint) -> Admission {
        let id = call.id.as_str();
        if let Some(entry) = self.open.get(id).or_else(|| self.kept.get(id)) {
            return match entry.fingerprint == fingerprint {
                true if entry.outcome.receiver_count() >= MAX_JOINED => Admission::Crowded,
                true => Admission::Join { outcome: entry.outcome.subscribe() },
                false => Admission::Conflict,
            };
        }
        self.forget_old_cancels();
        if self.cancels.iter().any(|(_, cancelled)| cancelled == id) {
            return Admission::Cancelled;
        }
        let (taken, places) = (self.open.len(), self.places(call.priority));
        if taken >= places {
            return Admission::Full;
        }
        let open = self.open.values().filter(|entry| entry.cell == *cell).count();
        if cell.is_some() && !leaves_room(open, taken, places) {
            return Admission::CellFull { open };
        }
        let cancelled = CancellationToken::new();
        let entry =
            Entry { cell: cell.clone(), fingerprint, cancelled: cancelled.clone(), by_caller: false, outcome: watch::Sender::new(None) };
        self.open.insert(id.to_owned(), entry);
        Admission::Compute { cancelled }
    }

    /// Cancels a call, now or when it comes.
    pub fn cancel(&mut self, id: &str) {
        if let Some(entry) = self.open.get_mut(id) {
            entry.by_caller = true;
            entry.cancelled.cancel();
            return;
        }
        self.forget_old_cancels();
        if self.cancels.len() == MAX_CANCELS {
            self.cancels.pop_front();
        }
        self.cancels.push_back((Instant::now(), id.to_owned()));
    }

    /// Whether the caller of an open call has cancelled it.
    pub fn is_cancelled_by_caller(&self, id: &str) -> bool {
        self.open.get(id).is_some_and(|entry| entry.by_caller)
    }

    /// Cancels every open call, though no caller asked for it.
    pub fn cancel_all(&self) {
        self.open.values().for_each(|entry| entry.cancelled.cancel());
    }

    /// Ends a call, and remembers its outcome if it is to happen at most once. Not a refusal that may be tried again: nothing has happened, and whoever
    /// tries again, which at the same worker takes the same id, is not to hear the old refusal.
    pub fn finish(&mut self, id: &str, outcome: CallResult, at_most_once: bool) {
        let Some(entry) = self.open.remove(id) else { return };
        let is_final = !outcome.as_ref().is_err_and(|error| error.retryable);
        entry.outcome.send_replace(Some(outcome));
        if !at_most_once || !is_final || self.outcomes_kept == 0 {
            return;
        }
        if self.kept_order.len() >= self.outcomes_kept
            && let Some(oldest) = self.kept_order.pop_front()
        {
            self.kept.remove(&oldest);
        }
        self.kept_order.push_back(id.to_owned());
        self.kept.insert(id.to_owned(), entry);
    }

    fn forget_old_cancels(&mut self) {
        let memory = Duration::from_millis(limits::CANCEL_MEMORY_MS);
        while self.cancels.front().is_some_and(|(when, _)| when.elapsed() > memory) {
            self.cancels.pop_front();
        }
    }
}

/// Tells requests apart. Not against an adversary: who can reuse an id can also reuse its payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fingerprint(u64);

impl Fingerprint {
    /// That of a request. With a scene in it that takes milliseconds: not to be done while the registry is locked, which every call and cancel needs.
    pub fn of(method: &str, payload: &Payload) -> Self {
        let mut hasher = DefaultHasher::new();
        (method, &payload.encoding, &payload.bytes[..]).hash(&mut hasher);
        Self(hasher.finish())
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::ErrorCode;

    use super::*;

    fn payload(text: &'static str) -> Payload {
        Payload { encoding: "application/json".to_owned(), bytes: text.into() }
    }

    /// What a registry says to a call of method `m` with a payload.
    fn admit(registry: &mut Registry, id: &str, text: &'static str) -> Admission {
        admit_for(registry, &None, id, text)
    }

    fn admit_for(registry: &mut Registry, cell: &ForCell, id: &str, text: &'static str) -> Admission {
        let call = CallAttachment {
            v: limits::VERSION,
            id: id.to_owned(),
            method: "m".to_owned(),
            remaining_ms: 1000,
            priority: Priority::Interactive,
            attempt: 0,
            traceparent: None,
            caller: None,
        };
        registry.admit(&call, cell, Fingerprint::of(&call.method, &payload(text)))
    }

    #[tokio::test(start_paused = true)]
    async fn a_cancel_before_its_call_is_remembered_for_ten_seconds() {
        let mut registry = Registry::new(4, 4);
        registry.cancel("a");
        assert!(matches!(admit(&mut registry, "a", "1"), Admission::Cancelled));
        tokio::time::advance(Duration::from_millis(limits::CANCEL_MEMORY_MS + 1)).await;
        assert!(matches!(admit(&mut registry, "a", "1"), Admission::Compute { .. }));
    }

    #[tokio::test]
    async fn the_same_id_joins_and_a_different_request_under_it_conflicts() {
        let mut registry = Registry::new(4, 4);
        assert!(matches!(admit(&mut registry, "a", "1"), Admission::Compute { .. }));
        let Admission::Join { mut outcome } = admit(&mut registry, "a", "1") else { panic!("expected to join") };
        assert!(matches!(admit(&mut registry, "a", "2"), Admission::Conflict));
        registry.finish("a", Ok(payload("done")), false);
        assert_eq!(outcome.wait_for(Option::is_some).await.unwrap().clone(), Some(Ok(payload("done"))));
        assert!(matches!(admit(&mut registry, "a", "2"), Admission::Compute { .. }));
    }

    #[tokio::test]
    async fn no_more_than_the_bound_wait_for_one_call() {
        let mut registry = Registry::new(4, 4);
        assert!(matches!(admit(&mut registry, "a", "1"), Admission::Compute { .. }));
        let mut waiting = Vec::new();
        for _ in 0..MAX_JOINED {
            let Admission::Join { outcome } = admit(&mut registry, "a", "1") else { panic!("expected to join") };
            waiting.push(outcome);
        }
        assert!(matches!(admit(&mut registry, "a", "1"), Admission::Crowded));
        drop(waiting.pop());
        assert!(matches!(admit(&mut registry, "a", "1"), Admission::Join { .. }), "one has gone");
    }

    #[tokio::test]
    async fn outcomes_of_at_most_once_calls_are_kept_up_to_a_bound() {
        let mut registry = Registry::new(4, 2);
        for id in ["a", "b", "c"] {
            assert!(matches!(admit(&mut registry, id, "1"), Admission::Compute { .. }));
            registry.finish(id, Ok(payload("done")), true);
        }
        assert!(matches!(admit(&mut registry, "a", "1"), Admission::Compute { .. }));
        assert!(matches!(admit(&mut registry, "c", "1"), Admission::Join { .. }));
        assert!(matches!(admit(&mut registry, "c", "2"), Admission::Conflict));
    }

    #[tokio::test]
    async fn a_refusal_that_may_be_tried_again_is_not_kept_and_any_other_end_is() {
        let mut registry = Registry::new(4, 4);
        let refusal = CallError::new(ErrorCode::Unavailable, "not now");
        let unknown = CallError { retryable: false, ..refusal.clone() };
        for (id, error) in [("a", refusal), ("b", unknown)] {
            assert!(matches!(admit(&mut registry, id, "1"), Admission::Compute { .. }));
            let Admission::Join { outcome } = admit(&mut registry, id, "1") else { panic!("expected to join") };
            registry.finish(id, Err(error.clone()), true);
            assert_eq!(*outcome.borrow(), Some(Err(error)), "whoever waits for it hears of it all the same");
        }
        assert!(matches!(admit(&mut registry, "a", "1"), Admission::Compute { .. }));
        assert!(matches!(admit(&mut registry, "b", "1"), Admission::Join { .. }));
    }

    #[tokio::test]
    async fn no_more_than_the_bound_are_open() {
        let mut registry = Registry::new(1, 0);
        assert!(matches!(admit(&mut registry, "a", "1"), Admission::Compute { .. }));
        assert!(matches!(admit(&mut registry, "b", "1"), Admission::Full));
    }

    #[tokio::test]
    async fn a_cell_that_floods_leaves_places_to_the_next() {
        let mut registry = Registry::new(8, 0);
        let (flooding, quiet): (ForCell, ForCell) = (Some("a".into()), Some("b".into()));
        for id in ["a1", "a2", "a3", "a4"] {
            assert!(matches!(admit_for(&mut registry, &flooding, id, "1"), Admission::Compute { .. }));
        }
        assert!(matches!(admit_for(&mut registry, &flooding, "a5", "1"), Admission::CellFull { open: 4 }));
        assert!(matches!(admit_for(&mut registry, &quiet, "b1", "1"), Admission::Compute { .. }));
        registry.finish("a1", Ok(payload("done")), false);
        assert!(matches!(admit_for(&mut registry, &flooding, "a6", "1"), Admission::Compute { .. }), "four places are free again");
        assert!(matches!(admit(&mut registry, "own", "1"), Admission::Compute { .. }), "the worker's own cell has all of them");
    }
}
