//! The motion of ranked placements.

use repose_motion::MotionConfig;
use repose_motion::wire::planning_scene;
use repose_proto::motion::{MotionPlan, MotionPlanRequest};
use repose_proto::{CallError, Message, Scene};

use crate::configured::{refused, section};

/// Plans a pick and a placement as the motion service does, with its configuration from the environment (`REPOSE_MOTION__…`).
///
/// # Errors
/// `failed_precondition` when no placement can be served or the scene has no calibrated camera; `invalid_argument` and `not_found`
/// that name the field.
pub fn plan_motion(scene: &Scene, request: &MotionPlanRequest) -> Result<MotionPlan, CallError> {
    request.validate()?;
    let config: MotionConfig = section("motion")?;
    let (settings, terms) = (config.planning().map_err(refused)?, config.terms().map_err(refused)?);
    repose_motion::request::plan(scene, &planning_scene(scene)?, request, &settings, &terms, &|| false)
}
