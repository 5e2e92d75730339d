//! How high an object's bottom is, learned: which of a few levels.
//!
//! The rule of [`crate::standing`] looks at what shows around an object's lowest points. That is silent where something nearer hides its foot, where
//! it stands in what it hides, and where it lies on something that shows no top. But there are only so many levels at which it can end
//! ([`crate::foot_levels`]). Boosted trees say of each how likely it is the right one. Where they are in doubt, a network that looks at the picture
//! corrects them ([`crate::foot_picture`]). They are fitted on objects of training scenes (`repose train --network foot`), and come with the program, in `weights/foot.json`, like those for
//! backs ([`crate::back`]).

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use crate::boosted_trees::{BoostedTrees, UnreadableTrees};
use crate::foot_levels::{Level, MEASURES, RIGHT_M};

/// The file that the trees come in.
pub(crate) static FILE: &str = include_str!("../weights/foot.json");

/// A level that is this much likelier than the rule's is taken in its place. Of what was tried, the fewest wrong objects on training scenes held out.
const LIKELIER: f64 = 0.08;
/// A level that is this likely may be the right one, though another is chosen. With half of that the same placements are right on validation scenes.
const MAY_BE: f64 = 0.1;
/// How far below the chosen level others may be the right one, metres. What is let go that much higher still stays where it lands.
const LOWER_M: f32 = 0.025;
/// How far above the chosen level the right one may be for what is let go there to stay where it lands, metres.
const HIGHER_M: f32 = 0.04;

/// The data that it was fitted on.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FootFitData {
    /// Training scenes.
    pub scenes: usize,
    /// Objects in them, each view counted.
    pub objects: usize,
    /// Levels of those.
    pub levels: usize,
    /// Of those, levels that were right.
    pub right: usize,
}

/// How likely an object's bottom is at a level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Foot {
    measures: Vec<String>,
    fitted_on: FootFitData,
    log_odds: BoostedTrees,
}

impl Foot {
    /// The one that comes with the program.
    pub fn own() -> &'static Self {
        static OWN: LazyLock<Foot> = LazyLock::new(|| Foot::read(FILE).expect("a test reads it"));
        &OWN
    }

    /// The data that it was fitted on.
    pub fn fitted_on(&self) -> &FootFitData {
        &self.fitted_on
    }

    /// From trees for the logarithm of the odds, on [`MEASURES`].
    ///
    /// # Errors
    /// When a branch leads nowhere or a value is not finite.
    pub fn new(log_odds: BoostedTrees, fitted_on: FootFitData) -> Result<Self, UnreadableTrees> {
        Self { measures: MEASURES.map(str::to_owned).to_vec(), fitted_on, log_odds }.checked()
    }

    /// Reads what [`Foot`] was written as, in JSON.
    ///
    /// # Errors
    /// When it is none, or reads other measures.
    pub fn read(text: &str) -> Result<Self, UnreadableTrees> {
        serde_json::from_str::<Self>(text)?.checked()
    }

    fn checked(self) -> Result<Self, UnreadableTrees> {
        self.log_odds.check_reads("log_odds", &self.measures, &MEASURES)?;
        Ok(self)
    }

    /// How likely a level is the right one, from its measures.
    pub fn probability(&self, measures: &[f32]) -> f64 {
        self.log_odds.probability(measures)
    }

    /// The logarithm of the odds that a level is the right one.
    pub fn log_odds(&self, level: &Level) -> f64 {
        self.log_odds.of(&level.measures)
    }

    /// The level of an object's bottom by the trees alone, as [`Self::chosen`]. `None` without levels.
    pub fn choice(&self, levels: &[Level]) -> Option<Chosen> {
        Self::chosen(levels.iter().map(|level| (level.height_m, self.probability(&level.measures))))
    }

    /// Of levels (world z, metres) and how likely each is the right one, that of the object's bottom: the rule's, which is the first, unless another is
    /// clearly likelier. `None` without levels.
    pub fn chosen(levels: impl Iterator<Item = (f32, f64)>) -> Option<Chosen> {
        let said: Vec<Chosen> =
            levels.map(|(height_m, probability)| Chosen { height_m, probability, lower_m: 0.0, landing_probability: 1.0 }).collect();
        let rule = *said.first()?;
        // Of equals the first.
        let best = said.iter().copied().reduce(|best, other| if other.probability > best.probability { other } else { best })?;
        let chosen = if best.probability >= rule.probability + LIKELIER { best } else { rule };
        let lower_m = said.iter().filter(|other| other.probability >= MAY_BE).map(|other| chosen.height_m - other.height_m);
        // Nearer ones are right where the chosen one is.
        let lower_m = lower_m.filter(|lower_m| (RIGHT_M..=LOWER_M).contains(lower_m)).fold(0.0, f32::max);
        let lands = |other: &&Chosen| (-lower_m.max(RIGHT_M)..=HIGHER_M).contains(&(other.height_m - chosen.height_m));
        let likeliest = |are: bool| said.iter().filter(|other| lands(other) == are).map(|other| other.probability).fold(0.0, f64::max);
        let (well, badly) = (likeliest(true), likeliest(false));
        Some(Chosen { lower_m, landing_probability: well / (well + badly).max(f64::MIN_POSITIVE), ..chosen })
    }
}

/// A level that was chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chosen {
    /// World z, metres.
    pub height_m: f32,
    /// How likely the object's bottom is within [`RIGHT_M`] of it.
    pub probability: f64,
    /// How much lower the bottom may be: so far below is the lowest level nearby that may be the right one too, metres; 0 without one.
    pub lower_m: f32,
    /// How likely the bottom is so near to it that an object which is let go by it neither is pressed into what is under it nor falls: by the likeliest of
    /// the levels that are, and the likeliest of those that are not.
    pub landing_probability: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boosted_trees::{Branch, DecisionTree, TreeSplit};

    #[test]
    fn what_comes_with_the_program_reads_these_measures() {
        assert!(Foot::own().fitted_on.right > 0);
        let text = serde_json::to_string(Foot::own()).unwrap();
        assert_eq!(&Foot::read(&text).unwrap(), Foot::own());
        let other = text.replacen("\"is_rule\"", "\"is_guess\"", 1);
        assert!(Foot::read(&other).unwrap_err().to_string().contains("measures"));
    }

    /// Levels are as likely as the first measure's sign says: by these logarithms of the odds.
    fn says(low: f32, high: f32) -> Foot {
        let tree = DecisionTree { splits: vec![TreeSplit(0, 0.5, [Branch::Leaf(0), Branch::Leaf(1)])], leaves: vec![low, high] };
        Foot::new(BoostedTrees { bias: 0.0, trees: vec![tree] }, FootFitData::default()).unwrap()
    }

    fn level(height_m: f32, first: f32) -> Level {
        let mut measures = vec![0.0; MEASURES.len()];
        measures[0] = first;
        Level { height_m, measures }
    }

    #[test]
    fn how_much_lower_a_foot_may_be_is_how_far_down_the_next_likely_level_is() {
        let lower_m = |foot: Foot, levels: &[Level]| foot.choice(levels).unwrap().lower_m;
        let levels = [level(0.20, 1.0), level(0.19, 0.0), level(0.22, 0.0), level(0.10, 0.0)];
        assert!(
            (lower_m(says(-1.0, 2.0), &levels) - 0.01).abs() < 1e-6,
            "not up, and not so far down that it would not land where it is let go"
        );
        assert_eq!(lower_m(says(-1.0, 2.0), &[level(0.20, 1.0), level(0.195, 0.0)]), 0.0, "as right as the one that is chosen");
        assert_eq!(lower_m(says(-4.0, 2.0), &levels), 0.0, "hardly likely");
        assert_eq!(lower_m(says(-1.0, 2.0), &levels[..1]), 0.0);
    }

    #[test]
    fn what_is_let_go_by_a_landing_probability_well_where_the_other_likely_levels_are_near() {
        let lands = |height_m: f32| says(-1.0, 2.0).choice(&[level(0.20, 1.0), level(height_m, 0.0)]).unwrap().landing_probability;
        let [likely, other] = [2.0f64, -1.0].map(crate::boosted_trees::probability_of);
        assert_eq!([0.2, 0.19, 0.178, 0.235].map(lands), [1.0; 4], "it is let go a little higher, and comes down a little");
        for height_m in [0.16, 0.25] {
            assert!((lands(height_m) - likely / (likely + other)).abs() < 1e-6, "pressed or falling: {}", lands(height_m));
        }
    }

    #[test]
    fn the_rules_level_is_kept_unless_another_is_clearly_likelier() {
        let levels = [level(0.1, 0.0), level(0.2, 1.0), level(0.3, 1.0)];
        assert_eq!(says(0.0, 2.0).choice(&levels).map(|chosen| chosen.height_m), Some(0.2), "the first of equals");
        assert_eq!(says(0.0, 0.2).choice(&levels).map(|chosen| chosen.height_m), Some(0.1), "hardly likelier");
        assert_eq!(says(0.0, 2.0).choice(&[]), None);
    }
}
