//! Which scene seeds belong to which split: declared here and nowhere else.
//!
//! A scene's split follows from its seed alone, so that no tool can mix them up. Failures are looked at on validation scenes. Published
//! figures come from `final`, block by block, each of which is run once.

use std::ops::Range;

use serde::{Deserialize, Serialize};

/// The disjoint sets of scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Weights are fitted to these.
    Train,
    /// Settings are chosen, and failures looked at, on these.
    Validation,
    /// Figures came from these until they had been looked at so often that they are a second set of validation scenes.
    Test,
    /// Published figures come from these, a block of [`Split::BLOCK`] seeds at a time.
    Final,
}

impl Split {
    /// Every split, in the order of their seeds.
    pub const ALL: [Self; 4] = [Self::Train, Self::Validation, Self::Test, Self::Final];
    /// Seeds of a block of `final`.
    pub const BLOCK: u64 = 50_000_000;

    /// The scene seeds of this split.
    pub const fn seeds(self) -> Range<u64> {
        match self {
            Self::Train => 0..1_000_000_000,
            Self::Validation => 1_000_000_000..2_000_000_000,
            Self::Test => 2_000_000_000..3_000_000_000,
            Self::Final => 3_000_000_000..4_000_000_000,
        }
    }

    /// How many scenes this split has.
    pub const fn scenes(self) -> u64 {
        let seeds = self.seeds();
        seeds.end - seeds.start
    }

    /// Whether so many scenes from number `first` on, counted from this split's first, are all of this split.
    pub const fn holds(self, first: u64, count: u64) -> bool {
        match first.checked_add(count) {
            Some(end) => end <= self.scenes(),
            None => false,
        }
    }

    /// The seed of one of this split's scenes, counted from its first; `None` beyond its last, where another split's begin: what is looked at in
    /// the name of one split is never another's.
    pub fn seed(self, index: u64) -> Option<u64> {
        (index < self.scenes()).then(|| self.seeds().start + index)
    }

    /// The split that a scene seed belongs to; `None` for seeds outside all of them (demonstrations, tests).
    pub fn of_seed(seed: u64) -> Option<Self> {
        Self::ALL.into_iter().find(|split| split.seeds().contains(&seed))
    }

    /// The lower-case name, as in folder names.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validation => "validation",
            Self::Test => "test",
            Self::Final => "final",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_seed_has_at_most_one_split() {
        for split in Split::ALL {
            assert_eq!(Split::of_seed(split.seeds().start), Some(split));
            assert_eq!(Split::of_seed(split.seeds().end - 1), Some(split));
        }
        assert_eq!(Split::of_seed(u64::MAX), None);
    }

    #[test]
    fn a_split_has_no_scenes_beyond_its_last() {
        for split in Split::ALL {
            let scenes = split.scenes();
            assert_eq!(split.seed(0), Some(split.seeds().start));
            assert_eq!(split.seed(scenes - 1).and_then(Split::of_seed), Some(split));
            assert_eq!((split.seed(scenes), split.seed(u64::MAX)), (None, None));
            assert!(split.holds(scenes - 2, 2) && split.holds(scenes, 0) && !split.holds(scenes - 2, 3) && !split.holds(u64::MAX, 1));
        }
    }
}
