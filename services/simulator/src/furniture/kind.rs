//! The kinds of scenes, and how often each is drawn.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

/// What a scene is about: its furniture, and how objects are put there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneKind {
    /// A table.
    OpenTable,
    /// A table with a large box on it; objects beside the box and on it (the paper's Table 3, "with box").
    LargeBox,
    /// A table with as many objects as a scene may have, close together.
    Clutter,
    /// A table with stacks of up to four.
    Stacking,
    /// A shelf with several boards, sides and back; objects on boards and on top.
    Shelf,
    /// An open drawer pulled from a cabinet, or a tray on a table; objects in it and around it.
    Drawer,
    /// The paper's evaluation kitchen: a counter with a worktop and a backsplash, its top drawer pulled open. No network is trained on it; forecasts are.
    Kitchen,
    /// A desk with eight to twenty-five objects, a third of them flat, spread wider than a picture. No network is trained on it; the forecasts of how
    /// placements end are.
    Desk,
    /// Eight to twenty-five objects heaped on a table, books and parcels among them, many fallen or leaning. For masks: no other network is
    /// trained on it.
    Pile,
}

impl SceneKind {
    /// All kinds.
    pub const ALL: [Self; 9] =
        [Self::OpenTable, Self::LargeBox, Self::Clutter, Self::Stacking, Self::Shelf, Self::Drawer, Self::Kitchen, Self::Desk, Self::Pile];

    /// The name in snake case.
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenTable => "open_table",
            Self::LargeBox => "large_box",
            Self::Clutter => "clutter",
            Self::Stacking => "stacking",
            Self::Shelf => "shelf",
            Self::Drawer => "drawer",
            Self::Kitchen => "kitchen",
            Self::Desk => "desk",
            Self::Pile => "pile",
        }
    }

    /// Its position in [`Self::ALL`].
    pub fn index(self) -> usize {
        self as usize
    }

    /// Whether its main surface is a table.
    pub fn is_on_table(self) -> bool {
        matches!(self, Self::OpenTable | Self::LargeBox | Self::Clutter | Self::Stacking | Self::Desk | Self::Pile)
    }
}

/// How often each kind is drawn; need not sum to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KindWeights([f64; SceneKind::ALL.len()]);

impl KindWeights {
    /// What is trained on: 30 % open tables, 15 % large boxes, 15 % clutter, 15 % stacking, 12.5 % shelves and 12.5 % drawers. No kitchens, desks
    /// or piles.
    pub fn training() -> Self {
        Self::of(&[
            (SceneKind::OpenTable, 0.3),
            (SceneKind::LargeBox, 0.15),
            (SceneKind::Clutter, 0.15),
            (SceneKind::Stacking, 0.15),
            (SceneKind::Shelf, 0.125),
            (SceneKind::Drawer, 0.125),
        ])
    }

    /// One kind only.
    pub fn only(kind: SceneKind) -> Self {
        Self::of(&[(kind, 1.0)])
    }

    /// The given weights, 0 for kinds not listed; negative and non-finite weights count as 0.
    pub fn of(weights: &[(SceneKind, f64)]) -> Self {
        let mut all = [0.0; SceneKind::ALL.len()];
        for (kind, weight) in weights {
            all[kind.index()] = if weight.is_finite() { weight.max(0.0) } else { 0.0 };
        }
        Self(all)
    }

    /// The weight of a kind.
    pub fn weight(&self, kind: SceneKind) -> f64 {
        self.0[kind.index()]
    }

    /// A random kind; [`SceneKind::OpenTable`] when all weights are 0.
    pub fn draw(&self, rng: &mut impl Rng) -> SceneKind {
        let sum: f64 = self.0.iter().sum();
        if sum <= 0.0 {
            return SceneKind::OpenTable;
        }
        let mut ticket = rng.random_range(0.0..sum);
        for kind in SceneKind::ALL {
            ticket -= self.weight(kind);
            if ticket < 0.0 {
                return kind;
            }
        }
        // Rounding may leave a sliver above the last weight.
        SceneKind::ALL.into_iter().rev().find(|kind| self.weight(*kind) > 0.0).unwrap_or(SceneKind::OpenTable)
    }
}

impl Default for KindWeights {
    fn default() -> Self {
        Self::training()
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn names_match_serde() {
        for kind in SceneKind::ALL {
            assert_eq!(serde_json::to_string(&kind).expect("a string"), format!("\"{}\"", kind.name()));
            assert_eq!(SceneKind::ALL[kind.index()], kind);
        }
    }

    #[test]
    fn training_draws_every_kind_but_the_kitchen_the_desk_and_the_pile() {
        let mut rng = Pcg64::seed_from_u64(7);
        let mut drawn = [0; SceneKind::ALL.len()];
        for _ in 0..2000 {
            drawn[KindWeights::training().draw(&mut rng).index()] += 1;
        }
        for kind in SceneKind::ALL {
            let share = f64::from(drawn[kind.index()]) / 2000.0;
            assert!((share - KindWeights::training().weight(kind)).abs() < 0.03, "{kind:?}: {share}");
        }
        assert_eq!([SceneKind::Kitchen, SceneKind::Desk, SceneKind::Pile].map(|kind| drawn[kind.index()]), [0; 3]);
    }
}
