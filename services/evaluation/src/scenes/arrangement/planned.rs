//! A plan on one view of a task: its moves, how long it took, and the models that it asks.

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use repose_geometry::transform::from_row_major;
use repose_inference::{Engine, HeldScene};
use repose_planner::{Forecasts, PlacementModels, PreparedScene};
use repose_proto::arrange::{ArrangeMove, ArrangeRequest, ArrangeResult};
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, Scene};

use crate::scenes::arrangement::carried_out::Move;
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

/// The models on the scenes that an arrangement goes through, of which a few are held.
pub(super) struct HeldScenes<'a> {
    engine: &'a Engine,
    forecasts: &'a Arc<Forecasts>,
    held: Mutex<VecDeque<Arc<HeldScene>>>,
}

impl<'a> HeldScenes<'a> {
    pub fn new(engine: &'a Engine, forecasts: &'a Arc<Forecasts>) -> Self {
        Self { engine, forecasts, held: Mutex::default() }
    }

    fn held(&self, scene_id: &str, scene: &Arc<Scene>) -> Arc<HeldScene> {
        const SCENES: usize = 4;
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = held.iter().find(|known| known.scene_id() == scene_id) {
            return known.clone();
        }
        let new = Arc::new(HeldScene::new(scene_id.to_owned(), scene.clone()));
        held.push_back(new.clone());
        if held.len() > SCENES {
            held.pop_front();
        }
        new
    }
}

impl PlacementModels for HeldScenes<'_> {
    fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError> {
        self.engine.prior(request, &self.held(&request.scene.scene_id, scene))
    }

    fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        self.engine.score(request, &self.held(&request.scene.scene_id, scene))
    }

    fn forecasts(&self) -> Result<Arc<Forecasts>, CallError> {
        Ok(self.forecasts.clone())
    }
}
