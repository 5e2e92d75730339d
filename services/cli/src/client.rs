//! A session with a running system, and the calls that the client commands make.

use std::time::Duration;

use repose_proto::perception::LatestRequest;
use repose_proto::{Payload, PlaceRequest, PlaceResult, SceneSummary, Service};
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

/// Asks for a placement.
pub async fn place(planner: &Caller, request: &PlaceRequest, options: CallOptions) -> Result<(PlaceResult, Answer), repose_proto::CallError> {
    let answer = planner.call("place", Payload::json(request)?, options).await?;
    Ok((answer.payload.decode_json()?, answer))
}
