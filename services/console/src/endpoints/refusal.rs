//! Errors of the contract, over HTTP.

use axum::Json;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use repose_proto::{CallError, ErrorCode};

/// An error as an answer.
pub fn refused(status: StatusCode, error: &CallError) -> Response {
    (status, Json(serde_json::json!({"error": error}))).into_response()
}

/// What somebody without a good token is told.
pub fn unknown() -> CallError {
    CallError::new(ErrorCode::FailedPrecondition, "this console asks for a token").at("token")
}
