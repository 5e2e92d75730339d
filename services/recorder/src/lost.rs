//! What a recording lacks, by kind: counted wherever something is dropped, said at the end and in the file.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Counts of messages that were received, or announced, and are missing from the recording. Cheap to clone: all clones count together.
#[derive(Debug, Clone, Default)]
pub struct LostMessages(Arc<Mutex<BTreeMap<&'static str, u64>>>);

impl LostMessages {
    fn counts(&self) -> MutexGuard<'_, BTreeMap<&'static str, u64>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts `count` more of a kind.
    pub fn add(&self, kind: &'static str, count: u64) {
        if count > 0 {
            *self.counts().entry(kind).or_default() += count;
        }
    }

    /// One of a kind is there after all.
    pub fn found(&self, kind: &'static str) {
        let mut counts = self.counts();
        if let Some(count) = counts.get_mut(kind) {
            *count = count.saturating_sub(1);
        }
        counts.retain(|_, count| *count > 0);
    }

    /// The counts by kind; kinds of which nothing was lost are not there.
    pub fn by_kind(&self) -> BTreeMap<&'static str, u64> {
        self.counts().clone()
    }
}
