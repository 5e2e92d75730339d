//! Goals that shall hold together at the end: asked for, and brought about as `arrange --execute` does it, with a fresh view after every move.
//!
//! As a sequence, it belongs to its cell and goes on when the page is closed; a cell carries out one of the two at a time.

use std::sync::Arc;
use std::time::{Duration, Instant};

use repose_executive::arrangement::{News, bring_about};
use repose_proto::{ArrangeRequest, CallError, Message as _, Payload, Scene, Service};
use repose_runtime::CallOptions;
use repose_tracking::Known;

use super::site::PageSite;
use crate::ConsoleConfig;
use crate::arrangement::ArrangementShown;
use crate::cell::{Camera, WatchedCell};
use crate::messages::Answered;

/// Asks the planner for moves after which all goals hold.
///
/// # Errors
/// `invalid_argument` on the field at fault, `not_found` on an object that the scene lacks, `cancelled`, and what the planner says.
pub async fn asked(
    cell: &WatchedCell,
    request: &ArrangeRequest,
    scene: Option<&Scene>,
    options: CallOptions,
) -> Result<Answered, CallError> {
    request.validate()?;
    let started = Instant::now();
    let encode = |scene: Option<&Scene>| Payload::with_scene(request, scene);
    let answer = cell.caller(Service::Planner).call_with_scene("arrange", scene, encode, options).await?;
    let took_ms = started.elapsed().as_secs_f64() * 1e3;
    Ok(Answered::Arranged { arranged: Box::new(answer.payload.decode_json()?), worker: answer.worker, took_ms })
}

/// Begins to bring goals about.
///
/// # Errors
/// `invalid_argument` on the field at fault, `not_found` on an object that the view lacks, `failed_precondition` when something else is carried out.
pub fn begin(
    cell: Arc<WatchedCell>,
    camera: Arc<Camera>,
    scene: Arc<Scene>,
    robot: String,
    request: ArrangeRequest,
    config: &ConsoleConfig,
) -> Result<Answered, CallError> {
    request.validate()?;
    let known = Known::of(&scene.meta.objects);
    for (i, goal) in request.goals.iter().enumerate() {
        known.translated(&format!("goals[{i}]"), goal.object, &goal.terms)?;
    }
    let shown = ArrangementShown::of(&request.goals);
    cell.begin(|activity| activity.arrangement = Some(shown))?;
    let (deadline, attempts) = (Duration::from_millis(config.request_deadline_ms), config.attempts);
    tokio::spawn(async move {
        let site = PageSite::of(cell.clone(), camera, robot, deadline).for_arrangement();
        let told = |news: News<'_>| {
            cell.update_arrangement(|shown| match news {
                News::Planned(planned) => shown.planned(planned),
                News::Tried(step) => shown.tried(step),
            });
        };
        match bring_about(site, Some(&scene), request, attempts, told).await {
            Ok(told) => cell.update_arrangement(|shown| shown.ended(told)),
            Err(error) => cell.update_arrangement(|shown| shown.failed(error)),
        }
    });
    Ok(Answered::Done {})
}

/// Ends the one that is under way, after the move that it is at.
pub fn end(cell: &WatchedCell) {
    cell.update_arrangement(|shown| shown.ending = true);
}
