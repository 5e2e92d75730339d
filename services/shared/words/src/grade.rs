//! How surely something observed is what a word says: a partial, noisy cloud seldom allows a plain yes or no.

/// Whether a description fits. The order is that of certainty: a conjunction is the minimum.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Grade {
    /// It does not fit.
    No,
    /// It may: measured near the edge of what the word covers, or not measured at all.
    Maybe,
    /// It fits.
    Yes,
}

impl Grade {
    /// `Yes` inside `sure`, `Maybe` inside `possible`, `No` elsewhere. `possible` encloses `sure`; ends are included.
    pub fn within(value: f64, sure: [f64; 2], possible: [f64; 2]) -> Self {
        let inside = |[low, high]: [f64; 2]| (low..=high).contains(&value);
        if inside(sure) {
            Self::Yes
        } else if inside(possible) {
            Self::Maybe
        } else {
            Self::No
        }
    }

    /// `Yes` from `sure` upwards, `Maybe` from `possible`.
    pub fn at_least(value: f64, sure: f64, possible: f64) -> Self {
        Self::within(value, [sure, f64::INFINITY], [possible, f64::INFINITY])
    }

    /// `Yes` up to `sure`, `Maybe` up to `possible`.
    pub fn at_most(value: f64, sure: f64, possible: f64) -> Self {
        Self::within(value, [f64::NEG_INFINITY, sure], [f64::NEG_INFINITY, possible])
    }

    /// Both.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        self.min(other)
    }

    /// Its opposite; what may be may also not be.
    #[must_use]
    pub fn opposite(self) -> Self {
        match self {
            Self::No => Self::Yes,
            Self::Maybe => Self::Maybe,
            Self::Yes => Self::No,
        }
    }
}
