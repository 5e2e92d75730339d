//! What is carried out in a cell, or was last, as its viewers see it: a motion, and the sequence or the arrangement that it belongs to.

use repose_proto::motion::ExecutionOutcome;
use repose_proto::{CallError, GoalTerm};
use serde::Serialize;

use crate::arrangement::ArrangementShown;
use crate::stage::GoalStage;

/// What is being carried out in a cell, or was last.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Activity {
    /// The motion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub execution: Option<ExecutionShown>,
    /// The sequence that it belongs to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sequence: Option<SequenceShown>,
    /// Goals that are brought about together, or were last.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arrangement: Option<ArrangementShown>,
}

impl Activity {
    /// What of several moves is under way.
    pub fn under_way(&self) -> Option<&'static str> {
        let sequence = self.sequence.as_ref().filter(|s| !s.ended).map(|_| "a sequence");
        sequence.or_else(|| self.arrangement.as_ref().filter(|a| !a.ended).map(|_| "an arrangement"))
    }

    /// Shows a motion as it is now. One that was only asked for does not take the place of another that is under way, for whose sake it may be
    /// refused; one that `takes_over` does.
    pub fn show_execution(&mut self, motion: &ExecutionShown, takes_over: bool) {
        if takes_over || self.execution.as_ref().is_none_or(|other| other.id == motion.id || other.ended.is_some()) {
            self.execution = Some(motion.clone());
        }
    }

    /// Shows all that is under way as ended by an error, and says what it leaves undone.
    pub fn cut_off(&mut self, why: &CallError) -> Vec<String> {
        let mut undone = Vec::new();
        if let Some(motion) = self.execution.as_mut().filter(|motion| motion.ended.is_none()) {
            motion.ended = Some(ExecutionEnded::Error(why.clone()));
            let phase = motion.phases.get(motion.phase).map_or("its way", String::as_str);
            undone.push(format!("the motion of robot {} with object {}, in {phase}", motion.robot, motion.query));
        }
        if let Some(sequence) = self.sequence.as_mut().filter(|sequence| !sequence.ended) {
            if let Some(step) = sequence.step_under_way() {
                (step.stage, step.error) = (GoalStage::Failed, Some(why.clone()));
            }
            sequence.ended = true;
            undone.push(format!("{} of {} goals of a sequence", sequence.open_goals(), sequence.steps.len()));
        }
        if let Some(arrangement) = self.arrangement.as_mut().filter(|arrangement| !arrangement.ended) {
            undone.push(format!("an arrangement of {} goals, {} moves of it tried", arrangement.goals.len(), arrangement.steps.len()));
            arrangement.failed(why.clone());
        }
        undone
    }
}

/// A motion under way, or the last one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExecutionShown {
    /// Which one it is: several viewers may ask for one at once, and several robots carry one out.
    #[serde(skip)]
    pub id: String,
    /// The robot.
    pub robot: String,
    /// The object.
    pub query: u16,
    /// The names of its phases, in order.
    pub phases: Vec<String>,
    /// The phase it is in.
    pub phase: usize,
    /// How it ended.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ended: Option<ExecutionEnded>,
    /// What a look after it said of every object, in sentences; empty where nobody has looked.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub said: Vec<String>,
}

/// How a motion ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ExecutionEnded {
    /// As motion says.
    Outcome {
        /// How.
        outcome: ExecutionOutcome,
        /// Why, when not done.
        reason: Option<String>,
    },
    /// Without a word of motion's.
    Error(CallError),
}

/// A sequence under way, or the last one.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct SequenceShown {
    /// Its goals in order.
    pub steps: Vec<StepShown>,
    /// Whether it is to end after the goal that it is at.
    pub ending: bool,
    /// Whether it has ended: nothing of it moves any more.
    pub ended: bool,
}

impl SequenceShown {
    /// The goal that it is at; none once it has ended.
    pub fn step_under_way(&mut self) -> Option<&mut StepShown> {
        let is_open = |step: &&mut StepShown| !matches!(step.stage, GoalStage::Held | GoalStage::Failed);
        self.steps.iter_mut().find(is_open).filter(|_| !self.ended)
    }

    /// How many of its goals were not achieved.
    pub fn open_goals(&self) -> usize {
        self.steps.iter().filter(|step| step.stage != GoalStage::Held).count()
    }
}

/// A goal of a sequence.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepShown {
    /// The object, by its id in the first view.
    pub query: u16,
    /// What is to hold, ids as in the first view.
    pub goal: Vec<GoalTerm>,
    /// How far it is.
    pub stage: GoalStage,
    /// Each term by rule on the view after it; empty before.
    pub holds: Vec<bool>,
    /// The result, and changes to anything else, in sentences; empty before.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub said: Vec<String>,
    /// Why it ended without its goal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<CallError>,
}

#[cfg(test)]
mod tests {
    use repose_proto::ErrorCode;

    use super::*;

    fn motion(id: &str) -> ExecutionShown {
        ExecutionShown {
            id: id.to_owned(),
            robot: "panda".to_owned(),
            query: 1,
            phases: vec!["approach".to_owned(), "grasp".to_owned()],
            phase: 0,
            ended: None,
            said: Vec::new(),
        }
    }

    fn step(stage: GoalStage) -> StepShown {
        StepShown { query: 1, goal: Vec::new(), stage, holds: Vec::new(), said: Vec::new(), error: None }
    }

    #[test]
    fn a_sequence_that_is_to_end_is_under_way_until_it_has_ended() {
        let doing = |ending, ended| {
            let sequence = Some(SequenceShown { steps: Vec::new(), ending, ended });
            Activity { sequence, ..Activity::default() }.under_way()
        };
        assert_eq!((doing(false, false), doing(true, false), doing(true, true)), (Some("a sequence"), Some("a sequence"), None));
    }

    #[test]
    fn a_motion_that_is_refused_for_another_leaves_that_one_to_be_seen() {
        let mut activity = Activity::default();
        let seen = |activity: &Activity| activity.execution.as_ref().map(|e| (e.id.clone(), e.phase, e.ended.is_some()));
        let (mut first, mut second) = (motion("first"), motion("second"));
        activity.show_execution(&first, false);
        activity.show_execution(&second, false);
        second.ended = Some(ExecutionEnded::Error(CallError::precondition("another is under way")));
        activity.show_execution(&second, false);
        first.phase = 1;
        activity.show_execution(&first, false);
        assert_eq!(seen(&activity), Some(("first".to_owned(), 1, false)), "it still moves");
        // One that motion has taken is shown, and no other's progress or end is taken for its own.
        let third = motion("third");
        activity.show_execution(&third, true);
        first.ended = Some(ExecutionEnded::Error(CallError::precondition("the first was stopped")));
        activity.show_execution(&first, false);
        assert_eq!(seen(&activity), Some(("third".to_owned(), 0, false)));
    }

    #[test]
    fn what_is_cut_off_is_shown_as_ended_and_said_to_be_undone_and_what_has_ended_stays_as_it_was() {
        let why = CallError::new(ErrorCode::Unavailable, "the console has ended");
        let steps = [GoalStage::Held, GoalStage::Moving, GoalStage::Waiting].map(step).into();
        let sequence = Some(SequenceShown { steps, ending: true, ended: false });
        let mut activity = Activity { execution: Some(motion("first")), sequence, arrangement: Some(ArrangementShown::of(&[])) };
        let undone = activity.cut_off(&why);
        assert_eq!(undone[..2], ["the motion of robot panda with object 1, in approach", "2 of 3 goals of a sequence"]);
        assert_eq!((undone.len(), activity.under_way()), (3, None));
        let (execution, sequence) = (activity.execution.as_ref().expect("shown"), activity.sequence.as_mut().expect("shown"));
        assert_eq!(execution.ended, Some(ExecutionEnded::Error(why.clone())));
        assert_eq!(sequence.steps.iter().map(|step| &step.error).collect::<Vec<_>>(), [&None, &Some(why.clone()), &None]);
        assert_eq!(sequence.step_under_way(), None, "nobody goes on with it");
        let before = activity.clone();
        assert!(activity.cut_off(&CallError::internal("later")).is_empty());
        assert_eq!(activity, before);
    }
}
