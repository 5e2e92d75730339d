//! The ten relations, and goals made of them.

use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{CallError, limits};

/// How many relations there are; the length of every relation vector.
pub const RELATION_COUNT: usize = 10;

/// A relation between a query and an anchor: `i left_of j` reads "the query i is to the left of the anchor j", as the viewer sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Relation {
    /// To the viewer's left.
    LeftOf,
    /// To the viewer's right.
    RightOf,
    /// Nearer the viewer.
    InFrontOf,
    /// Farther from the viewer.
    Behind,
    /// Higher, over it.
    Above,
    /// Lower, under it.
    Below,
    /// At most 5 cm apart.
    Near,
    /// At most 1 mm apart.
    Touching,
    /// Centres at most 1 mm apart horizontally.
    Centered,
    /// Orientations differ by less than π/20.
    Aligned,
}

impl Relation {
    /// All relations, in the order of every relation vector.
    pub const ALL: [Self; RELATION_COUNT] = [
        Self::LeftOf,
        Self::RightOf,
        Self::InFrontOf,
        Self::Behind,
        Self::Above,
        Self::Below,
        Self::Near,
        Self::Touching,
        Self::Centered,
        Self::Aligned,
    ];

    /// The relation that the anchor then has to the query: `i left_of j` is `j right_of i`. All others read the same both ways.
    pub fn converse(self) -> Self {
        match self {
            Self::LeftOf => Self::RightOf,
            Self::RightOf => Self::LeftOf,
            Self::InFrontOf => Self::Behind,
            Self::Behind => Self::InFrontOf,
            Self::Above => Self::Below,
            Self::Below => Self::Above,
            Self::Near | Self::Touching | Self::Centered | Self::Aligned => self,
        }
    }

    /// The place in a relation vector.
    pub fn index(self) -> usize {
        self as usize
    }

    /// The name on the wire.
    pub fn as_str(self) -> &'static str {
        ["left_of", "right_of", "in_front_of", "behind", "above", "below", "near", "touching", "centered", "aligned"][self.index()]
    }
}

impl std::fmt::Display for Relation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for Relation {
    type Err = CallError;

    fn from_str(name: &str) -> Result<Self, CallError> {
        Self::ALL.into_iter().find(|r| r.as_str() == name).ok_or_else(|| {
            let known = Self::ALL.map(Self::as_str).join(", ");
            CallError::invalid("goal", format!("unknown relation {name:?}; the relations are {known}"))
        })
    }
}

fn yes() -> bool {
    true
}

/// One term of a goal: the relation of the query to an anchor must hold, or must not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GoalTerm {
    /// The relation.
    pub relation: Relation,
    /// The anchor object's id.
    pub anchor: u16,
    /// Whether it must hold (`true`) or must not.
    #[serde(default = "yes")]
    pub holds: bool,
}

impl std::fmt::Display for GoalTerm {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}{}:{}", if self.holds { "" } else { "not:" }, self.relation, self.anchor)
    }
}

impl FromStr for GoalTerm {
    type Err = CallError;

    /// Reads `left_of:3` or `not:near:4`.
    fn from_str(text: &str) -> Result<Self, CallError> {
        let (holds, rest) = text.strip_prefix("not:").map_or((true, text), |rest| (false, rest));
        let (relation, anchor) = rest
            .split_once(':')
            .ok_or_else(|| CallError::invalid("goal", format!("expected RELATION:ANCHOR or not:RELATION:ANCHOR, got {text:?}")))?;
        let anchor = anchor
            .parse()
            .map_err(|_| CallError::invalid("goal", format!("expected an object id (0 to 65535) after {relation}:, got {anchor:?}")))?;
        Ok(Self { relation: relation.parse()?, anchor, holds })
    }
}

/// Checks a whole goal: at least one positive term, not too many, no anchor that is the query. Terms that contradict each other are not
/// an error: no placement is found then, and the tally says which term kept candidates out.
///
/// # Errors
/// `invalid_argument` on `goal` or `goal[i]…`.
pub fn validate_goal(goal: &[GoalTerm], query: u16) -> Result<(), CallError> {
    if !goal.iter().any(|t| t.holds) {
        return Err(CallError::invalid("goal", "at least one term must hold (offsets are taken from its anchor)"));
    }
    validate_terms(goal, query, "goal")
}

/// Checks terms about an object one by one: not too many, no anchor that is the object itself or the background.
///
/// # Errors
/// `invalid_argument` on `field` or `field[i].anchor`.
pub fn validate_terms(terms: &[GoalTerm], object: u16, field: &str) -> Result<(), CallError> {
    if terms.len() > limits::MAX_GOAL_TERMS {
        return Err(CallError::invalid(field, format!("at most {} terms, got {}", limits::MAX_GOAL_TERMS, terms.len())));
    }
    for (i, term) in terms.iter().enumerate() {
        if term.anchor == object {
            return Err(CallError::invalid(format!("{field}[{i}].anchor"), format!("object {object} is the query itself")));
        }
        if term.anchor == 0 {
            return Err(CallError::invalid(format!("{field}[{i}].anchor"), "0 is the background, not an object"));
        }
    }
    Ok(())
}
