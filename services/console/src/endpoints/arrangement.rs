//! Goals that shall hold together at the end: asked for, and brought about as `arrange --execute` does it, with a fresh view after every move.
//!
//! As a sequence, it belongs to its cell and goes on when the page is closed; a cell carries out one of the two at a time.

use std::sync::Arc;
use std::time::{Duration, Instant};

use repose_executive::arrangement::{ArrangementEnd, ArrangementReport, News, bring_about};
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
/// `invalid_argument` on the field at fault, `not_found` on an object that the view lacks, `failed_precondition` when something else is carried out,
/// `unavailable` when the console is ending.
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
    let under_way = cell.moves().begin(format!("an arrangement in {}", cell.name()))?;
    let shown = ArrangementShown::of(&request.goals);
    cell.begin(|activity| activity.arrangement = Some(shown))?;
    let (deadline, attempts) = (Duration::from_millis(config.request_deadline_ms), config.attempts);
    tokio::spawn(async move {
        let within = cell.clone();
        let bringing = async move {
            let site = PageSite::of(within.clone(), camera, robot, deadline).for_arrangement();
            let told = |news: News<'_>| {
                within.update_arrangement(|shown| match news {
                    News::Planned(planned) => shown.planned(planned),
                    News::Tried(step) => shown.tried(step),
                });
            };
            bring_about(site, Some(&scene), request, attempts, told).await
        };
        to_its_end(&cell, bringing).await;
        drop(under_way);
    });
    Ok(Answered::Done {})
}

/// Waits until goals are brought about, and shows how that ended. In a task of its own, so that it ends whatever happens in it: else the cell would count as
/// busy with it for ever.
async fn to_its_end(cell: &WatchedCell, bringing: impl Future<Output = Result<ArrangementReport, CallError>> + Send + 'static) {
    let lost = |e| Err(CallError::internal(format!("the arrangement was lost: {e}")));
    match tokio::spawn(bringing).await.unwrap_or_else(lost) {
        Ok(told) => {
            if told.ended != ArrangementEnd::Achieved {
                let (achieved, wanted, why) = (told.achieved, told.wanted, told.why.as_deref());
                tracing::warn!(cell = cell.name(), achieved, wanted, why, "an arrangement has ended before all of its goals were achieved");
            }
            cell.update_arrangement(|shown| shown.ended(told));
        }
        Err(error) => {
            tracing::warn!(cell = cell.name(), %error, "an arrangement has ended without a word of what it has achieved");
            cell.update_arrangement(|shown| shown.failed(error));
        }
    }
}

/// Ends the one that is under way, after the move that it is at.
pub fn end(cell: &WatchedCell) {
    cell.update_arrangement(|shown| shown.ending = true);
}

#[cfg(test)]
mod tests {
    use repose_proto::ErrorCode;
    use repose_runtime::{Moves, Session};

    use super::*;

    async fn faulty() -> Result<ArrangementReport, CallError> {
        panic!("a fault in what brings it about")
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_arrangement_that_is_lost_has_ended_and_leaves_its_cell_to_the_next() {
        let session = Session::embedded().await.expect("a session");
        let cell = WatchedCell::follow(&session, "cell", Arc::default(), Moves::of("the console")).await.expect("a cell");
        let begin = || cell.begin(|activity| activity.arrangement = Some(ArrangementShown::of(&[])));
        begin().expect("nothing is under way");
        assert!(begin().is_err(), "one at a time");
        to_its_end(&cell, faulty()).await;
        let mut error = None;
        cell.update(|activity| error = activity.arrangement.as_ref().and_then(|shown| shown.error.clone()));
        assert_eq!(error.map(|e| e.code), Some(ErrorCode::Internal));
        begin().expect("the lost one has ended");
    }
}
