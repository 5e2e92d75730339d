//! Asking for an arrangement: goals about several objects that shall all hold at the end, and the moves that bring it about.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{check_finite, check_range};
use crate::place::{Outcome, Placement, ReachingRobot, Rotation, Variant};
use crate::relation::validate_terms;
use crate::{CallError, GoalTerm, Message, SceneRef, limits};

/// What shall hold of one object at the end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ObjectGoal {
    /// The object.
    pub object: u16,
    /// Its relations to other objects, where all of them stand at the end. Terms that must not hold may stand alone.
    pub terms: Vec<GoalTerm>,
}

impl std::fmt::Display for ObjectGoal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let terms: Vec<String> = self.terms.iter().map(ToString::to_string).collect();
        write!(f, "{}={}", self.object, terms.join(","))
    }
}

fn two() -> u32 {
    2
}

fn sixty() -> u32 {
    60
}

fn three() -> u32 {
    3
}

/// Which objects must move, in which order, and where to, so that all goals hold together at the end?
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ArrangeRequest {
    /// The scene. The bulk form of the request encloses it.
    pub scene: SceneRef,
    /// What shall hold at the end: one entry an object.
    pub goals: Vec<ObjectGoal>,
    /// The viewer's direction; the camera's where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub view_yaw_rad: Option<f64>,
    /// Whether objects may be turned.
    #[serde(default)]
    pub rotation: Rotation,
    /// The source of every random number.
    #[serde(default)]
    pub seed: u64,
    /// Which method finds each placement.
    #[serde(default)]
    pub variant: Variant,
    /// Only places that this robot reaches.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<ReachingRobot>,
    /// How often an object may be set down aside for a while, to make room (2).
    #[serde(default = "two")]
    pub max_parkings: u32,
    /// Alternative places that are tried for each move (3).
    #[serde(default = "three")]
    pub alternatives: u32,
    /// Placements searched for at most, over all alternatives (60). More find more, and take longer.
    #[serde(default = "sixty")]
    pub max_searches: u32,
    /// Time after which the search ends, milliseconds. Results then depend on the machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_ms: Option<u64>,
    /// Whether only the first move is made before the rest is planned anew on a fresh view. Then sure moves that uncover a top are preferred to a
    /// complete answer that takes its chances on what the view does not show. Workers of earlier releases refuse the field.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub fresh_views: bool,
}

impl ArrangeRequest {
    /// A request with every default.
    pub fn new(scene_id: String, goals: Vec<ObjectGoal>) -> Self {
        Self {
            scene: SceneRef { scene_id },
            goals,
            view_yaw_rad: None,
            rotation: Rotation::Fixed,
            seed: 0,
            variant: Variant::Best,
            robot: None,
            max_parkings: two(),
            alternatives: three(),
            max_searches: sixty(),
            time_ms: None,
            fresh_views: false,
        }
    }
}

impl Message for ArrangeRequest {
    const SCHEMA: &'static str = "ArrangeRequest.v1";

    fn validate(&self) -> Result<(), CallError> {
        self.scene.validate()?;
        check_range("goals", self.goals.len() as f64, 1.0..=limits::MAX_ARRANGED as f64)?;
        for (i, goal) in self.goals.iter().enumerate() {
            let field = format!("goals[{i}]");
            if goal.object == 0 {
                return Err(CallError::invalid(format!("{field}.object"), "0 is the background, not an object"));
            }
            if self.goals[..i].iter().any(|before| before.object == goal.object) {
                let message = format!("object {} has a goal already: give all its terms in one", goal.object);
                return Err(CallError::invalid(format!("{field}.object"), message));
            }
            if goal.terms.is_empty() {
                return Err(CallError::invalid(format!("{field}.terms"), "at least one term"));
            }
            validate_terms(&goal.terms, goal.object, &format!("{field}.terms"))?;
        }
        check_finite("view_yaw_rad", self.view_yaw_rad.as_slice())?;
        self.robot.as_ref().map_or(Ok(()), |robot| robot.validate("robot"))?;
        check_range("max_parkings", f64::from(self.max_parkings), 0.0..=4.0)?;
        check_range("alternatives", f64::from(self.alternatives), 1.0..=16.0)?;
        check_range("max_searches", f64::from(self.max_searches), 1.0..=1000.0)?;
        self.time_ms.map_or(Ok(()), |v| check_range("time_ms", v as f64, 1.0..=limits::MAX_REMAINING_MS as f64))
    }
}

/// What a move is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Purpose {
    /// The object's goal, or that of another about it: it stays there.
    Goal,
    /// To make room: it stands on what must move, or where another must go.
    Aside,
}

/// One move.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ArrangeMove {
    /// The object that moves.
    pub object: u16,
    /// What for.
    pub purpose: Purpose,
    /// The terms that its place was chosen by: its own and, turned about, those of others about it, as far as the others stand already.
    pub goal: Vec<GoalTerm>,
    /// Where it goes, with its evidence, from where it stands then.
    pub placement: Placement,
}

/// How it is known that goals cannot hold together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Proof {
    /// No arrangement of any objects satisfies them: they contradict each other.
    Contradiction,
    /// None was found on this scene; there may be one.
    NotFound,
}

/// Goals that cannot hold together: without any one of them the others can, or that was not found out in time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Conflict {
    /// The goals, of which terms that take no part are left out where it is a contradiction.
    pub goals: Vec<ObjectGoal>,
    /// How that is known.
    pub proof: Proof,
    /// Whether the set is smallest: no goal of it can be left out.
    pub smallest: bool,
}

/// The answer to an [`ArrangeRequest`]: identical bytes for the same request, weights and kernel, unless time ended it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ArrangeResult {
    /// How the search ended. `partial`: the budget ended it, or it needs a view of what the moves uncover, and the moves, if any, satisfy some of the
    /// goals only.
    pub outcome: Outcome,
    /// The moves, in order. None are needed where all goals hold as things stand.
    pub moves: Vec<ArrangeMove>,
    /// Objects whose goals hold as they stand, and that stay where they are.
    pub satisfied: Vec<u16>,
    /// Objects whose goals the moves do not reach.
    pub open: Vec<u16>,
    /// Objects on top of which open goals are, and whose tops the view hides under what stands there: the moves uncover them, and the rest is to be
    /// planned on a view after them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub needs_view: Vec<u16>,
    /// The probability that all moves succeed: the product of what each says of its success. Null where nobody evaluated one of them.
    pub probability: Option<f64>,
    /// Why there is no arrangement, where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conflict: Option<Conflict>,
    /// Placements searched for.
    pub searches: u32,
    /// BLAKE3 of the weights; empty where no network was asked.
    pub weights_hash: String,
    /// The scene planned on.
    pub scene_id: String,
    /// The viewer used.
    pub view_yaw_rad: f64,
    /// The goals.
    pub goals: Vec<ObjectGoal>,
    /// The request's seed.
    pub seed: u64,
}

impl Message for ArrangeResult {
    const SCHEMA: &'static str = "ArrangeResult.v1";
}
