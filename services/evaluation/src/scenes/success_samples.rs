//! What becomes of `best`'s own answers in training scenes, with what it measured of them: what the forecast of success is fitted on.
//!
//! The planner chooses the best of thousands of candidates, and so picks lucky ones: a forecast must learn on what it chose. The scenes are
//! training scenes far from the first ones, which is where data for networks begins: on scenes that the outcome network has learned by
//! heart its word is surer than elsewhere.

use std::ops::ControlFlow;
use std::sync::Arc;

use nalgebra::Isometry3;
use repose_geometry::transform::from_row_major;
use repose_inference::Engine;
use repose_planner::{Forecasts, PlanReport, PreparedScene, plan_turned_with_report, plan_with_report, turned_over, turns};
use repose_proto::place::Rotation;
use repose_proto::{CallError, ErrorCode, PlaceRequest, Relation};
use repose_simulator::release::ReleaseSettings;
use repose_simulator::scene::{KindWeights, SceneKind};
use serde::{Deserialize, Serialize};

use crate::scenes::one_scene::OneScene;
use crate::scenes::outcome::judge;
use crate::scenes::perturbation::Perturbation;
use crate::scenes::problem::{GOAL_RELATIONS, Problem, ProblemSettings};
use crate::statistics::forecast_fit::FitSample;

/// The first of the training scenes whose answers are learned from.
pub const FIRST_SEED: u64 = 600_000_000;
/// Distinct answers asked for in each scene.
const ANSWERS: u32 = 10;
/// Of them on each other side of the object. All sides are planned for where it finds no place as it lies, …
const ANSWERS_ON_SIDE: u32 = 3;
/// … and else one of them in every so many turns of the kinds.
const ONE_SIDE_IN: u64 = 3;
/// The kinds of scenes, in turn: crowded desks as often as four others, for they have the most that goes wrong.
const KINDS: [SceneKind; 12] = {
    use SceneKind::*;
    [OpenTable, Desk, LargeBox, Clutter, Desk, Stacking, Shelf, Desk, Drawer, Kitchen, Desk, Pile]
};

/// The answers of one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneAnswers {
    /// The scene.
    pub seed: u64,
    /// What was measured of each answer, best first; those with the object as it lies before those on other sides.
    pub measures: Vec<Vec<f32>>,
    /// Whether each succeeded.
    pub succeeded: Vec<bool>,
}

/// What goals are drawn of in a turn of the kinds: the directions in every other, else what is set on something or close to it.
fn relations(turn: u64) -> &'static [Relation] {
    match turn % 2 {
        0 => &GOAL_RELATIONS,
        _ if turn % 8 == 7 => &[Relation::Near, Relation::Touching],
        _ => &[Relation::Above],
    }
}

impl SceneAnswers {
    /// The answers of the `index`-th scene that is learned from; kinds of scenes take turns, and in every third turn the object may be turned
    /// about the vertical. None where the seed gives no problem or the request is refused.
    ///
    /// # Errors
    /// The planner's and the engine's, on a problem that they should have been able to take.
    pub fn of(index: u64, engine: &Engine, forecasts: &Arc<Forecasts>) -> Result<Self, CallError> {
        let seed = FIRST_SEED + index;
        let mut answers = Self { seed, measures: Vec::new(), succeeded: Vec::new() };
        let (kind, turn) = (KINDS[index as usize % KINDS.len()], index / KINDS.len() as u64);
        let mut settings = ProblemSettings::default();
        settings.scene.kinds = KindWeights::only(kind);
        settings.relations = relations(turn).to_vec();
        let Some(problem) = Problem::of_seed(seed, &settings) else { return Ok(answers) };
        // The masks are given, or found.
        let found = turn % 4 >= 2;
        let observed = if found { Perturbation::FoundMasks.observed(&problem, &settings.perception)? } else { problem.observed.clone() };
        let scene = Arc::new(observed);
        let models = OneScene::new(engine, scene.clone()).with_forecasts(forecasts);
        let prepared = PreparedScene::with_id(scene, models.scene_id().to_owned());
        let request = PlaceRequest {
            count: ANSWERS,
            rotation: if turn.is_multiple_of(3) { Rotation::Yaw } else { Rotation::Fixed },
            seed,
            // What fails is to be learned too.
            min_success: Some(0.0),
            ..PlaceRequest::new(models.scene_id().to_owned(), problem.query, vec![problem.goal])
        };
        let go_on = &mut |_| ControlFlow::Continue(());
        let report = match plan_with_report(&prepared, &request, &models, go_on) {
            Err(error) if matches!(error.code, ErrorCode::FailedPrecondition | ErrorCode::NotFound) => return Ok(answers),
            answered => answered?,
        };
        answers.add(&problem, &report, &Isometry3::identity());
        let mut sides = turns(&prepared, problem.query)?;
        if !report.answers.is_empty() {
            let one = sides.get(seed as usize % sides.len().max(1)).copied();
            sides = one.into_iter().filter(|_| turn % ONE_SIDE_IN == 1).collect();
        }
        for side in sides {
            let table = turned_over(&prepared, problem.query, side)?;
            let on_side = PlaceRequest { count: ANSWERS_ON_SIDE, rotation: Rotation::Yaw, ..request.clone() };
            answers.add(&problem, &plan_turned_with_report(&table, &on_side, &models, go_on)?, &side);
        }
        Ok(answers)
    }

    /// Lets the object go at the answers of a search, in which it had been turned over.
    fn add(&mut self, problem: &Problem, report: &PlanReport, turned_from_observed: &Isometry3<f64>) {
        for (judged, placement) in report.answers.iter().zip(&report.result.placements) {
            let (Ok(placed), Some(measures)) = (from_row_major(&placement.placed_from_observed.0), &judged.success_measures) else {
                continue;
            };
            let Some(came) = judge(problem, &(placed * turned_from_observed), &ReleaseSettings::default()) else { continue };
            self.measures.push(measures.clone());
            self.succeeded.push(came.joint());
        }
    }

    /// To learn from.
    pub fn samples(&self) -> impl Iterator<Item = FitSample> + '_ {
        self.measures
            .iter()
            .zip(&self.succeeded)
            .map(|(measures, came_true)| FitSample { measures: measures.clone(), came_true: *came_true })
    }
}
