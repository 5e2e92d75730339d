//! A plan on one view of a task: its moves, and how long it took.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use repose_geometry::transform::from_row_major;
use repose_planner::PreparedScene;
use repose_proto::CallError;
use repose_proto::arrange::{ArrangeMove, ArrangeRequest, ArrangeResult};

use crate::scenes::arrangement::carried_out::Move;
use crate::scenes::held_scenes::HeldScenes;
use crate::statistics::processor_time::of_this_thread_ms;

/// A plan, and what it took.
pub(super) struct Planned {
    pub result: ArrangeResult,
    pub plan_ms: f64,
    /// None where the operating system does not tell.
    pub processor_ms: Option<f64>,
}

/// An arrangement, planned and timed.
pub(super) fn planned(prepared: &Arc<PreparedScene>, request: &ArrangeRequest, models: &HeldScenes<'_>) -> Result<Planned, CallError> {
    let (started, before_ms) = (Instant::now(), of_this_thread_ms());
    let result = repose_planner::arrange::arrange(prepared, request, models, &mut |_| ControlFlow::Continue(()))?;
    let plan_ms = started.elapsed().as_secs_f64() * 1e3;
    let processor_ms = of_this_thread_ms().zip(before_ms).map(|(now_ms, before_ms)| now_ms - before_ms);
    Ok(Planned { result, plan_ms, processor_ms })
}

pub(super) fn move_of(step: &ArrangeMove) -> Result<Move, CallError> {
    let motion = from_row_major(&step.placement.placed_from_observed.0).map_err(|e| CallError::internal(e.to_string()))?;
    Ok((step.object, motion))
}
