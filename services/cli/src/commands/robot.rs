//! `repose robot`: the operator's hand on a robot: stop it, say how it is, let it go on.

use std::time::Duration;

use clap::{Args, ValueEnum};
use repose_proto::motion::{RobotResetReply, RobotResetRequest};
use repose_proto::robot::{EmergencyStop, RobotState};
use repose_proto::{CallError, ErrorCode, Payload, Service, keys, limits};
use repose_runtime::{CallOptions, Session, Traffic};

use crate::client::{self, SystemArgs};
use crate::failure::{Failure, Outcome};
use crate::output::Output;

/// Between two puts of an emergency stop.
const REPEAT: Duration = Duration::from_millis(20);

/// Arguments of `robot`.
#[derive(Debug, Args)]
pub struct RobotArgs {
    /// What to do.
    #[arg(value_enum)]
    pub action: Action,
    /// The system.
    #[command(flatten)]
    pub system: SystemArgs,
    /// The robot.
    #[arg(long, default_value = "panda")]
    pub robot: String,
    /// Why it is stopped; the robot's state and whoever is refused will say it.
    #[arg(long, default_value = "stopped from the command line")]
    pub reason: String,
    /// How long it may take, milliseconds.
    #[arg(long, default_value_t = 10_000)]
    pub deadline_ms: u64,
}

/// What an operator does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Action {
    /// An emergency stop, repeated until the robot shows it; it stays until `reset`.
    Stop,
    /// Lets a stopped robot go on, by way of the motion service.
    Reset,
    /// What the robot says of itself.
    State,
}

/// Runs the command.
pub async fn run(args: &RobotArgs, output: Output) -> Outcome {
    keys::validate_chunk("robot", &args.robot)?;
    let session = client::connect(&args.system).await?;
    let ended = act(args, &session, output).await;
    client::close(session).await;
    ended
}

async fn act(args: &RobotArgs, session: &Session, output: Output) -> Outcome {
    let within = Duration::from_millis(args.deadline_ms);
    let robot = &args.robot;
    match args.action {
        Action::Stop => {
            let unheard = |_| {
                let message = format!("robot {robot} has not shown the stop in {} ms", args.deadline_ms);
                Failure::Other(CallError::new(ErrorCode::DeadlineExceeded, message))
            };
            let stopped = tokio::time::timeout(within, stop(session, robot, &args.reason)).await.map_err(unheard)??;
            output.print(&stopped, || format!("{robot} is stopped: {}; `repose robot reset` lets it go on", args.reason))
        }
        Action::Reset => {
            let motion = session.caller(Service::Motion).await?;
            let request = Payload::json(&RobotResetRequest { robot: robot.clone() })?;
            let reply = motion.call("reset", request, CallOptions::at_most_once(within)).await?;
            let reply: RobotResetReply = reply.payload.decode_json()?;
            output.print(&reply, || format!("{robot} {}", if reply.was_stopped { "may go on" } else { "was not stopped" }))
        }
        Action::State => {
            let state = client::robot_state(session, robot, within).await?;
            output.print(&state, || match &state.stop {
                Some(stop) => format!("{robot} {:?}: {} ({})", state.mode, stop.reason, stop.kind),
                None => format!("{robot} {:?}, joints {:.3?} rad, fingers {:.3} m", state.mode, state.q_rad, state.gripper_width_m),
            })
        }
    }
}

/// Puts the stop until a state shows it, or one that was latched before it.
async fn stop(session: &Session, robot: &str, reason: &str) -> Result<RobotState, Failure> {
    let mut states = session.subscribe_latest(&session.cell().robot_state(robot)).await?;
    let (source, reason) = ("repose robot stop".to_owned(), reason.to_owned());
    let wanted = EmergencyStop { v: limits::VERSION, id: uuid::Uuid::new_v4().to_string(), source, reason, stamp_ns: client::now_ns() };
    let (key, payload) = (session.cell().robot_estop(robot), Payload::json(&wanted)?);
    let mut again = tokio::time::interval(REPEAT);
    loop {
        tokio::select! {
            _ = again.tick() => session.put(&key, payload.clone(), Traffic::EmergencyStop).await?,
            sample = states.recv() => {
                let sample = sample.ok_or_else(|| Failure::other("the session has closed"))?;
                // Another's stop that came first holds as well as this one; a reflex that is only braking does not.
                match sample.payload.decode_json::<RobotState>() {
                    Ok(state) if state.stop.as_ref().is_some_and(|stop| stop.estop_id.is_some()) => return Ok(state),
                    _ => {}
                }
            }
        }
    }
}
