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
use repose_proto::{CallError, ErrorCode, PlaceRequest};
use repose_simulator::release::ReleaseSettings;
use repose_simulator::scene::{KindWeights, SceneKind};
use serde::{Deserialize, Serialize};

use crate::scenes::one_scene::OneScene;
use crate::scenes::outcome::judge;
use crate::scenes::problem::{Problem, ProblemSettings};
use crate::statistics::forecast_fit::FitSample;

/// The first of the training scenes whose answers are learned from.
pub const FIRST_SEED: u64 = 600_000_000;
/// Distinct answers asked for in each scene.
const ANSWERS: u32 = 10;

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

impl SceneAnswers {
    /// The answers of the `index`-th scene that is learned from; kinds of scenes take turns, and every other answer may be turned. None where
    /// the seed gives no problem or the request is refused.
    ///
    /// # Errors
    /// The planner's and the engine's, on a problem that they should have been able to take.
    pub fn of(index: u64, engine: &Engine, forecasts: &Arc<Forecasts>) -> Result<Self, CallError> {
        let seed = FIRST_SEED + index;
        let none = Self { seed, measures: Vec::new(), succeeded: Vec::new() };
        let mut settings = ProblemSettings::default();
        settings.scene.kinds = KindWeights::only(SceneKind::ALL[index as usize % SceneKind::ALL.len()]);
        let Some(problem) = Problem::of_seed(seed, &settings) else { return Ok(none) };
        let scene = Arc::new(problem.observed.clone());
        let models = OneScene::new(engine, scene.clone()).with_forecasts(forecasts);
        let prepared = PreparedScene::with_id(scene, models.scene_id().to_owned());
        let request = PlaceRequest {
            count: ANSWERS,
            rotation: if (index / SceneKind::ALL.len() as u64).is_multiple_of(3) { Rotation::Yaw } else { Rotation::Fixed },
            seed,
            ..PlaceRequest::new(models.scene_id().to_owned(), problem.query, vec![problem.goal])
        };
        let report = match plan_with_report(&prepared, &request, &models, &mut |_| ControlFlow::Continue(())) {
            Err(error) if error.code == ErrorCode::FailedPrecondition => return Ok(none),
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
