//! At most once: which executions were asked for, and how each ended.
//!
//! The same request id with the same payload gets the outcome of the first; with another payload it is refused. Finished entries are kept
//! up to a bound, oldest out first; running ones are never forgotten.

use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hash, Hasher};

use repose_proto::CallError;

/// What to do with a request.
#[derive(Debug, Clone, PartialEq)]
pub enum Admission<Outcome> {
    /// It is new: carry it out, then [`Ledger::finish`] it.
    Fresh,
    /// It is being carried out: wait for its end and ask again.
    Running,
    /// It has ended so.
    Done(Outcome),
}

/// The requests seen. `Outcome` is what the caller got.
#[derive(Debug)]
pub struct Ledger<Outcome> {
    capacity: usize,
    entries: VecDeque<Entry<Outcome>>,
}

#[derive(Debug)]
struct Entry<Outcome> {
    id: String,
    payload_hash: u64,
    outcome: Option<Outcome>,
}

impl<Outcome: Clone> Ledger<Outcome> {
    /// A ledger that remembers up to `capacity` finished requests.
    pub fn new(capacity: usize) -> Self {
        Self { capacity, entries: VecDeque::new() }
    }

    /// What to do with a request.
    ///
    /// # Errors
    /// `failed_precondition` when the id came before with another payload.
    pub fn admit(&mut self, id: &str, payload: &[u8]) -> Result<Admission<Outcome>, CallError> {
        let payload_hash = hash(payload);
        if let Some(entry) = self.entries.iter().find(|e| e.id == id) {
            if entry.payload_hash != payload_hash {
                return Err(CallError::precondition(format!("request {id} came before with another payload")).at("id"));
            }
            return Ok(entry.outcome.clone().map_or(Admission::Running, Admission::Done));
        }
        self.entries.push_back(Entry { id: id.to_owned(), payload_hash, outcome: None });
        Ok(Admission::Fresh)
    }

    /// Writes down how a request ended.
    pub fn finish(&mut self, id: &str, outcome: Outcome) {
        if let Some(entry) = self.entries.iter_mut().find(|e| e.id == id) {
            entry.outcome = Some(outcome);
        }
        while self.entries.iter().filter(|e| e.outcome.is_some()).count() > self.capacity {
            let oldest = self.entries.iter().position(|e| e.outcome.is_some());
            oldest.map(|i| self.entries.remove(i));
        }
    }
}

fn hash(payload: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    payload.hash(&mut hasher);
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_proto::ErrorCode;

    #[test]
    fn the_same_request_is_carried_out_once_and_gets_the_same_outcome() {
        let mut ledger = Ledger::new(2);
        assert_eq!(ledger.admit("a", b"plan"), Ok(Admission::Fresh));
        assert_eq!(ledger.admit("a", b"plan"), Ok(Admission::Running));
        ledger.finish("a", 7);
        assert_eq!(ledger.admit("a", b"plan"), Ok(Admission::Done(7)));
        assert_eq!(ledger.admit("a", b"other").unwrap_err().code, ErrorCode::FailedPrecondition);
    }

    #[test]
    fn finished_requests_are_forgotten_oldest_first_and_running_ones_never() {
        let mut ledger = Ledger::new(2);
        for id in ["running", "a", "b", "c"] {
            assert_eq!(ledger.admit(id, b""), Ok(Admission::Fresh));
        }
        for id in ["a", "b", "c"] {
            ledger.finish(id, ());
        }
        assert_eq!(ledger.admit("running", b""), Ok(Admission::Running));
        assert_eq!(ledger.admit("c", b""), Ok(Admission::Done(())));
        assert_eq!(ledger.admit("a", b""), Ok(Admission::Fresh));
    }
}
