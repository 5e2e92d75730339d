//! What a cell's viewers see of goals that are brought about together: what is asked for, the moves that were tried, and those to come.

use repose_executive::arrangement::{ArrangementEnd, ArrangementReport, NamedMove, PlannedMoves, TriedMove};
use repose_proto::arrange::{Conflict, ObjectGoal, Purpose};
use repose_proto::{CallError, GoalTerm};
use serde::Serialize;

use crate::stage::GoalStage;

/// Goals that are brought about together, or were last. Ids are those of the view that was asked about.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ArrangementShown {
    /// The goals.
    pub goals: Vec<GoalShown>,
    /// The moves that were tried.
    pub steps: Vec<MoveShown>,
    /// The moves that are planned from where things stand; the first of them is under way.
    pub to_come: Vec<MoveShown>,
    /// How far the first of them is.
    pub stage: GoalStage,
    /// The probability that all of them succeed.
    pub probability: Option<f64>,
    /// Objects whose tops they uncover, where the rest can only be planned on a view after them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub needs_view: Vec<u16>,
    /// The smallest set of goals that is known to have no arrangement.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub conflict: Option<Conflict>,
    /// Whether somebody wants no more moves after the one under way.
    pub ending: bool,
    /// Whether no more moves are made.
    pub ended: bool,
    /// How it ended; none where it goes on, or an error ended it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end: Option<ArrangementEnd>,
    /// Why it ended there, and how the robot stands, in sentences.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub said: Vec<String>,
    /// The error that ended it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<CallError>,
}

/// A goal.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GoalShown {
    /// The object.
    pub object: u16,
    /// What shall hold of it at the end.
    pub terms: Vec<GoalTerm>,
    /// Whether it holds on the last view; none before the end, and where that cannot be seen.
    pub holds: Option<bool>,
}

/// A move.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MoveShown {
    /// The object; none where the view that was asked about did not have it.
    pub object: Option<u16>,
    /// What it moves for.
    pub purpose: Purpose,
    /// The terms that its place is chosen by.
    pub goal: Vec<GoalTerm>,
    /// The result, and changes to anything else, in sentences; empty before.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub said: Vec<String>,
}

impl ArrangementShown {
    /// Nothing done yet.
    pub fn of(goals: &[ObjectGoal]) -> Self {
        let goal = |goal: &ObjectGoal| GoalShown { object: goal.object, terms: goal.terms.clone(), holds: None };
        Self {
            goals: goals.iter().map(goal).collect(),
            steps: Vec::new(),
            to_come: Vec::new(),
            stage: GoalStage::Waiting,
            probability: None,
            needs_view: Vec::new(),
            conflict: None,
            ending: false,
            ended: false,
            end: None,
            said: Vec::new(),
            error: None,
        }
    }

    /// Moves are planned anew.
    pub fn planned(&mut self, planned: PlannedMoves) {
        let shown = |m: NamedMove| MoveShown { object: m.object, purpose: m.purpose, goal: m.goal, said: Vec::new() };
        self.to_come = planned.moves.into_iter().map(shown).collect();
        (self.probability, self.needs_view, self.conflict) = (planned.probability, planned.needs_view, planned.conflict);
    }

    /// The first of the moves to come was tried.
    pub fn tried(&mut self, step: &TriedMove) {
        if !self.to_come.is_empty() {
            let planned = self.to_come.remove(0);
            self.steps.push(MoveShown { said: step.describe(), ..planned });
        }
        // What was said of the rest was said of it together with this one.
        self.probability = None;
    }

    /// It came to an end by itself.
    pub fn ended(&mut self, told: ArrangementReport) {
        for goal in &mut self.goals {
            goal.holds = told.holds.get(&goal.object).copied().flatten();
        }
        self.stage = if told.ended == ArrangementEnd::Achieved { GoalStage::Held } else { GoalStage::Failed };
        self.end = Some(told.ended);
        let remembered =
            told.remembered.iter().map(|object| format!("the goal of object {object} held when it was last seen; it is hidden now"));
        self.said = told.why.into_iter().chain(remembered).chain([told.robot]).collect();
        self.error = told.error;
        self.conflict = told.conflict;
        self.to_come.clear();
        self.needs_view.clear();
        self.ended = true;
    }

    /// An error ended it.
    pub fn failed(&mut self, error: CallError) {
        (self.stage, self.error, self.ended) = (GoalStage::Failed, Some(error), true);
        self.to_come.clear();
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use super::*;

    fn goals() -> Vec<ObjectGoal> {
        let goal = |object: u16, term: &str| ObjectGoal { object, terms: vec![term.parse().expect("a term")] };
        vec![goal(2, "left_of:3"), goal(4, "near:3")]
    }

    fn planned(objects: &[u16]) -> PlannedMoves {
        let to_goal = |object: &u16| NamedMove { object: Some(*object), purpose: Purpose::Goal, goal: Vec::new() };
        PlannedMoves { moves: objects.iter().map(to_goal).collect(), probability: Some(0.7), needs_view: Vec::new(), conflict: None }
    }

    #[test]
    fn what_is_planned_anew_takes_the_place_of_what_was_to_come() {
        let mut shown = ArrangementShown::of(&goals());
        shown.planned(planned(&[2, 4]));
        shown.planned(planned(&[4]));
        assert_eq!(shown.to_come.iter().map(|m| m.object).collect::<Vec<_>>(), [Some(4)]);
        assert_eq!((shown.probability, shown.ended), (Some(0.7), false));
    }

    #[test]
    fn the_end_says_what_holds_and_what_cannot_be_seen() {
        let mut shown = ArrangementShown::of(&goals());
        shown.planned(planned(&[2, 4]));
        shown.ended(ArrangementReport {
            wanted: 2,
            achieved: 1,
            ended: ArrangementEnd::Lost,
            why: Some("object 4 is gone".to_owned()),
            holds: BTreeMap::from([(2, Some(true)), (4, None)]),
            remembered: BTreeSet::new(),
            steps: Vec::new(),
            conflict: None,
            robot: "panda stands idle".to_owned(),
            error: None,
        });
        assert_eq!(shown.goals.iter().map(|goal| goal.holds).collect::<Vec<_>>(), [Some(true), None]);
        assert_eq!((shown.stage, shown.ended, shown.to_come.len()), (GoalStage::Failed, true, 0));
        assert_eq!(shown.said, ["object 4 is gone", "panda stands idle"]);
    }
}
