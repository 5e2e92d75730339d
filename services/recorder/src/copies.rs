//! Copies of calls that did not come: each journal numbers its copies, so that those before one that came are known to be missing.

use std::collections::BTreeMap;

/// The number that each journal's next copy must have.
#[derive(Debug, Default)]
pub struct CopyNumbers {
    next: BTreeMap<String, u64>,
    missing: u64,
}

impl CopyNumbers {
    /// Takes note of a journal's copy; how many before it are missing. Of the first nobody knows whether there were any.
    pub fn came(&mut self, journal: &str, seq: u64) -> u64 {
        let next = seq.saturating_add(1);
        let missing = match self.next.get_mut(journal) {
            Some(expected) => seq.saturating_sub(std::mem::replace(expected, next)),
            None => {
                self.next.insert(journal.to_owned(), next);
                0
            }
        };
        self.missing += missing;
        missing
    }

    /// How many are missing of all journals so far.
    pub fn missing(&self) -> u64 {
        self.missing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_journal_is_counted_by_its_own_numbers_and_a_worker_that_begins_anew_has_lost_none() {
        let mut numbers = CopyNumbers::default();
        let heard = [("a", 7), ("b", 0), ("a", 8), ("a", 11), ("b", 1), ("b", 3), ("a", 0), ("a", 1)];
        assert_eq!(heard.map(|(journal, seq)| numbers.came(journal, seq)), [0, 0, 0, 2, 0, 1, 0, 0]);
        assert_eq!(numbers.missing(), 3);
    }
}
