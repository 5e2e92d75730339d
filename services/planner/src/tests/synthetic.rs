//! Made scenes as the planner's tests need them.

use std::sync::Arc;

use repose_proto::place::PlaceRequest;

use crate::judge::problem::{self, PlacementProblem};
use crate::scene::candidate::CandidatePose;
use crate::scene::prepared::PreparedScene;
use crate::scene::query::QueryObject;
use crate::settings::PlanSettings;

pub use repose_made_scenes::SceneBuilder;

/// Scenes, prepared.
pub trait Prepared {
    /// The scene, prepared.
    fn prepared(&self) -> PreparedScene;
}

impl Prepared for SceneBuilder {
    fn prepared(&self) -> PreparedScene {
        PreparedScene::new(Arc::new(self.scene()))
    }
}

/// The candidate whose axis stands at (x, y) and whose bottom is at a height, not turned.
pub fn standing_at(query: &QueryObject, x: f32, y: f32, bottom_m: f32) -> CandidatePose {
    let offset = query.shape.axis_offset();
    CandidatePose { centroid_m: [x - offset.x, y - offset.y, bottom_m + query.shape.centroid_height_m()], yaw_rad: 0.0 }
}

/// Has work done on the problem that a request poses on a scene, with the object as it lies.
pub fn posed<T>(
    prepared: &PreparedScene,
    request: &PlaceRequest,
    settings: &PlanSettings,
    work: impl FnOnce(PlacementProblem<'_>) -> T,
) -> T {
    problem::posed(prepared, None, request, settings, work).unwrap()
}
