//! Every ordered pair's relations, learned and by rule.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Point3;
use repose_geometry::ViewerFrame;
use repose_inference::HeldScene;
use repose_proto::scoring::{RealismBy, ScoreRequest};
use repose_proto::{CallError, Scene, SceneRef};
use repose_relations::{ObservedObject, observed};
use serde::Serialize;

use crate::models::LocalModels;

/// The relations of one pair of objects; vectors are in the order of `Relation::ALL`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairRelations {
    /// The object that stands in the relation.
    pub query: u16,
    /// The object that it stands in the relation to.
    pub anchor: u16,
    /// Probabilities by the relation predictor.
    pub learned: Vec<f32>,
    /// Whether each holds by rule on the observed clouds.
    pub rule: Vec<bool>,
}

/// Every ordered pair of a scene's objects, for the camera as viewer.
///
/// # Errors
/// Those of the networks.
pub fn relations(scene: &Arc<Scene>, models: &LocalModels) -> Result<Vec<PairRelations>, CallError> {
    let viewer = ViewerFrame::from_yaw(scene.meta.view_yaw_rad);
    let ids: Vec<u16> = scene.meta.objects.iter().map(|o| o.id).collect();
    let cloud = |id: u16| scene.points_of(id).map(Point3::from).collect::<Vec<_>>();
    let by_rule: BTreeMap<u16, ObservedObject> =
        ids.iter().filter_map(|id| Some((*id, ObservedObject::new(&cloud(*id), &viewer)?))).collect();
    let held = HeldScene::new(scene.id(), scene.clone());
    let mut pairs = Vec::new();
    for query in &ids {
        let anchors: Vec<u16> = ids.iter().copied().filter(|a| a != query).collect();
        let Some(object) = scene.object(*query).filter(|_| !anchors.is_empty()) else { continue };
        let [x, y, z] = object.centroid_m.map(|c| c as f32);
        let request = ScoreRequest {
            scene: SceneRef { scene_id: held.scene_id().to_owned() },
            query: *query,
            anchors: anchors.clone(),
            view_yaw_rad: viewer.yaw_rad(),
            realism: false,
            realism_by: RealismBy::Discriminator,
            relations: true,
            candidates: vec![[x, y, z, 0.0]],
        };
        let reply = models.engine().score(&request, &held)?;
        for (anchor, learned) in anchors.iter().zip(&reply.relations) {
            let rule = observed(&by_rule[query], &by_rule[anchor]).to_vec();
            pairs.push(PairRelations { query: *query, anchor: *anchor, learned: learned.to_vec(), rule });
        }
    }
    Ok(pairs)
}
