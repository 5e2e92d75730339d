//! How far carrying a placement out came.

use std::collections::BTreeMap;

use nalgebra::Isometry3;
use repose_geometry::transform::from_row_major;
use repose_proto::CallError;
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, Heeded, MotionPlan};
use repose_proto::place::Placement;
use repose_tracking::Fate;
use serde::Serialize;

/// How far carrying a placement out came.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Tried {
    /// The placement that motion chose, from 0; none where there was none to choose from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub placement: Option<usize>,
    /// How much its motion heeded of the hidden parts of things; none where that was everything, or where there was none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heeded: Option<Heeded>,
    /// How the execution ended; none where nothing was executed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub execution: Option<ExecutionOutcome>,
    /// Why it ended there, or why nothing was executed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Objects that do not stand where they were to be on the views after it, ids of the first view; none where nobody looked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fates: Option<BTreeMap<u16, Fate>>,
}

impl Tried {
    /// A plan that was executed, whatever came of it.
    pub(crate) fn executed(plan: &MotionPlan, reply: ExecuteReply) -> Self {
        let (placement, execution) = (Some(plan.placement), Some(reply.outcome));
        Self { placement, heeded: plan.heeded, execution, reason: reply.reason, fates: None }
    }

    /// A failure before the end of an execution.
    pub(crate) fn failed(error: &CallError) -> Self {
        Self { reason: Some(error.to_string()), ..Self::default() }
    }

    /// What was seen after it of the objects, `carried` among them, for people.
    pub fn disturbances(&self, carried: Option<u16>) -> Vec<String> {
        self.fates.as_ref().map_or_else(Vec::new, |fates| repose_sentences::fate::describe(carried, fates))
    }

    /// Where the executed placement put the object; the identity where nothing was placed.
    pub(crate) fn moved(&self, placements: &[Placement]) -> Result<Isometry3<f64>, CallError> {
        let chosen = match (self.execution, self.placement) {
            (Some(ExecutionOutcome::Done), Some(chosen)) => chosen,
            _ => return Ok(Isometry3::identity()),
        };
        let placement = placements.get(chosen).ok_or_else(|| CallError::internal("motion chose no placement of ours"))?;
        from_row_major(&placement.placed_from_observed.0).map_err(|e| CallError::internal(e.to_string()))
    }
}
