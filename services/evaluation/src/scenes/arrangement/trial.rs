//! What a way of planning makes of a task: its moves, and what they come to in the true world.
//!
//! Judged twice: a plan made once on the first view, each move of which is let go where it was planned, from where the object truly stands, and
//! nothing is looked at in between; and what comes of it with a look after every move ([`looking`](super::looking)). Two bars stand beside
//! `arrange`, both without looks: the goals one after another, each planned by itself on what the one before is believed to have left, in the
//! order given; and the same in a few random orders, of which the first counts after which all goals are believed to hold.

use std::ops::ControlFlow;
use std::sync::Arc;

use rand::seq::SliceRandom;
use rand_pcg::Pcg64;
use repose_geometry::transform::from_row_major;
use repose_inference::Engine;
use repose_planner::arrange::goals::all_hold;
use repose_planner::scene::moved::table_after;
use repose_planner::{Forecasts, PreparedScene, plan};
use repose_proto::arrange::{ArrangeRequest, ObjectGoal};
use repose_proto::place::{Outcome, Variant};
use repose_proto::{CallError, ErrorCode, PlaceRequest};
use serde::{Deserialize, Serialize};

use crate::scenes::arrangement::carried_out::{CarriedOut, Move, PlanFault, carried_out};
use crate::scenes::arrangement::failure::FaultDetails;
use crate::scenes::arrangement::looking::{LookingRecord, with_looks};
use crate::scenes::arrangement::planned::{Planned, move_of, planned};
use crate::scenes::arrangement::task::{ArrangementTask, Shapes, TaskKind};
use crate::scenes::held_scenes::HeldScenes;

/// Random orders that the second bar tries.
const RANDOM_ORDERS: usize = 3;

/// What a task came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskRecord {
    /// What makes it hard.
    pub kind: TaskKind,
    /// How many goals it has.
    pub goals: usize,
    /// What was given of the objects' shapes.
    pub shapes: Shapes,
    /// Its slot in its kind and size.
    pub slot: u64,
    /// Its seed.
    pub seed: u64,
    /// The goals.
    pub asked: Vec<String>,
    /// Moves of its known solution.
    pub known_moves: usize,
    /// Moves of the plan.
    pub moves: usize,
    /// What was wrong with the plan; none where all goals held at the end.
    pub fault: Option<PlanFault>,
    /// The move that it went wrong with, counted from 0, where it was one.
    pub at_move: Option<usize>,
    /// What is known of the fault's cause.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<FaultDetails>,
    /// The probability of success that each move was given.
    #[serde(default)]
    pub successes: Vec<f64>,
    /// The probability that the plan gave itself.
    pub probability: Option<f64>,
    /// Placements searched for.
    pub searches: u32,
    /// Wall-clock time of planning, milliseconds.
    pub plan_ms: f64,
    /// Processor time of planning, milliseconds; none where the operating system does not tell.
    pub processor_ms: Option<f64>,
    /// What came of it with a look after every move; none where that was not tried.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub looking: Option<LookingRecord>,
    /// What was wrong with the bars; none where they were not tried.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bars: Option<Bars>,
}

/// Faults of the baselines, which place the goals one after another; null where there was none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bars {
    /// In the given order.
    pub in_order: Option<PlanFault>,
    /// In the best of the random orders.
    pub random_order: Option<PlanFault>,
}

/// How tasks are tried.
#[derive(Debug, Clone, Copy)]
pub struct ArrangementTrialSettings {
    /// What is given of the objects' shapes.
    pub shapes: Shapes,
    /// Which method finds each placement.
    pub variant: Variant,
    /// Whether a look after every move is tried, too.
    pub looks: bool,
    /// Whether the bars are tried, too.
    pub bars: bool,
}

impl TaskRecord {
    /// Whether the plan solved it.
    pub fn solved(&self) -> bool {
        self.fault.is_none()
    }
}

/// Plans a task in every way, and tries the plans.
///
/// # Errors
/// The planner's or the engine's, on a task that they should have been able to take.
pub fn try_task(
    task: &ArrangementTask,
    slot: u64,
    settings: &ArrangementTrialSettings,
    engine: &Engine,
    forecasts: &Arc<Forecasts>,
) -> Result<TaskRecord, CallError> {
    let models = HeldScenes::new(engine).with_forecasts(forecasts);
    let prepared = Arc::new(PreparedScene::new(task.seen(settings.shapes)));
    let request = ArrangeRequest {
        variant: settings.variant,
        seed: task.seed,
        view_yaw_rad: Some(task.viewer.yaw_rad()),
        ..ArrangeRequest::new(prepared.scene_id.clone(), task.goals.clone())
    };
    let Planned { result, plan_ms, processor_ms } = planned(&prepared, &request, &models)?;
    let moves: Vec<Move> = result.moves.iter().map(move_of).collect::<Result<_, CallError>>()?;
    let end = match result.outcome {
        Outcome::Found => carried_out(task, &moves),
        Outcome::Partial => CarriedOut::failed(PlanFault::CutShort, task),
        Outcome::None => CarriedOut::failed(PlanFault::NoPlan, task),
    };
    let planning = Planning { task, variant: settings.variant, models: &models };
    Ok(TaskRecord {
        kind: task.kind,
        goals: task.goals.len(),
        shapes: settings.shapes,
        slot,
        seed: task.seed,
        asked: task.goals.iter().map(ToString::to_string).collect(),
        known_moves: task.moves,
        moves: moves.len(),
        fault: end.fault,
        at_move: end.came.as_ref().map(|(k, _)| *k),
        failure: end.fault.map(|_| FaultDetails::of(task, (&prepared, &task.truth), &result, &end)),
        successes: result.moves.iter().filter_map(|m| m.placement.success).collect(),
        probability: result.probability,
        searches: result.searches,
        plan_ms,
        processor_ms,
        looking: settings.looks.then(|| with_looks(task, settings.shapes, &request, &models)).transpose()?,
        bars: settings.bars.then(|| planning.bars(&prepared)).transpose()?,
    })
}

/// Planning goal by goal.
struct Planning<'a> {
    task: &'a ArrangementTask,
    variant: Variant,
    models: &'a HeldScenes<'a>,
}

/// What planning goal by goal came to.
struct GoalByGoal {
    moves: Vec<Move>,
    /// Whether all goals are believed to hold after them.
    believed: bool,
}

impl GoalByGoal {
    fn fault(&self, task: &ArrangementTask) -> Option<PlanFault> {
        let all_planned = self.believed || !self.moves.is_empty();
        if all_planned { carried_out(task, &self.moves).fault } else { Some(PlanFault::NoPlan) }
    }
}

impl Planning<'_> {
    fn bars(&self, prepared: &PreparedScene) -> Result<Bars, CallError> {
        let in_order = self.one_after_another(prepared, &self.task.goals)?.fault(self.task);
        Ok(Bars { in_order, random_order: self.random_order(prepared)?.fault(self.task) })
    }

    /// The goals in an order. One that holds when its turn comes needs no move; one for which there is no place is left out.
    fn one_after_another(&self, first: &PreparedScene, order: &[ObjectGoal]) -> Result<GoalByGoal, CallError> {
        let mut moves = Vec::new();
        let mut scene = first.clone();
        for goal in order {
            if all_hold(&scene, &self.task.viewer, self.variant, goal.object, &goal.terms) {
                continue;
            }
            let request = PlaceRequest {
                view_yaw_rad: Some(self.task.viewer.yaw_rad()),
                seed: self.task.seed,
                variant: self.variant,
                min_success: Some(0.0),
                ..PlaceRequest::new(scene.scene_id.clone(), goal.object, goal.terms.clone())
            };
            let answered = plan(&scene, &request, self.models, &mut |_| ControlFlow::Continue(()));
            let placements = match answered {
                // It carries another, or too little of it was seen.
                Err(error) if error.code == ErrorCode::FailedPrecondition => continue,
                answered => answered?.placements,
            };
            let Some(best) = placements.first() else { continue };
            let motion = from_row_major(&best.placed_from_observed.0).map_err(|e| CallError::internal(e.to_string()))?;
            scene = table_after(&scene, goal.object, &motion, self.variant);
            moves.push((goal.object, motion));
        }
        let believed = order.iter().all(|goal| all_hold(&scene, &self.task.viewer, self.variant, goal.object, &goal.terms));
        Ok(GoalByGoal { moves, believed })
    }

    /// The first of a few random orders after which all goals are believed to hold, or the last.
    fn random_order(&self, first: &PreparedScene) -> Result<GoalByGoal, CallError> {
        let mut rng = Pcg64::new(u128::from(self.task.seed), 0x00a9_de35);
        let mut order = self.task.goals.clone();
        let mut tried = GoalByGoal { moves: Vec::new(), believed: false };
        for _ in 0..RANDOM_ORDERS {
            order.shuffle(&mut rng);
            tried = self.one_after_another(first, &order)?;
            if tried.believed {
                break;
            }
        }
        Ok(tried)
    }
}
