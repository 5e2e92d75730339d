//! The emergency stop: a request of its own, so that it needs no open socket and waits behind nothing. Everybody may.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State as Shared;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use repose_proto::followed_robots::SILENT;
use repose_proto::robot::StopState;
use repose_proto::{CallError, ErrorCode, keys};
use repose_runtime::{Session, emergency_stop_within};
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};

use super::refusal::{refused, unknown};
use super::state::AppState;

/// Who stops, as the robot's state says it.
const SOURCE: &str = "repose console";
/// How long a robot may take to show it before the viewer is told that it has not.
const SHOWN_WITHIN: Duration = Duration::from_secs(5);
/// What stands for every robot in a key.
const EVERY: &str = "*";
/// Robot states that may wait for their turn.
const STATES: usize = 256;

/// Which robot to stop.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StopRequest {
    /// The console's own where none is named: a page that has never been let in knows of none.
    cell: Option<String>,
    /// Every robot of the cell where none is named: a page that has heard of none is to stop whichever is there.
    robot: Option<String>,
    reason: Option<String>,
}

/// Stops a robot, or all of a cell; answers when each shows the stop. The stop goes on when the connection is lost meanwhile.
pub async fn stop(Shared(state): Shared<Arc<AppState>>, headers: HeaderMap, body: String) -> Response {
    if state.role(&headers).is_none() {
        return refused(StatusCode::UNAUTHORIZED, &unknown());
    }
    match stopped(&state, &body).await {
        Ok(shown) => Json(shown).into_response(),
        Err(error) => {
            let status = match error.code {
                ErrorCode::InvalidArgument => StatusCode::BAD_REQUEST,
                _ => StatusCode::GATEWAY_TIMEOUT,
            };
            refused(status, &error)
        }
    }
}

/// Stops what a request names, and says what the robots show.
async fn stopped(state: &AppState, body: &str) -> Result<Value, CallError> {
    let stop: StopRequest = repose_proto::message::from_json(body.as_bytes())?;
    stop.robot.as_deref().map_or(Ok(()), |robot| keys::validate_chunk("robot", robot))?;
    let session = state.session.in_cell(stop.cell.as_deref().unwrap_or(state.session.cell().name()))?;
    let reason = stop.reason.unwrap_or_else(|| "stopped from the console".to_owned());
    let Some(robot) = stop.robot else {
        // A task of its own, so that a connection that is lost does not end it.
        let stopping = tokio::spawn(stop_every_robot(session, reason));
        let stops = stopping.await.map_err(|e| CallError::internal(format!("the stop was lost: {e}")))??;
        return Ok(json!({"stops": stops}));
    };
    let shown = emergency_stop_within(&session, &robot, SOURCE, &reason, SHOWN_WITHIN).await?;
    Ok(json!({"stop": shown.stop}))
}

/// Stops every robot of a cell, and says what each that tells its state shows. One put to all of them is for those that tell nothing. The others are
/// stopped by their names as well: under access control a robot's side may be let hear only what is put to its own robot.
///
/// # Errors
/// `deadline_exceeded` that names the robots that have not shown it in time, or says that none tells its state.
async fn stop_every_robot(session: Session, reason: String) -> Result<BTreeMap<String, Option<StopState>>, CallError> {
    let stop = |robot: String| {
        let (session, reason) = (session.clone(), reason.clone());
        async move {
            let shown = emergency_stop_within(&session, &robot, SOURCE, &reason, SHOWN_WITHIN).await;
            (robot, shown)
        }
    };
    // Whether a robot shows it is found out by its name.
    tokio::spawn(stop(EVERY.to_owned()));
    let mut states = session.subscribe_queue(&session.cell().robot_states(), STATES).await?;
    let (mut heard, mut stopping, mut until) = (BTreeSet::<String>::new(), JoinSet::new(), Instant::now() + SHOWN_WITHIN);
    loop {
        tokio::select! {
            biased;
            () = sleep_until(until) => break,
            sample = states.recv() => {
                let Some(sample) = sample else { break };
                let Some(robot) = keys::worker_of(&sample.key).filter(|robot| !heard.contains(*robot)) else { continue };
                if heard.is_empty() {
                    // Whoever is not silent is heard in this time, too.
                    until = Instant::now() + SILENT;
                }
                heard.insert(robot.to_owned());
                stopping.spawn(stop(robot.to_owned()));
            }
        }
    }
    let (mut stops, mut unshown) = (BTreeMap::new(), Vec::new());
    for (robot, shown) in stopping.join_all().await {
        match shown {
            Ok(state) => drop(stops.insert(robot, state.stop)),
            Err(error) => unshown.push(error.message),
        }
    }
    if heard.is_empty() {
        unshown.push(format!("no robot of cell {} tells its state", session.cell().name()));
    }
    if unshown.is_empty() { Ok(stops) } else { Err(CallError::new(ErrorCode::DeadlineExceeded, unshown.join("; "))) }
}
