//! Requests as payloads: checked JSON, and the bulk form that encloses a scene.

use std::sync::Arc;

use repose_proto::enclosed::enclose;
use repose_proto::message::from_json;
use repose_proto::motion::MotionPlanRequest;
use repose_proto::{CallError, Message, Payload, PlaceRequest, Scene};

/// JSON of a schema, which the service checks.
pub fn json(schema: &str, body: &[u8]) -> Result<Payload, CallError> {
    Payload { encoding: format!("application/json;repose.{schema}"), bytes: body.to_vec().into() }.within_limit()
}

/// A scene to be sent along with a request that names it.
pub struct Enclosing {
    /// The request's schema.
    pub schema: String,
    /// The scene.
    pub scene: Arc<Scene>,
}

impl Enclosing {
    /// The request in bulk form with its scene.
    pub fn payload(&self, request: &Payload) -> Result<Payload, CallError> {
        let bulk = match self.schema.as_str() {
            PlaceRequest::SCHEMA => enclose(&from_json::<PlaceRequest>(&request.bytes)?, Some(&self.scene)),
            MotionPlanRequest::SCHEMA => enclose(&from_json::<MotionPlanRequest>(&request.bytes)?, Some(&self.scene)),
            other => return Err(CallError::invalid("schema", format!("{other} encloses no scene"))),
        };
        Payload::bulk(&self.schema, &bulk)
    }
}
