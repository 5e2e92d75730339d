//! Which liveliness tokens there are, from what a session tells a new watch of them.
//!
//! Zenoh tells a watch of the tokens that its session knows already, from other watches, in a task of its own: some time after the watch began, and
//! also of one that was taken back meanwhile. So whoever has asked which there are waits until the watch was told of each, and a token that is told
//! after its end is not alive.

use std::collections::BTreeSet;

/// What one watch was told, until it has caught up with its session.
#[derive(Debug, Default)]
pub(crate) struct Told {
    /// The tokens of which anything was told; kept until the watch has caught up.
    any: BTreeSet<String>,
    has_caught_up: bool,
    /// Those whose end was told first: that they were there will be told yet.
    owed: BTreeSet<String>,
}

impl Told {
    /// A token is told to be there; whether it is.
    pub(crate) fn came(&mut self, key: &str) -> bool {
        self.note(key);
        !self.owed.remove(key)
    }

    /// A token is told to have been taken back.
    pub(crate) fn went(&mut self, key: &str) {
        if self.note(key) {
            self.owed.insert(key.to_owned());
        }
    }

    /// Notes that something was told of a token; whether it is the first that is told of it.
    fn note(&mut self, key: &str) -> bool {
        !self.has_caught_up && self.any.insert(key.to_owned())
    }

    /// Whether something was told of each of the tokens that there were when the watch began. From then on they are told in their order.
    pub(crate) fn catch_up(&mut self, there: &BTreeSet<String>) -> bool {
        self.has_caught_up |= there.is_subset(&self.any);
        if self.has_caught_up {
            self.any.clear();
        }
        self.has_caught_up
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys<const N: usize>(keys: [&str; N]) -> BTreeSet<String> {
        keys.map(str::to_owned).into()
    }

    #[test]
    fn a_watch_has_caught_up_once_it_was_told_of_every_token_that_there_was() {
        let mut told = Told::default();
        assert!(!told.catch_up(&keys(["a", "b"])));
        assert!(told.came("a"));
        assert!(!told.catch_up(&keys(["a", "b"])));
        told.went("b");
        assert!(told.catch_up(&keys(["a", "b"])), "its end tells of it too");
        assert!(Told::default().catch_up(&keys([])), "there was none");
    }

    #[test]
    fn a_token_that_is_told_after_its_end_is_not_there_and_one_that_comes_back_is() {
        let mut told = Told::default();
        told.went("a");
        assert!(!told.came("a"));
        assert!(told.came("a"));
        assert!(told.catch_up(&keys(["a"])));
        for _ in 0..2 {
            told.went("a");
            assert!(told.came("a"), "in their order from now on");
        }
    }
}
