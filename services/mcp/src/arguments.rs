//! What the tools take. The descriptions here are what an agent reads.

use repose_proto::Relation;
use schemars::JsonSchema;
use serde::Deserialize;

/// Arguments of `look`.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LookArguments {}

/// Arguments of `plan`: either `say`, or `move` and `goal`.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlanArguments {
    /// The scene that numbers are of: what `look` called it. Without it the newest view is taken, on which objects can be told by words only.
    #[serde(default)]
    pub scene: Option<String>,
    /// The whole wish as a sentence: "put the red mug to the left of the box, not near the bowl".
    #[serde(default)]
    pub say: Option<String>,
    /// The object to move: its number, or what it looks like ("the red mug", "the largest box").
    #[serde(default, rename = "move")]
    pub object: Option<Named>,
    /// What must hold afterwards, all of it; at least one term must not be negated.
    #[serde(default)]
    pub goal: Vec<Term>,
    /// Whether the object may be turned about the vertical.
    #[serde(default)]
    pub may_turn: bool,
    /// Least probability that the placement succeeds, 0 to 1; 0.5 unless given.
    #[serde(default)]
    pub min_success: Option<f64>,
    /// Another seed draws other candidates.
    #[serde(default)]
    pub seed: u64,
}

/// An object, by its number in a scene or by what it looks like.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Named {
    /// The number that `look` gave it.
    Number(u16),
    /// A description that fits no other object: "the red mug".
    Description(String),
}

/// One thing that must hold, or must not.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Term {
    /// The relation of the moved object to the other, as the camera sees it.
    pub relation: Relation,
    /// The other object. What holds of several takes a term for each; a sentence may say "the books".
    pub to: Named,
    /// Whether it must not hold.
    #[serde(default)]
    pub not: bool,
}

/// Arguments of `execute`.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExecuteArguments {
    /// The plan, as `plan` called it.
    pub plan: String,
}

/// Arguments of `state`.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StateArguments {}

/// Arguments of `stop`.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StopArguments {
    /// Why; the robot's state says it to whoever asks.
    #[serde(default)]
    pub reason: Option<String>,
}
