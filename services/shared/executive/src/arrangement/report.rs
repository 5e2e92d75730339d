//! What is told of an arrangement that is brought about: move by move, and how it ended.

use std::collections::{BTreeMap, BTreeSet};

use repose_proto::CallError;
use repose_proto::GoalTerm;
use repose_proto::arrange::{ArrangeMove, Conflict, Purpose};
use repose_proto::motion::ExecutionOutcome;
use serde::Serialize;

use crate::tried::Tried;

/// A move of an arrangement that was tried, and its result.
#[derive(Debug, Clone, Serialize)]
pub struct TriedMove {
    /// The object, as in the first view; none where that did not have it.
    pub object: Option<u16>,
    /// The move as it was planned; ids are those of its own view.
    pub planned: ArrangeMove,
    /// Moves that were still to come after it.
    pub to_come: usize,
    /// How far it came. Placement 0 is the plan's, others are alternatives for the same goal that the robot could serve; where the move was made before its
    /// turn, all are.
    #[serde(flatten)]
    pub tried: Tried,
}

impl TriedMove {
    /// The result for people: how the move ended, and what else was seen.
    pub fn describe(&self) -> Vec<String> {
        let end = match (self.tried.execution, &self.tried.reason) {
            (Some(ExecutionOutcome::Done), _) => "executed".to_owned(),
            (_, Some(reason)) => reason.clone(),
            (Some(ExecutionOutcome::Stopped), None) => "stopped".to_owned(),
            (Some(ExecutionOutcome::GraspLost), None) => "the grasp was lost".to_owned(),
            (None, None) => "not executed".to_owned(),
        };
        std::iter::once(end).chain(self.tried.disturbances(self.object)).collect()
    }
}

/// How the execution of an arrangement ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ArrangementEnd {
    /// All goals hold, those of [`ArrangementReport::remembered`] as far as was seen.
    Achieved,
    /// From where things stand no moves were found, or none that the hand can make.
    NoArrangement,
    /// As often as may be tried, it was.
    GaveUp,
    /// An object that a goal is about is not seen any more.
    Lost,
    /// The robot was stopped, or a call failed.
    Stopped,
}

/// The result of an arrangement.
#[derive(Debug, Serialize)]
pub struct ArrangementReport {
    /// Goals that were asked for.
    pub wanted: usize,
    /// Goals that hold on the last view, and those that are remembered.
    pub achieved: usize,
    /// How it ended.
    pub ended: ArrangementEnd,
    /// Why it ended there, where it was not achieved.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// By object, whether its goal holds on the last view, by rule; null where that cannot be seen, and where a move of something that it is about came
    /// after that view.
    pub holds: BTreeMap<u16, Option<bool>>,
    /// Objects whose goals were seen to hold and cannot be seen any more: what they are about is hidden, and was not touched since.
    #[serde(skip_serializing_if = "BTreeSet::is_empty")]
    pub remembered: BTreeSet<u16>,
    /// Every move that was tried.
    pub steps: Vec<TriedMove>,
    /// Where the smallest set of goals without an arrangement is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub conflict: Option<Conflict>,
    /// How the robot stands.
    pub robot: String,
    /// The error that ended it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<CallError>,
}

/// What is told while goals are brought about, with the names of the first view.
#[derive(Debug)]
pub enum News<'a> {
    /// Moves are planned from where things stand.
    Planned(PlannedMoves),
    /// A move was tried.
    Tried(&'a TriedMove),
}

/// The moves planned from the current scene.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedMoves {
    /// In order.
    pub moves: Vec<NamedMove>,
    /// The probability that all of them succeed.
    pub probability: Option<f64>,
    /// Objects whose tops these moves uncover, where the rest can only be planned on a view after them, in the first view's ids.
    pub needs_view: Vec<u16>,
    /// The smallest set of goals that is known to have no arrangement, in the first view's ids.
    pub conflict: Option<Conflict>,
}

/// A move that is planned. What the first view did not have is left out.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedMove {
    /// The object.
    pub object: Option<u16>,
    /// What it moves for.
    pub purpose: Purpose,
    /// The terms that its place was chosen by.
    pub goal: Vec<GoalTerm>,
}
