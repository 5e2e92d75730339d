//! What becomes of `best`'s own answers in training scenes, with what it measured of them: what the forecast of success is fitted on.
//!
//! The planner chooses the best of thousands of candidates, and so picks lucky ones: a forecast must learn on what it chose. The scenes are
//! training scenes far from the first ones, which is where data for networks begins: on scenes that the outcome network has learned by
//! heart its word is surer than elsewhere.

use std::ops::ControlFlow;
use std::sync::Arc;

use repose_geometry::transform::from_row_major;
use repose_inference::Engine;
use repose_planner::{Forecasts, PreparedScene, plan_with_report};
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
    /// What was measured of each answer, best first.
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
    /// The answers of the `index`-th scene that is learned from; kinds of scenes take turns, and every other answer may be turned. None where
    /// the seed gives no problem or the request is refused.
    ///
    /// # Errors
    /// The planner's and the engine's, on a problem that they should have been able to take.
    pub fn of(index: u64, engine: &Engine, forecasts: &Arc<Forecasts>) -> Result<Self, CallError> {
        let seed = FIRST_SEED + index;
        let none = Self { seed, measures: Vec::new(), succeeded: Vec::new() };
        let (kind, turn) = (KINDS[index as usize % KINDS.len()], index / KINDS.len() as u64);
        let mut settings = ProblemSettings::default();
        settings.scene.kinds = KindWeights::only(kind);
        settings.relations = relations(turn).to_vec();
        let Some(problem) = Problem::of_seed(seed, &settings) else { return Ok(none) };
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
        let report = match plan_with_report(&prepared, &request, &models, &mut |_| ControlFlow::Continue(())) {
            Err(error) if matches!(error.code, ErrorCode::FailedPrecondition | ErrorCode::NotFound) => return Ok(none),
            answered => answered?,
        };
        let came = report.answers.iter().zip(&report.result.placements).filter_map(|(judged, placement)| {
            let placed = from_row_major(&placement.placed_from_observed.0).ok()?;
            Some((judged.success_measures.clone()?, judge(&problem, &placed, &ReleaseSettings::default())?.joint()))
        });
        let (measures, succeeded) = came.unzip();
        Ok(Self { seed, measures, succeeded })
    }

    /// To learn from.
    pub fn samples(&self) -> impl Iterator<Item = FitSample> + '_ {
        self.measures
            .iter()
            .zip(&self.succeeded)
            .map(|(measures, came_true)| FitSample { measures: measures.clone(), came_true: *came_true })
    }
}
