//! The emergency stop: a request of its own, so that it needs no open socket and waits behind nothing. Everybody may.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State as Shared;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use repose_proto::robot::RobotState;
use repose_proto::{CallError, ErrorCode, Payload, keys};
use repose_runtime::{Session, Traffic};
use serde::Deserialize;

use super::refusal::{refused, unknown};
use super::state::State;
use crate::cell::emergency_stop;

/// Between two puts of a stop.
const REPEAT: Duration = Duration::from_millis(20);
/// How long a robot may take to show it before the viewer is told that it has not.
const SHOWN_WITHIN: Duration = Duration::from_secs(5);

/// Which robot.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stop {
    cell: String,
    robot: String,
    reason: Option<String>,
}

/// Stops a robot; answers when it shows the stop.
pub async fn stop(Shared(state): Shared<Arc<State>>, headers: HeaderMap, body: String) -> Response {
    if state.role(&headers).is_none() {
        return refused(StatusCode::UNAUTHORIZED, &unknown());
    }
    let stopped = async {
        let stop: Stop = repose_proto::message::from_json(body.as_bytes())?;
        keys::validate_chunk("robot", &stop.robot)?;
        let session = state.session.in_cell(&stop.cell)?;
        let reason = stop.reason.as_deref().unwrap_or("stopped from the console");
        let unheard = |_| {
            let message = format!("robot {} has not shown the stop in {} ms", stop.robot, SHOWN_WITHIN.as_millis());
            CallError::new(ErrorCode::DeadlineExceeded, message)
        };
        tokio::time::timeout(SHOWN_WITHIN, latch(&session, &stop.robot, reason)).await.map_err(unheard)?
    };
    match stopped.await {
        Ok(shown) => Json(serde_json::json!({"stop": shown.stop})).into_response(),
        Err(error) => {
            let status = match error.code {
                ErrorCode::InvalidArgument => StatusCode::BAD_REQUEST,
                _ => StatusCode::GATEWAY_TIMEOUT,
            };
            refused(status, &error)
        }
    }
}

/// Puts the stop until a state shows it, or one that was latched before it.
async fn latch(session: &Session, robot: &str, reason: &str) -> Result<RobotState, CallError> {
    let mut states = session.subscribe_latest(&session.cell().robot_state(robot)).await?;
    let (key, payload) = (session.cell().robot_estop(robot), Payload::json(&emergency_stop(reason))?);
    let mut again = tokio::time::interval(REPEAT);
    loop {
        tokio::select! {
            _ = again.tick() => session.put(&key, payload.clone(), Traffic::EmergencyStop).await?,
            sample = states.recv() => {
                let closed = || CallError::new(ErrorCode::Unavailable, "the session has closed");
                match sample.ok_or_else(closed)?.payload.decode_json::<RobotState>() {
                    // A reflex that is only braking is not a stop that stays.
                    Ok(state) if state.stop.as_ref().is_some_and(|stop| stop.estop_id.is_some()) => return Ok(state),
                    _ => {}
                }
            }
        }
    }
}
