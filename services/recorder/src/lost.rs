//! What a recording lacks, by kind: counted wherever something is dropped, said at the end and in the file.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Outages whose times are told; of later ones only the number is.
const MOST_OUTAGES: usize = 1000;

/// Counts of messages that were received, or announced, and are missing from the recording, and the times of which nothing is in it. Cheap to clone: all
/// clones count together.
#[derive(Debug, Clone, Default)]
pub struct LostMessages(Arc<Mutex<Lost>>);

#[derive(Debug, Default)]
struct Lost {
    counts: BTreeMap<&'static str, u64>,
    outages: Vec<[u64; 2]>,
}

impl LostMessages {
    fn lost(&self) -> MutexGuard<'_, Lost> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts `count` more of a kind.
    pub fn add(&self, kind: &'static str, count: u64) {
        if count > 0 {
            *self.lost().counts.entry(kind).or_default() += count;
        }
    }

    /// One of a kind is there after all.
    pub fn found(&self, kind: &'static str) {
        let counts = &mut self.lost().counts;
        if let Some(count) = counts.get_mut(kind) {
            *count = count.saturating_sub(1);
        }
        counts.retain(|_, count| *count > 0);
    }

    /// Nothing came between these two instants, nanoseconds since the Unix epoch.
    pub fn away(&self, since_ns: u64, until_ns: u64) {
        let outages = &mut self.lost().outages;
        if outages.len() < MOST_OUTAGES {
            outages.push([since_ns, until_ns]);
        }
    }

    /// The counts by kind; kinds of which nothing was lost are not there.
    pub fn by_kind(&self) -> BTreeMap<&'static str, u64> {
        self.lost().counts.clone()
    }

    /// When nothing came, from and until.
    pub fn outages(&self) -> Vec<[u64; 2]> {
        self.lost().outages.clone()
    }
}
