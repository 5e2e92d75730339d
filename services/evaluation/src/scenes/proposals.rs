//! What the prior and the planner propose on a scene, let go: the places that the outcome network is asked about, to learn from.
//!
//! Places that the simulator draws by itself (`repose_simulator::trials`) know the true scene; these come from what a camera saw of it, with
//! the errors that a network and a partial cloud make: a little above what is under them or in it, over an edge, in what was hidden.

use std::ops::ControlFlow;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3};
use repose_dataset::ReleaseRecord;
use repose_geometry::transform::{from_row_major, placed_from_observed, yaw_of};
use repose_inference::Engine;
use repose_planner::{PlacementModels, PreparedScene, plan};
use repose_proto::place::{Rotation, Variant};
use repose_proto::scoring::PriorRequest;
use repose_proto::{CallError, ErrorCode, PlaceRequest, RELATION_COUNT, SceneRef, limits};
use repose_simulator::release::ReleaseSettings;
use repose_simulator::trials::let_go;

use crate::scenes::one_scene::OneScene;
use crate::scenes::problem::Problem;

/// How many places of each kind are proposed for a problem.
#[derive(Debug, Clone, PartialEq)]
pub struct ProposalSettings {
    /// Draws of the prior, translations only.
    pub prior: u32,
    /// Draws of the prior, turned too.
    pub turned: u32,
    /// Placements of the planner by geometry alone: what `best` asks the outcome network about.
    pub placements: u32,
    /// How a release is simulated.
    pub release: ReleaseSettings,
}

impl ProposalSettings {
    /// The most places of a problem: a quarter of them is as many as the planner gives.
    pub const MOST: u32 = 4 * limits::MAX_PLACEMENTS as u32;

    /// `per_problem` places: half of them draws of the prior, a quarter turned draws, a quarter of the planner.
    pub fn new(per_problem: u32) -> Self {
        let (turned, placements) = (per_problem / 4, per_problem / 4);
        let release = ReleaseSettings { ends_at_rest: true, ..ReleaseSettings::default() };
        Self { prior: per_problem - turned - placements, turned, placements, release }
    }
}

/// Lets the problem's query go where it is proposed; the same for the same problem, weights and settings.
///
/// # Errors
/// The engine's or the planner's, on a problem that they should have been able to take.
pub fn proposals(problem: &Problem, engine: &Engine, settings: &ProposalSettings) -> Result<Vec<ReleaseRecord>, CallError> {
    let scene = Arc::new(problem.observed.clone());
    let models = OneScene::new(engine, scene.clone());
    let mut motions = prior_motions(problem, &models, Rotation::Fixed, settings.prior)?;
    motions.extend(prior_motions(problem, &models, Rotation::Yaw, settings.turned)?);
    if settings.placements > 0 {
        motions.extend(planned_motions(problem, scene, &models, settings.placements)?);
    }
    Ok(motions.iter().filter_map(|motion| record_of(problem, motion, &settings.release)).collect())
}

/// Draws of the prior for the problem's goal: world positions of the query's observed centroid (metres) and turns about z (radians).
///
/// # Errors
/// The engine's.
pub fn prior_draws(problem: &Problem, models: &OneScene<'_>, rotation: Rotation, count: u32) -> Result<Vec<[f32; 4]>, CallError> {
    let mut goal = [0; RELATION_COUNT];
    goal[problem.goal.relation.index()] = if problem.goal.holds { 1 } else { -1 };
    let request = PriorRequest {
        scene: SceneRef { scene_id: models.scene_id().to_owned() },
        query: problem.query,
        anchor: problem.goal.anchor,
        goal,
        view_yaw_rad: problem.viewer.yaw_rad(),
        rotation,
        count,
        seed: problem.seed,
    };
    Ok(models.prior(&request, models.scene())?.candidates)
}

/// The motion that carries an observed centroid to a draw's position, turned about it by the draw's yaw.
pub fn motion_to(centroid: &Point3<f64>, draw: &[f32; 4]) -> Isometry3<f64> {
    let [x, y, z, yaw_rad] = draw.map(f64::from);
    placed_from_observed(centroid, &Point3::new(x, y, z), yaw_rad)
}

fn prior_motions(problem: &Problem, models: &OneScene<'_>, rotation: Rotation, count: u32) -> Result<Vec<Isometry3<f64>>, CallError> {
    let Some(object) = models.scene().object(problem.query).filter(|_| count > 0) else { return Ok(Vec::new()) };
    let centroid = Point3::from(object.centroid_m);
    Ok(prior_draws(problem, models, rotation, count)?.iter().map(|draw| motion_to(&centroid, draw)).collect())
}

fn planned_motions(
    problem: &Problem,
    scene: Arc<repose_proto::Scene>,
    models: &OneScene<'_>,
    count: u32,
) -> Result<Vec<Isometry3<f64>>, CallError> {
    let request = PlaceRequest {
        variant: Variant::Geometric,
        rotation: Rotation::Yaw,
        count,
        seed: problem.seed,
        ..PlaceRequest::new(models.scene_id().to_owned(), problem.query, vec![problem.goal])
    };
    match plan(&PreparedScene::new(scene), &request, models, &mut |_| ControlFlow::Continue(())) {
        // It is believed to carry another object: nothing is proposed.
        Err(error) if error.code == ErrorCode::FailedPrecondition => Ok(Vec::new()),
        answered => Ok(answered?.placements.iter().filter_map(|p| from_row_major(&p.placed_from_observed.0).ok()).collect()),
    }
}

/// Lets the query go where `placed_from_observed` carries it.
fn record_of(problem: &Problem, placed_from_observed: &Isometry3<f64>, settings: &ReleaseSettings) -> Option<ReleaseRecord> {
    let index = problem.index_of(problem.query)?;
    let placed = placed_from_observed * problem.truth.objects[index].world_from_object;
    let_go(&problem.truth, index, &placed, yaw_of(placed_from_observed), settings)
}

#[cfg(test)]
mod tests {
    use repose_dataset::Split;
    use repose_networks::Models as Networks;

    use super::*;
    use crate::scenes::problem::ProblemSettings;

    #[test]
    fn proposals_are_of_the_query_and_the_same_again() {
        let networks = Networks::embedded().expect("embedded weights");
        let engine = Engine::new(networks, 1);
        let problem = (0..20).find_map(|i| Problem::of_split(Split::Validation, i, &ProblemSettings::default())).expect("a problem");
        let settings = ProposalSettings::new(4);
        let records = proposals(&problem, &engine, &settings).expect("proposals");
        assert_eq!(records, proposals(&problem, &engine, &settings).expect("proposals"));
        assert!(records.len() >= 3, "{records:?}");
        assert!(records.iter().all(|r| r.scene_seed == problem.seed && r.object == problem.query && r.moved_m >= 0.0));
        // What is written down is the motion that was tried.
        let index = problem.index_of(problem.query).expect("the query");
        let standing = &problem.truth.objects[index].world_from_object;
        for record in &records {
            let placed = record.placed_from_settled(standing) * standing;
            assert!((placed.translation.vector.cast::<f32>() - nalgebra::Vector3::from(record.origin_m)).norm() < 1e-5);
        }
    }

    #[test]
    fn a_candidate_carries_the_centroid_to_its_position() {
        let centroid = Point3::new(0.4, -0.2, 0.1);
        let motion = motion_to(&centroid, &[0.1, 0.2, 0.3, 1.0]);
        assert!((motion * centroid - Point3::new(0.1, 0.2, 0.3)).norm() < 1e-6);
        let ahead = motion * (centroid + nalgebra::Vector3::x()) - motion * centroid;
        assert!((ahead.y.atan2(ahead.x) - 1.0).abs() < 1e-6, "counter-clockwise seen from above");
    }
}
