//! A session with a running system, and the calls that the client commands make.

use std::time::Duration;

use repose_proto::perception::{LatestRequest, SceneRequest};
use repose_proto::scoring::enclose;
use repose_proto::{CallError, ErrorCode, Message, Payload, PlaceRequest, PlaceResult, Scene, SceneSummary, Service};
use repose_runtime::{Answer, CallOptions, Caller, RuntimeConfig, RuntimeError, Session, SessionMode};

use crate::args::ConnectArgs;
use crate::failure::Failure;

impl From<RuntimeError> for Failure {
    fn from(error: RuntimeError) -> Self {
        match error {
            RuntimeError::Config { .. } => Self::bad_input("config", error),
            other => Self::other(other),
        }
    }
}

/// A client of a deployment.
pub async fn connect(args: &ConnectArgs) -> Result<Session, Failure> {
    let mut config = RuntimeConfig::load(None)?;
    config.session.mode = SessionMode::Client;
    config.session.connect = vec![args.connect.clone()];
    config.session.cell.clone_from(&args.cell);
    Ok(Session::open(config).await?)
}

/// The newest scene of a camera, from the perception worker that owns it; asks until there is one or time is up.
pub async fn newest_scene(session: &Session, camera: &str, within: Duration) -> Result<SceneSummary, Failure> {
    let perception = session.caller(Service::Perception).await?;
    let request = Payload::json(&LatestRequest { camera: camera.to_owned() })?;
    let give_up = tokio::time::Instant::now() + within;
    loop {
        match perception.call_any("latest", &request, &CallOptions::within(Duration::from_secs(5).min(within))).await {
            Ok(answer) => return Ok(answer.payload.decode_json()?),
            Err(error) if tokio::time::Instant::now() >= give_up => return Err(error.into()),
            Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
        }
    }
}

/// A scene, whole, from the perception worker that made it.
pub async fn whole_scene(session: &Session, scene_id: &str, within: Duration) -> Result<Scene, Failure> {
    let perception = session.caller(Service::Perception).await?;
    let request = Payload::json(&SceneRequest { scene_id: scene_id.to_owned() })?;
    let answer = perception.call_any("scene", &request, &CallOptions::within(within)).await?;
    Ok(Scene::from_bulk(&answer.payload.decode_bulk(Scene::SCHEMA)?)?)
}

/// Asks for a placement on a scene by its id; sends the scene whole, where it is at hand, when nobody holds it any more.
pub async fn place(
    planner: &Caller,
    request: &PlaceRequest,
    scene: Option<&Scene>,
    options: CallOptions,
) -> Result<(PlaceResult, Answer), CallError> {
    let by_id = planner.call("place", Payload::json(request)?, options.clone()).await;
    let answer = match (by_id, scene) {
        (Err(error), Some(scene))
            if error.code == ErrorCode::NotFound && error.field.as_deref().is_some_and(|f| f.ends_with("scene_id")) =>
        {
            let whole = Payload::bulk(PlaceRequest::SCHEMA, &enclose(request, Some(scene)))?;
            planner.call("place", whole, options).await?
        }
        (answered, _) => answered?,
    };
    Ok((answer.payload.decode_json()?, answer))
}
