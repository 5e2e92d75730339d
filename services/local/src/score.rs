//! What the networks say of given placements, so that others can judge the networks alone.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use repose_geometry::transform::{from_row_major, yaw_of};
use repose_inference::HeldScene;
use repose_proto::scoring::{RealismBy, ScoreRequest, check_place};
use repose_proto::{CallError, RELATION_COUNT, Scene, SceneRef, limits};

use crate::models::LocalModels;

/// How far from upright a transform's rotation may be: candidates turn about world z only.
const UPRIGHT_RAD: f64 = 1e-3;

/// Scores of n placements, each a probability.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacementScores {
    /// Of realism, shape `[n]`.
    pub realism: Vec<f32>,
    /// Of each relation to each anchor, shape `[n, anchors, relations]`, flattened but for the relations.
    pub relations: Vec<[f32; RELATION_COUNT]>,
}

/// Scores placements of an object, each the motion of world space that carries its observed points to the placed ones.
///
/// # Errors
/// `not_found` on `query`; `invalid_argument` on `transforms` or `transforms[i]`; those of the networks.
pub fn score(
    scene: &Arc<Scene>,
    (query, anchors): (u16, &[u16]),
    transforms: &[[f64; 16]],
    realism_by: RealismBy,
    models: &LocalModels,
) -> Result<PlacementScores, CallError> {
    if transforms.len() > limits::MAX_CANDIDATES {
        let message = format!("at most {} transforms, got {}", limits::MAX_CANDIDATES, transforms.len());
        return Err(CallError::invalid("transforms", message));
    }
    let object = scene.object(query).ok_or_else(|| CallError::not_found("query", format!("the frame has no object {query}")))?;
    let centroid = Point3::from(object.centroid_m);
    let candidates = transforms.iter().enumerate().map(|(i, entries)| {
        let field = format!("transforms[{i}]");
        let placed_from_observed = from_row_major(entries).map_err(|e| CallError::invalid(&field, e.to_string()))?;
        let up = placed_from_observed.rotation * Vector3::z();
        if up.angle(&Vector3::z()) > UPRIGHT_RAD {
            return Err(CallError::invalid(&field, "only turns about world z can be scored"));
        }
        let position = (placed_from_observed * centroid).cast::<f32>();
        check_place(&field, &position.coords.into())?;
        Ok([position.x, position.y, position.z, yaw_of(&placed_from_observed) as f32])
    });
    let held = HeldScene::new(scene.id(), scene.clone());
    let request = ScoreRequest {
        scene: SceneRef { scene_id: held.scene_id().to_owned() },
        query,
        anchors: anchors.to_vec(),
        view_yaw_rad: scene.meta.view_yaw_rad,
        realism: true,
        realism_by,
        relations: true,
        candidates: candidates.collect::<Result<Vec<_>, CallError>>()?,
    };
    let reply = models.engine().score(&request, &held)?;
    Ok(PlacementScores { realism: reply.realism, relations: reply.relations })
}
