//! Requests as payloads: checked JSON, and the bulk form that encloses a scene.

use repose_proto::message::from_json;
use repose_proto::motion::{MotionPlanRequest, RecoverRequest};
use repose_proto::{CallError, Message, Payload, PlaceRequest, Scene};

/// JSON of a schema, which the service checks.
pub fn json(schema: &str, body: &[u8]) -> Result<Payload, CallError> {
    Payload { encoding: format!("application/json;repose.{schema}"), bytes: body.to_vec().into() }.within_limit()
}

/// A request of a schema in bulk form, with the scene that it names.
///
/// # Errors
/// `invalid_argument` where the schema names no scene.
pub fn enclosing(schema: &str, request: &Payload, scene: &Scene) -> Result<Payload, CallError> {
    match schema {
        PlaceRequest::SCHEMA => Payload::with_scene(&from_json::<PlaceRequest>(&request.bytes)?, Some(scene)),
        MotionPlanRequest::SCHEMA => Payload::with_scene(&from_json::<MotionPlanRequest>(&request.bytes)?, Some(scene)),
        RecoverRequest::SCHEMA => Payload::with_scene(&from_json::<RecoverRequest>(&request.bytes)?, Some(scene)),
        other => Err(CallError::invalid("schema", format!("{other} encloses no scene"))),
    }
}
