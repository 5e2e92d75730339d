//! Goals carried out one after another, as `place --execute --then` does it: each planned on a fresh view, moved, looked at again, and tried again where it
//! slipped. Ends at the first that is not achieved.
//!
//! A sequence belongs to its cell, not to whoever asked for it: it goes on when the page is closed, and everyone sees it. One at a time.

use std::sync::Arc;
use std::time::Duration;

use repose_executive::sequence::{GoalStep, Sequence};
use repose_proto::{CallError, Message as _, PlaceRequest, Scene};
use repose_tracking::Known;

use crate::ConsoleConfig;
use crate::activity::{SequenceShown, StepShown};
use crate::cell::{Camera, WatchedCell};
use crate::messages::Answered;
use crate::stage::GoalStage;

use super::site::PageSite;

/// Goals of one sequence at most.
const MAX_GOALS: usize = 32;

/// Begins a sequence.
///
/// # Errors
/// `invalid_argument` on the goal at fault, `not_found` on an object that the view lacks, `failed_precondition` when one is under way, `unavailable` when
/// the console is ending.
pub fn begin(
    cell: Arc<WatchedCell>,
    camera: Arc<Camera>,
    (scene_id, scene): (String, Arc<Scene>),
    robot: String,
    goals: Vec<PlaceRequest>,
    config: &ConsoleConfig,
) -> Result<Answered, CallError> {
    if goals.is_empty() || goals.len() > MAX_GOALS {
        return Err(CallError::invalid("goals", format!("expected 1 to {MAX_GOALS} goals, got {}", goals.len())));
    }
    let known = Known::of(&scene.meta.objects);
    for (k, goal) in goals.iter().enumerate() {
        let field = format!("goals[{k}]");
        if goal.scene.scene_id != scene_id {
            let why = format!("expected {scene_id}, which the sequence begins at: objects have other ids in another scene");
            return Err(CallError::invalid(format!("{field}.scene.scene_id"), why));
        }
        goal.validate().map_err(|e| CallError { field: e.field.as_ref().map(|f| format!("{field}.{f}")), ..e })?;
        known.translated(&field, goal.query, &goal.goal)?;
    }
    let step = |goal: &PlaceRequest| StepShown {
        query: goal.query,
        goal: goal.goal.clone(),
        stage: GoalStage::Waiting,
        holds: Vec::new(),
        said: Vec::new(),
        error: None,
    };
    let (under_way, wanted) = (cell.moves().begin(format!("a sequence in {}", cell.name()))?, goals.len());
    let shown = SequenceShown { steps: goals.iter().map(step).collect(), ending: false, ended: false };
    cell.begin(|activity| activity.sequence = Some(shown))?;
    let (deadline, attempts) = (Duration::from_millis(config.request_deadline_ms), config.attempts);
    tokio::spawn(async move {
        let site = PageSite::of(cell.clone(), camera, robot, deadline).for_sequence();
        // A task of its own, so that the sequence ends whatever happens in it.
        let achieving = tokio::spawn(async move { achieve(site, &scene, &goals, attempts).await });
        let lost = |e| Err(Some(CallError::internal(format!("the sequence was lost: {e}"))));
        if let Err(error) = achieving.await.unwrap_or_else(lost) {
            cell.update_step(|step| (step.stage, step.error) = (GoalStage::Failed, error));
        }
        // Only here: until then the robot may move for it, and nothing else of several moves may begin.
        let mut open = 0;
        cell.update(|activity| {
            if let Some(sequence) = &mut activity.sequence {
                (sequence.ended, open) = (true, sequence.open_goals());
            }
        });
        if open > 0 {
            tracing::warn!(cell = cell.name(), open, wanted, "a sequence has ended before all of its goals were achieved");
        }
        drop(under_way);
    });
    Ok(Answered::Done {})
}

/// Achieves the goals; where one was not achieved it is an error, with one to show where there is one.
async fn achieve(site: PageSite, scene: &Scene, goals: &[PlaceRequest], attempts: usize) -> Result<(), Option<CallError>> {
    let cell = site.cell().clone();
    let told = |step: &GoalStep| {
        cell.update_step(|shown| {
            shown.holds.clone_from(&step.last.holds);
            shown.said = step.describe();
            if step.achieved() {
                shown.stage = GoalStage::Held;
            }
        });
    };
    let mut sequence = Sequence::begin(site, Some(scene), attempts).await?;
    sequence.achieve(goals, told).await?;
    match sequence.steps.last() {
        Some(last) if last.result.placements.is_empty() => Err(Some(CallError::precondition("there is no such placement"))),
        Some(last) if !last.achieved() => Err(None),
        _ => Ok(()),
    }
}

/// Ends the sequence that is under way, after the goal that it is at.
pub fn end(cell: &WatchedCell) {
    cell.update(|activity| activity.sequence.iter_mut().for_each(|s| s.ending = true));
}
