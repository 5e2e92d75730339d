//! What a robot makes of a task that looks after every move, as `arrange --execute` does: the first move of a plan is carried out in the true
//! world, the same camera looks again, and the rest is planned anew on what it sees.
//!
//! A fault ends it: what slipped or tipped is not tried again. Where a view gives no moves, as what was set down hides what they would go by, the
//! complete plan before it goes on. A goal that was seen to hold counts as held while what it is about is hidden,
//! untouched. It ends where the planner believes that all goals hold, and whether they do is asked of the true table.

use std::collections::BTreeSet;
use std::sync::Arc;

use repose_planner::PreparedScene;
use repose_planner::arrange::goals::all_hold;
use repose_proto::CallError;
use repose_proto::arrange::{ArrangeMove, ArrangeRequest, ArrangeResult, ObjectGoal};
use repose_proto::place::Outcome;
use repose_simulator::scene::SimulatedScene;
use serde::{Deserialize, Serialize};

use crate::scenes::arrangement::carried_out::{PlanFault, fault_of, released_at};
use crate::scenes::arrangement::failure::FaultDetails;
use crate::scenes::arrangement::planned::{Planned, move_of, planned};
use crate::scenes::arrangement::task::{ArrangementTask, Shapes};
use crate::scenes::held_scenes::HeldScenes;

/// What a task came to with a look after every move.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LookingRecord {
    /// Moves that were made.
    pub moves: usize,
    /// Plans that were made, the last of which may have had nothing to do.
    pub plans: usize,
    /// Plans that ended where a view was needed.
    pub partial_plans: usize,
    /// Moves of an earlier plan, which were made where the newest view gave none.
    pub earlier_moves: usize,
    /// What was wrong; none where all goals held at the end.
    pub fault: Option<PlanFault>,
    /// What is known of the fault's cause.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<FaultDetails>,
    /// The probability of success that each move was given.
    pub successes: Vec<f64>,
    /// Placements searched for, in the plan with the most of them.
    pub most_searches: u32,
    /// Wall-clock time of the first plan, milliseconds.
    pub first_plan_ms: f64,
    /// Wall-clock time of the plan that took longest, milliseconds.
    pub longest_plan_ms: f64,
    /// Wall-clock time of all plans, milliseconds.
    pub all_plans_ms: f64,
}

impl LookingRecord {
    /// Whether it was solved.
    pub fn solved(&self) -> bool {
        self.fault.is_none()
    }
}

/// Plans, moves and looks until all goals are believed to hold, or until something goes wrong.
pub(super) fn with_looks(
    task: &ArrangementTask,
    shapes: Shapes,
    request: &ArrangeRequest,
    models: &HeldScenes<'_>,
) -> Result<LookingRecord, CallError> {
    let mut run = Run {
        task,
        shapes,
        request,
        models,
        table: task.truth.clone(),
        held: BTreeSet::new(),
        earlier: Vec::new(),
        record: LookingRecord {
            moves: 0,
            plans: 0,
            partial_plans: 0,
            earlier_moves: 0,
            fault: None,
            failure: None,
            successes: Vec::new(),
            most_searches: 0,
            first_plan_ms: 0.0,
            longest_plan_ms: 0.0,
            all_plans_ms: 0.0,
        },
    };
    run.record.fault = run.until_the_end()?;
    Ok(run.record)
}

/// A task that is being carried out.
struct Run<'a> {
    task: &'a ArrangementTask,
    shapes: Shapes,
    request: &'a ArrangeRequest,
    models: &'a HeldScenes<'a>,
    /// The true table.
    table: SimulatedScene,
    /// Objects whose goals held when they were last seen, and nothing that they are about was carried since.
    held: BTreeSet<u16>,
    /// What the last complete plan has left to do.
    earlier: Vec<ArrangeMove>,
    record: LookingRecord,
}

impl Run<'_> {
    fn until_the_end(&mut self) -> Result<Option<PlanFault>, CallError> {
        let most_moves = 2 * self.task.goals.len() + self.request.max_parkings as usize;
        let mut seen = self.task.seen(self.shapes);
        loop {
            let prepared = Arc::new(PreparedScene::new(seen));
            let Some(goals) = self.goals_in_view(&prepared) else { return Ok(Some(PlanFault::Lost)) };
            if goals.is_empty() {
                return Ok(self.believed_done());
            }
            let planned = self.planned(&prepared, goals)?;
            let Some(step) = self.next_move(&prepared, &planned.result) else {
                let fault = match planned.result.outcome {
                    Outcome::Found => return Ok(self.believed_done()),
                    Outcome::Partial => PlanFault::CutShort,
                    Outcome::None => PlanFault::NoPlan,
                };
                self.record.failure = Some(FaultDetails::without_move(self.task, &planned.result, &self.table));
                return Ok(Some(fault));
            };
            if self.record.moves >= most_moves {
                return Ok(Some(PlanFault::GaveUp));
            }
            let Some(came) = released_at(self.task, &self.table, &move_of(&step)?) else { return Ok(Some(PlanFault::NoPlan)) };
            self.record.moves += 1;
            self.record.successes.extend(step.placement.success);
            self.held.retain(|held| !self.task.goals.iter().any(|goal| goal.object == *held && is_about(goal, step.object)));
            if let Some(fault) = fault_of(&came) {
                self.record.failure = Some(FaultDetails::of_move(self.task, (&prepared, &self.table), &step, (&self.table, &came)));
                return Ok(Some(fault));
            }
            self.table = self.table.with_poses(&came.world_from_objects);
            let Some(again) = self.task.seen_again(&self.table, self.shapes, self.record.moves as u64) else {
                return Ok(Some(PlanFault::Lost));
            };
            seen = again;
        }
    }

    /// The first move of a plan; where it has none, the next one of the complete plan before it, as long as its object is seen.
    fn next_move(&mut self, prepared: &PreparedScene, result: &ArrangeResult) -> Option<ArrangeMove> {
        if let Some((first, rest)) = result.moves.split_first() {
            self.earlier = if result.outcome == Outcome::Found { rest.to_vec() } else { Vec::new() };
            return Some(first.clone());
        }
        let goes_on = result.outcome != Outcome::Found && self.earlier.first().is_some_and(|m| prepared.object(m.object, "goals").is_ok());
        let step = goes_on.then(|| self.earlier.remove(0))?;
        self.record.earlier_moves += 1;
        Some(step)
    }

    /// What is asked of the planner on a view: the goals but those that are remembered. None where something is not seen that must be.
    fn goals_in_view(&mut self, prepared: &PreparedScene) -> Option<Vec<ObjectGoal>> {
        let is_seen = |object: u16| prepared.object(object, "goals").is_ok();
        let mut asked = Vec::new();
        for goal in &self.task.goals {
            if !is_seen(goal.object) || !goal.terms.iter().all(|term| is_seen(term.anchor)) {
                self.held.contains(&goal.object).then_some(())?;
                continue;
            }
            match all_hold(prepared, &self.task.viewer, self.request.variant, goal.object, &goal.terms) {
                true => self.held.insert(goal.object),
                false => self.held.remove(&goal.object),
            };
            asked.push(goal.clone());
        }
        Some(asked)
    }

    fn planned(&mut self, prepared: &Arc<PreparedScene>, goals: Vec<ObjectGoal>) -> Result<Planned, CallError> {
        let scene = repose_proto::SceneRef { scene_id: prepared.scene_id.clone() };
        let planned = planned(prepared, &ArrangeRequest { scene, goals, fresh_views: true, ..self.request.clone() }, self.models)?;
        if self.record.plans == 0 {
            self.record.first_plan_ms = planned.plan_ms;
        }
        self.record.plans += 1;
        self.record.partial_plans += usize::from(planned.result.outcome == Outcome::Partial);
        self.record.most_searches = self.record.most_searches.max(planned.result.searches);
        self.record.longest_plan_ms = self.record.longest_plan_ms.max(planned.plan_ms);
        self.record.all_plans_ms += planned.plan_ms;
        Ok(planned)
    }

    /// What is wrong with a table on which all goals are believed to hold.
    fn believed_done(&mut self) -> Option<PlanFault> {
        let unmet = FaultDetails::of_table(self.task, &self.table);
        let is_wrong = !unmet.unmet.is_empty();
        self.record.failure = is_wrong.then_some(unmet);
        is_wrong.then_some(PlanFault::Goal)
    }
}

fn is_about(goal: &ObjectGoal, object: u16) -> bool {
    goal.object == object || goal.terms.iter().any(|term| term.anchor == object)
}
