//! The cell on the network: `reset` and `truth` as calls; states and frames out, commands and stops in.

use std::sync::Arc;

use async_trait::async_trait;
use repose_proto::robot::{EmergencyStop, RobotCommand};
use repose_proto::simulator::{TruthRequest, WorldResetRequest};
use repose_proto::{CallError, Payload};
use repose_runtime::{Call, Handler, Publisher, RuntimeError, Session, Traffic};
use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::config::SimulatorConfig;
use crate::worker::Worker;

/// Commands that may wait between the network and the world.
const COMMANDS: usize = 64;
/// Emergency stops that may; they are repeated.
const STOPS: usize = 16;

/// Answers `reset` and `truth`.
pub struct Endpoints {
    worker: Arc<Worker>,
}

impl Endpoints {
    /// Answers from a running world.
    pub fn new(worker: Arc<Worker>) -> Self {
        Self { worker }
    }
}

#[async_trait]
impl Handler for Endpoints {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "reset" => {
                let request: WorldResetRequest = call.payload.decode_json()?;
                Payload::json(&self.worker.reset(request.seed).await?)
            }
            "truth" => {
                let request: TruthRequest = call.payload.decode_json()?;
                if request.view_yaw_rad.is_some_and(|yaw| !yaw.is_finite()) {
                    return Err(CallError::invalid("view_yaw_rad", "expected a finite number"));
                }
                Payload::json(&self.worker.truth(request.view_yaw_rad).await?)
            }
            _ => Err(call.unknown_method()),
        }
    }

    fn at_most_once(&self, method: &str) -> bool {
        method == "reset"
    }
}

/// Joins the world to the cell's keys; the tasks run until they are aborted.
///
/// # Errors
/// When the network refuses.
pub async fn connect(
    session: &Session,
    config: &SimulatorConfig,
    worker: &Arc<Worker>,
    tasks: &mut JoinSet<()>,
) -> Result<(), RuntimeError> {
    let cell = session.cell();
    let mut stops = session.subscribe_queue(&cell.robot_estop(&config.robot), STOPS).await?;
    let mut commands = session.subscribe_queue(&cell.robot_command(&config.robot), COMMANDS).await?;
    let states = session.publisher(cell.robot_state(&config.robot), Traffic::RobotState);
    let frames = session.publisher(cell.camera_frame(&config.camera), Traffic::Frame);
    tasks.spawn(published(worker.states(), states));
    tasks.spawn(published(worker.frames(), frames));
    let world = worker.clone();
    tasks.spawn(async move {
        while let Some(sample) = stops.recv().await {
            // Whatever comes here stops the arm: its form and its encoding do not matter.
            if let Err(error) = world.emergency_stop(EmergencyStop::read(&sample.payload.bytes)) {
                tracing::error!(%error, "an emergency stop could not be taken");
            }
        }
    });
    let world = worker.clone();
    tasks.spawn(async move {
        while let Some(sample) = commands.recv().await {
            match sample.payload.decode_json::<RobotCommand>().and_then(|command| world.command(command)) {
                Ok(()) => {}
                Err(error) => tracing::warn!(%error, "a command could not be taken"),
            }
        }
    });
    Ok(())
}

/// Puts the newest of what the world shows.
async fn published(mut newest: watch::Receiver<Option<Payload>>, to: Publisher) {
    while newest.changed().await.is_ok() {
        let payload = newest.borrow_and_update().clone();
        let Some(payload) = payload else { continue };
        if let Err(error) = to.put(payload).await {
            tracing::warn!(key = to.key(), %error, "could not be published");
        }
    }
}
