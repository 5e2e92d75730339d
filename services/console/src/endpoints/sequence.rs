//! Goals carried out one after another: each planned on a fresh view, moved, and looked at again. Ends at the first that is not achieved.
//!
//! A sequence belongs to its cell, not to whoever asked for it: it goes on when the page is closed, and everyone sees it. One at a time.

use std::sync::Arc;
use std::time::{Duration, Instant};

use repose_geometry::transform::from_row_major;
use repose_proto::motion::{ExecutionOutcome, MotionPlanRequest};
use repose_proto::{CallError, ErrorCode, Message as _, PlaceRequest, Scene, SceneRef, Service};
use repose_runtime::{CallOptions, now_ns};
use repose_tracking::{Known, holds};

use super::calls::{execute, plan};
use crate::cell::{Camera, Cell};
use crate::messages::{Answered, SequenceShown, Stage, StepShown};

/// Goals of one sequence at most.
const MAX_GOALS: usize = 32;
/// Placements that motion may choose from.
const COUNT: u32 = 5;
/// Between two looks for a fresh view.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Begins a sequence.
///
/// # Errors
/// `invalid_argument` on the goal at fault, `not_found` on an object that the view lacks, `failed_precondition` when one is under way.
pub fn begin(
    cell: Arc<Cell>,
    camera: Arc<Camera>,
    scene: Arc<Scene>,
    robot: String,
    goals: Vec<PlaceRequest>,
    deadline: Duration,
) -> Result<Answered, CallError> {
    if goals.is_empty() || goals.len() > MAX_GOALS {
        return Err(CallError::invalid("goals", format!("expected 1 to {MAX_GOALS} goals, got {}", goals.len())));
    }
    let known = Known::of(&scene.meta.objects);
    for (k, goal) in goals.iter().enumerate() {
        let field = format!("goals[{k}]");
        goal.validate().map_err(|e| CallError { field: e.field.as_ref().map(|f| format!("{field}.{f}")), ..e })?;
        known.translated(&field, goal.query, &goal.goal)?;
    }
    let step = |goal: &PlaceRequest| StepShown {
        query: goal.query,
        goal: goal.goal.clone(),
        stage: Stage::Waiting,
        holds: Vec::new(),
        error: None,
    };
    let shown = SequenceShown { steps: goals.iter().map(step).collect(), ended: false };
    let mut is_free = true;
    cell.update(|activity| match &activity.sequence {
        Some(other) if !other.ended => is_free = false,
        _ => activity.sequence = Some(shown),
    });
    if !is_free {
        return Err(CallError::precondition("a sequence is under way in this cell; end it first"));
    }
    tokio::spawn(async move {
        let mut running = Running { cell, camera, robot, deadline, known, seen_ns: scene.stamp_ns };
        for (k, goal) in goals.iter().enumerate() {
            if running.was_ended() {
                break;
            }
            match running.step(k, goal).await {
                Ok(held) => {
                    running.show(k, |step| step.stage = if held { Stage::Held } else { Stage::Failed });
                    if !held {
                        break;
                    }
                }
                Err(error) => {
                    running.show(k, |step| (step.stage, step.error) = (Stage::Failed, Some(error)));
                    break;
                }
            }
        }
        running.cell.update(|activity| activity.sequence.iter_mut().for_each(|s| s.ended = true));
    });
    Ok(Answered::Done {})
}

/// Ends the sequence that is under way, after the goal that it is at.
pub fn end(cell: &Cell) {
    cell.update(|activity| activity.sequence.iter_mut().for_each(|s| s.ended = true));
}

/// A sequence under way.
struct Running {
    cell: Arc<Cell>,
    camera: Arc<Camera>,
    robot: String,
    deadline: Duration,
    known: Known,
    /// The next view must be newer.
    seen_ns: u64,
}

impl Running {
    fn was_ended(&self) -> bool {
        let mut ended = true;
        self.cell.update(|activity| ended = activity.sequence.as_ref().is_none_or(|s| s.ended));
        ended
    }

    fn show(&self, k: usize, change: impl FnOnce(&mut StepShown)) {
        self.cell.update(|activity| {
            if let Some(step) = activity.sequence.as_mut().and_then(|s| s.steps.get_mut(k)) {
                change(step);
            }
        });
    }

    /// Carries one goal out; whether it holds in the view after it.
    async fn step(&mut self, k: usize, goal: &PlaceRequest) -> Result<bool, CallError> {
        self.show(k, |step| step.stage = Stage::Looking);
        let (scene_id, scene) = self.view().await?;
        let field = format!("goals[{k}]");
        let (query, terms) = self.known.translated(&field, goal.query, &goal.goal)?;
        self.show(k, |step| step.stage = Stage::Placing);
        let scene_ref = SceneRef { scene_id };
        let request = PlaceRequest { scene: scene_ref.clone(), query, goal: terms, count: goal.count.max(COUNT), ..goal.clone() };
        let options = CallOptions::within(self.deadline);
        let (placed, _) = self.cell.caller(Service::Planner).place(&request, Some(&scene), options.clone()).await?;
        if placed.placements.is_empty() {
            return Err(CallError::precondition("there is no such placement"));
        }
        self.show(k, |step| step.stage = Stage::Planning);
        let request = MotionPlanRequest {
            scene: scene_ref,
            robot: self.robot.clone(),
            query,
            placements: placed.placements.iter().map(|p| p.placed_from_observed).collect(),
            start_joints_rad: [0.0; 7],
            grasps: None,
            seed: goal.seed,
        };
        let (plan, shown) = plan(&self.cell, request, &scene, options).await?;
        self.cell.show_plan(shown);
        self.show(k, |step| step.stage = Stage::Moving);
        let chosen = placed.placements.get(plan.placement).ok_or_else(|| CallError::internal("motion chose no placement of ours"))?;
        let moved = from_row_major(&chosen.placed_from_observed.0).map_err(|e| CallError::internal(e.to_string()))?;
        let reply = execute(&self.cell, &plan).await?;
        if reply.outcome != ExecutionOutcome::Done {
            return Err(CallError::precondition(reply.reason.unwrap_or_else(|| "the motion did not end as planned".to_owned())));
        }
        self.seen_ns = now_ns();
        self.known.carried(goal.query, &moved);
        let (_, scene) = self.view().await?;
        let (query, terms) = self.known.translated(&field, goal.query, &goal.goal)?;
        let held = holds(&scene, placed.view_yaw_rad, query, &terms);
        let all = held.iter().all(|h| *h);
        self.show(k, |step| step.holds = held);
        Ok(all)
    }

    /// The first view newer than the last, in which the objects are found again.
    async fn view(&mut self) -> Result<(String, Scene), CallError> {
        let give_up = Instant::now() + self.deadline;
        let camera = self.camera.name();
        loop {
            let summary = self.cell.newest(camera).await?;
            if summary.stamp_ns > self.seen_ns {
                let scene = self.cell.scene(&summary.scene_id).await?;
                self.seen_ns = summary.stamp_ns;
                self.known.look_again(&scene.meta.objects);
                return Ok((summary.scene_id, scene));
            }
            if Instant::now() >= give_up {
                let message = format!("camera {camera} has shown nothing new in {} ms", self.deadline.as_millis());
                return Err(CallError::new(ErrorCode::DeadlineExceeded, message));
            }
            tokio::time::sleep(LOOK_EVERY).await;
        }
    }
}
