//! The motion of ranked placements.

use repose_motion::MotionConfig;
use repose_motion::wire::planning_scene;
use repose_proto::motion::{MotionPlan, MotionPlanRequest};
use repose_proto::{CallError, Message, RigidTransform, Scene};

use crate::configured::{refused, section};

/// Plans a pick and a placement as the motion service does, with its configuration from the environment (`REPOSE_MOTION__…`). The robot's base
/// stands at `world_from_base`, as its frame says (`robot.json`); without that, where the configuration says. `stop` is asked again and again: true
/// ends the search.
///
/// # Errors
/// `cancelled` where `stop` says so; `failed_precondition` when no placement can be served or the scene has no calibrated camera;
/// `invalid_argument` and `not_found` that name the field.
pub fn plan_motion(
    scene: &Scene,
    request: &MotionPlanRequest,
    world_from_base: Option<&RigidTransform>,
    stop: &dyn Fn() -> bool,
) -> Result<MotionPlan, CallError> {
    request.validate()?;
    let mut config: MotionConfig = section("motion")?;
    if let Some(base) = world_from_base {
        config.world_from_base = base.0;
    }
    let (settings, terms) = (config.planning().map_err(refused)?, config.terms().map_err(refused)?);
    repose_motion::request::plan(scene, &planning_scene(scene)?, request, &settings, &terms, stop)
}
