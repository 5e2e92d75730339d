//! Placements on a scene: one, or an arrangement of several.

use std::ops::ControlFlow;
use std::sync::Arc;

use repose_planner::{NoModels, PreparedScene, StopReason};
use repose_proto::place::Variant;
use repose_proto::{ArrangeRequest, ArrangeResult, CallError, Message, PlaceRequest, PlaceResult, Scene};

use crate::configured::robots;
use crate::models::LocalModels;

/// Plans as the planner does, which knows from its configuration where robots stand (`REPOSE_PLANNER__…`). `models` is asked only for variants
/// that use networks, `stop` again and again: true ends the search.
///
/// # Errors
/// `invalid_argument` and `not_found` that name the field; `cancelled` where `stop` says so; those of `models`.
pub fn plan(
    scene: &Arc<Scene>,
    request: &PlaceRequest,
    models: impl FnOnce() -> Result<Arc<LocalModels>, CallError>,
    stop: &dyn Fn() -> bool,
) -> Result<PlaceResult, CallError> {
    request.validate()?;
    let mut request = request.clone();
    robots()?.complete(&mut request.robot);
    let prepared = PreparedScene::new(scene.clone());
    let go_on = &mut |_| if stop() { ControlFlow::Break(StopReason::Cancelled) } else { ControlFlow::Continue(()) };
    match request.variant {
        Variant::Geometric => repose_planner::plan(&prepared, &request, &NoModels, go_on),
        _ => repose_planner::plan(&prepared, &request, models()?.as_ref(), go_on),
    }
}

/// Plans an arrangement; otherwise as [`plan`].
///
/// # Errors
/// As [`plan`].
pub fn arrange(
    scene: &Arc<Scene>,
    request: &ArrangeRequest,
    models: impl FnOnce() -> Result<Arc<LocalModels>, CallError>,
) -> Result<ArrangeResult, CallError> {
    request.validate()?;
    let mut request = request.clone();
    robots()?.complete(&mut request.robot);
    let prepared = Arc::new(PreparedScene::new(scene.clone()));
    let go_on = &mut |_| ControlFlow::Continue(());
    match request.variant {
        Variant::Geometric => repose_planner::arrange::arrange(&prepared, &request, &NoModels, go_on),
        _ => repose_planner::arrange::arrange(&prepared, &request, models()?.as_ref(), go_on),
    }
}
