//! The emergency stop: a request of its own, so that it needs no open socket and waits behind nothing. Everybody may.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State as Shared;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use repose_proto::{ErrorCode, keys};
use repose_runtime::emergency_stop_within;
use serde::Deserialize;

use super::refusal::{refused, unknown};
use super::state::AppState;

/// Who stops, as the robot's state says it.
const SOURCE: &str = "repose console";
/// How long a robot may take to show it before the viewer is told that it has not.
const SHOWN_WITHIN: Duration = Duration::from_secs(5);

/// Which robot to stop.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StopRequest {
    /// The console's own where none is named: a page that has never been let in knows of none.
    cell: Option<String>,
    robot: String,
    reason: Option<String>,
}

/// Stops a robot; answers when it shows the stop. The stop goes on when the connection is lost meanwhile.
pub async fn stop(Shared(state): Shared<Arc<AppState>>, headers: HeaderMap, body: String) -> Response {
    if state.role(&headers).is_none() {
        return refused(StatusCode::UNAUTHORIZED, &unknown());
    }
    let stopped = async {
        let stop: StopRequest = repose_proto::message::from_json(body.as_bytes())?;
        keys::validate_chunk("robot", &stop.robot)?;
        let session = state.session.in_cell(stop.cell.as_deref().unwrap_or(state.session.cell().name()))?;
        let reason = stop.reason.as_deref().unwrap_or("stopped from the console");
        emergency_stop_within(&session, &stop.robot, SOURCE, reason, SHOWN_WITHIN).await
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
