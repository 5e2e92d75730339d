//! What becomes of places that were proposed on training scenes, with what the planner measures of them: what `best`'s stability is fitted on.

use std::sync::Arc;

use nalgebra::Point3;
use repose_dataset::ReleaseRecord;
use repose_inference::Engine;
use repose_planner::learned::stability::{COUNT, measures};
use repose_planner::scene::candidate::CandidatePose;
use repose_planner::scene::query::QueryObject;
use repose_planner::settings::Fixed;
use repose_planner::{PlacementModels, PreparedScene};
use repose_proto::scoring::{RealismBy, ScoreRequest};
use repose_proto::{CallError, SceneRef};

use crate::scenes::one_scene::OneScene;
use crate::scenes::outcome::STABLE_M;
use crate::scenes::problem::Problem;
use crate::statistics::forecast_fit::FitSample;

/// One sample a release of the problem's query; none where the planner does not take the query.
///
/// # Errors
/// The engine's.
pub fn stability_samples(problem: &Problem, engine: &Engine, releases: &[ReleaseRecord]) -> Result<Vec<FitSample>, CallError> {
    let scene = Arc::new(problem.observed.clone());
    let models = OneScene::new(engine, scene.clone());
    let prepared = PreparedScene::with_id(scene, models.scene_id().to_owned());
    let tried: Vec<(CandidatePose, bool)> =
        releases.iter().filter_map(|release| Some((candidate_of(problem, release)?, f64::from(release.moved_m) < STABLE_M))).collect();
    let said = said_of(problem, &models, RealismBy::Outcome, tried.iter().map(|(candidate, _)| candidate.row()).collect())?;
    let Some(of) = measured(problem, &prepared) else { return Ok(Vec::new()) };
    let sample = |((candidate, stable), outcome): (&(CandidatePose, bool), f32)| FitSample {
        measures: of(candidate, outcome).to_vec(),
        came_true: *stable,
    };
    Ok(tried.iter().zip(said).map(sample).collect())
}

/// What a network says of candidates (world position of the query's observed centroid, metres; turn about z, radians).
///
/// # Errors
/// The engine's.
pub fn said_of(problem: &Problem, models: &OneScene<'_>, by: RealismBy, candidates: Vec<[f32; 4]>) -> Result<Vec<f32>, CallError> {
    let request = ScoreRequest {
        scene: SceneRef { scene_id: models.scene_id().to_owned() },
        query: problem.query,
        anchors: Vec::new(),
        view_yaw_rad: problem.viewer.yaw_rad(),
        realism: true,
        realism_by: by,
        relations: false,
        candidates,
    };
    Ok(models.score(&request, models.scene())?.realism)
}

/// What the planner measures of a candidate and the outcome network's word on it; none where the planner does not take the query.
pub fn measured<'a>(problem: &Problem, prepared: &'a PreparedScene) -> Option<impl Fn(&CandidatePose, f32) -> [f32; COUNT] + 'a> {
    let fixed = Fixed::default();
    let query = QueryObject::new(prepared, problem.query, 0.0, &fixed).ok()?;
    Some(move |candidate: &CandidatePose, outcome: f32| measures(prepared, &query, candidate, outcome, &fixed))
}

/// The candidate that a release tried: where it carried the observed centroid.
fn candidate_of(problem: &Problem, release: &ReleaseRecord) -> Option<CandidatePose> {
    let object = problem.observed.object(problem.query).filter(|_| release.object == problem.query)?;
    let standing = &problem.truth.objects[problem.index_of(problem.query)?].world_from_object;
    let centroid = release.placed_from_settled(standing) * Point3::from(object.centroid_m);
    Some(CandidatePose::new(&centroid, f64::from(release.yaw_rad)))
}
