//! One `plan` request on its scene, wherever it is answered: in a service or in-process.

use repose_proto::motion::{MotionPlan, MotionPlanRequest};
use repose_proto::{CallError, Scene};

use crate::pick_place::{PickPlaceRequest, PickPlaceSettings, pick_place_until};
use crate::scene::PlanningScene;
use crate::wire::{self, PlanTerms};

/// Plans the first of the request's placements that can be served, in a scene and what is believed of it ([`wire::planning_scene`]). `stop` is
/// asked between steps.
///
/// # Errors
/// `failed_precondition` when nothing can be grasped or no placement served; `cancelled` when stopped; `invalid_argument` and `not_found` that
/// name the field.
pub fn plan(
    scene: &Scene,
    believed: &PlanningScene,
    request: &MotionPlanRequest,
    settings: &PickPlaceSettings,
    terms: &PlanTerms,
    stop: &dyn Fn() -> bool,
) -> Result<MotionPlan, CallError> {
    if scene.object(request.query).is_none() {
        return Err(CallError::not_found("query", format!("the scene has no object {}", request.query)));
    }
    let placements = request.placements.iter().enumerate().map(|(i, p)| wire::isometry(p, &format!("placements[{i}]")));
    let placements = placements.collect::<Result<Vec<_>, _>>()?;
    let grasps = request.grasps.as_deref().map(wire::grasps).transpose()?;
    let to_plan = PickPlaceRequest {
        scene: believed,
        query: request.query,
        placements: &placements,
        start: &request.start_joints_rad,
        grasps: grasps.as_deref(),
        seed: request.seed,
    };
    let plan = pick_place_until(&to_plan, settings, stop).map_err(|error| wire::call_error(&error))?;
    Ok(wire::motion_plan(&plan, request, scene.stamp_ns, terms))
}
