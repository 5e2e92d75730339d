//! The motion of ranked placements.

use repose_motion::MotionConfig;
use repose_motion::wire::planning_scene;
use repose_proto::motion::{MotionPlan, MotionPlanRequest};
use repose_proto::{CallError, Message, Scene};
use repose_runtime::load_config;

/// Plans a pick and a placement as the motion service does, with its configuration from the environment (`REPOSE_MOTION__…`).
///
/// # Errors
/// `failed_precondition` when no placement can be served or the scene has no calibrated camera; `invalid_argument` and `not_found`
/// that name the field.
pub fn plan_motion(scene: &Scene, request: &MotionPlanRequest) -> Result<MotionPlan, CallError> {
    request.validate()?;
    let config: MotionConfig = load_config("motion", None).map_err(|e| CallError::invalid("config", e.to_string()))?;
    let of_config = |e: repose_runtime::RuntimeError| CallError::invalid("config", e.to_string());
    let settings = config.planning().map_err(|e| of_config(e.into()))?;
    let terms = config.terms().map_err(|e| of_config(e.into()))?;
    repose_motion::request::plan(scene, &planning_scene(scene)?, request, &settings, &terms, &|| false)
}
