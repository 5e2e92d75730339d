//! The JSON Schema of every JSON message, as checked in under `proto/schemas/`.

use schemars::{JsonSchema, Schema, schema_for};

use crate::Message;
use crate::frame::CameraModel;
use crate::{arrange, envelope, error, load, motion, perception, place, robot, scene, scoring, simulator};

/// File stem and schema of every message, by name.
pub fn all() -> Vec<(String, Schema)> {
    fn of<T: Message + JsonSchema>() -> (String, Schema) {
        (T::SCHEMA.to_owned(), schema_for!(T))
    }
    let mut schemas = vec![
        ("CallAttachment.v1".to_owned(), schema_for!(envelope::CallAttachment)),
        ("ReplyAttachment.v1".to_owned(), schema_for!(envelope::ReplyAttachment)),
        of::<error::CallError>(),
        ("CameraModel.v1".to_owned(), schema_for!(CameraModel)),
        ("SceneMeta.v1".to_owned(), schema_for!(scene::SceneMeta)),
        of::<scene::SceneSummary>(),
        of::<perception::LatestRequest>(),
        of::<perception::SceneRequest>(),
        of::<place::PlaceRequest>(),
        of::<place::PlaceResult>(),
        of::<place::PlaceProgress>(),
        of::<arrange::ArrangeRequest>(),
        of::<arrange::ArrangeResult>(),
        of::<scoring::PriorRequest>(),
        of::<scoring::PriorReply>(),
        of::<scoring::ScoreRequest>(),
        of::<scoring::ScoreReply>(),
        of::<scoring::ModelsRequest>(),
        of::<scoring::ModelsReply>(),
        of::<scoring::ForecastsRequest>(),
        of::<scoring::ForecastsReply>(),
        of::<motion::MotionPlanRequest>(),
        of::<motion::MotionPlan>(),
        of::<motion::ExecuteReply>(),
        of::<motion::ExecuteProgress>(),
        of::<motion::RobotResetRequest>(),
        of::<motion::RobotResetReply>(),
        of::<motion::RecoverRequest>(),
        of::<motion::RecoverReply>(),
        of::<robot::RobotState>(),
        of::<robot::RobotCommand>(),
        of::<robot::EmergencyStop>(),
        of::<simulator::WorldResetRequest>(),
        of::<simulator::TruthRequest>(),
        of::<simulator::Truth>(),
        of::<load::WorkerLoad>(),
    ];
    schemas.sort_by(|a, b| a.0.cmp(&b.0));
    schemas
}
