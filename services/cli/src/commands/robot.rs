//! `repose robot`: stop a robot, show its state, let it go on, bring its arm back.

use std::time::Duration;

use clap::{Args, ValueEnum};
use repose_executive::{AskedRecovery, IdentifiedScene, SHOWS_WITHIN, newest_after};
use repose_proto::motion::{ExecutionOutcome, RecoverReply, RecoveryMove, RobotResetReply, RobotResetRequest};
use repose_proto::robot::{RobotMode, RobotState};
use repose_proto::scene::WorldFrame;
use repose_proto::{CallError, Payload, Service, keys};
use repose_runtime::{CallOptions, SCENE_WITHIN, Session, emergency_stop_within, fetch_newest};
use repose_sentences::robot::describe;

use crate::client::{self, SystemArgs};
use crate::failure::{CommandResult, Failure};
use crate::moving::{self, Interrupts, of_motion};
use crate::output::Output;

/// How long to look for a scene to check a way against.
const SCENE: Duration = Duration::from_secs(5);

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
    /// The reason for the stop, shown in the robot's state and in refusals.
    #[arg(long, default_value = "stopped from the command line")]
    pub reason: String,
    /// The camera whose newest scene the paths of `retreat` and `home` are checked against.
    #[arg(long, default_value = "front")]
    pub camera: String,
    /// Do without a scene: check the paths of `retreat` and `home` only against the robot itself, other robots and the keep-out zones.
    #[arg(long)]
    pub unchecked: bool,
    /// Deadline of `stop`, `reset` and `state`, milliseconds.
    #[arg(long, default_value_t = 10_000)]
    pub deadline_ms: u64,
}

/// What an operator does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Action {
    /// Emergency stop, repeated until the robot's state confirms it; the robot stays stopped until `reset`.
    Stop,
    /// Releases a stopped robot, through the motion service.
    Reset,
    /// Shows what the robot is doing and holding, and who commands it.
    State,
    /// Opens the fingers: an object in the hand drops, or stays where it stands. After `reset`.
    Open,
    /// Backs the hand off slowly along its approach direction, as far as the path is free. After `open`.
    Retreat,
    /// Moves slowly to the ready pose on a collision-free path. After `retreat`. Both need a scene to check against, or `--unchecked`.
    Home,
}

/// Runs the command.
pub async fn run(args: &RobotArgs, output: Output) -> CommandResult {
    keys::validate_chunk("robot", &args.robot)?;
    let session = client::connect(&args.system).await?;
    let ended = act(args, &session, output).await;
    client::close(session).await;
    ended
}

async fn act(args: &RobotArgs, session: &Session, output: Output) -> CommandResult {
    let within = Duration::from_millis(args.deadline_ms);
    let robot = &args.robot;
    match args.action {
        Action::Stop => {
            let stopped = emergency_stop_within(session, robot, "repose robot stop", &args.reason, within).await?;
            output.print(&stopped, || describe(robot, &stopped))
        }
        Action::Reset => {
            let shown = client::robot_state(session, robot, within).await?;
            let reply = clear(session, robot, &shown, within).await?;
            let was = shown.stop.map_or_else(String::new, |stop| format!("; it was stopped: {} ({})", stop.reason, stop.kind));
            output.print(&reply, || if reply.was_stopped { format!("{robot} may go on{was}") } else { format!("{robot} was not stopped") })
        }
        Action::State => {
            let state = client::robot_state(session, robot, within).await?;
            output.print(&state, || describe(robot, &state))
        }
        Action::Open => recover(args, session, RecoveryMove::Open, output).await,
        Action::Retreat => recover(args, session, RecoveryMove::Retreat, output).await,
        Action::Home => recover(args, session, RecoveryMove::Home, output).await,
    }
}

/// Clears the stop that a robot's state shows, which this command tells, and none that latches meanwhile.
async fn clear(session: &Session, robot: &str, shown: &RobotState, within: Duration) -> Result<RobotResetReply, Failure> {
    // Asked without a stop, motion clears whichever is latched by then: one that nobody was shown.
    if shown.mode != RobotMode::Stopped {
        return Ok(RobotResetReply { was_stopped: false });
    }
    let motion = session.caller(Service::Motion).await?;
    let request = Payload::json(&RobotResetRequest { robot: robot.to_owned(), stop: shown.stop.clone() })?;
    let answer = motion.call("reset", request, CallOptions::at_most_once(within)).await.map_err(of_motion)?;
    Ok(answer.payload.decode_json()?)
}

/// Brings the arm back, checked against the newest scene of the camera unless that is not wanted.
async fn recover(args: &RobotArgs, session: &Session, motion: RecoveryMove, output: Output) -> CommandResult {
    let mut interrupts = Interrupts::listen()?;
    let scene = match motion {
        RecoveryMove::Retreat | RecoveryMove::Home if !args.unchecked => Some(newest_scene(args, session).await?),
        _ => None,
    };
    let caller = session.caller(Service::Motion).await?;
    let recovery = AskedRecovery::new(&args.robot, motion, scene.as_ref())?;
    let mut answer = moving::call(session, &caller, (&args.robot, "recover"), recovery.by_id()?, &mut interrupts, None).await;
    if let Some(whole) = recovery.again(&answer) {
        answer = moving::call(session, &caller, (&args.robot, "recover"), whole?, &mut interrupts, None).await;
    }
    let reply: RecoverReply = answer.map_err(of_motion)?.payload.decode_json()?;
    output.print(&reply, || recovered(&args.robot, motion, &reply))?;
    if reply.outcome == ExecutionOutcome::Done { Ok(()) } else { Err(Failure::NotAchieved) }
}

fn recovered(robot: &str, motion: RecoveryMove, reply: &RecoverReply) -> String {
    if let Some(reason) = &reply.reason {
        return format!("{robot} did not get there: {reason}");
    }
    let checked =
        if reply.checked_against.is_some() { "" } else { " (without a scene of a calibrated camera: unchecked against its surroundings)" };
    match (motion, reply.retreated_m) {
        (RecoveryMove::Open, _) => format!("{robot}'s fingers are open"),
        (RecoveryMove::Retreat, backed_m) => format!("{robot} has backed off by {:.0} mm{checked}", backed_m.unwrap_or(0.0) * 1e3),
        (RecoveryMove::Home, _) => format!("{robot} is in its ready pose{checked}"),
    }
}

/// A scene of a camera that knows where it stands: one seen from now on, for the arm has moved a moment ago; of a camera that shows nothing new its newest.
async fn newest_scene(args: &RobotArgs, session: &Session) -> Result<IdentifiedScene, Failure> {
    let now_ns = client::robot_state(session, &args.robot, Duration::from_millis(args.deadline_ms)).await?.stamp_ns;
    let newest = async {
        // Two questions: this one waits for perception and a first scene, or says what there is instead. Only then does the time for a newer one begin.
        client::newest_scene(session, &args.camera, SCENE, client::PATIENCE).await?;
        let perception = session.caller(Service::Perception).await?;
        let options = CallOptions::within(SCENE);
        let summary = newest_after(|| fetch_newest(&perception, &args.camera, &options), now_ns, SHOWS_WITHIN).await?;
        let scene = client::whole_scene(session, &summary.scene_id, SCENE_WITHIN).await?;
        Ok::<_, Failure>((summary.scene_id, scene))
    };
    let camera = &args.camera;
    let why = match newest.await {
        Ok(newest) if newest.1.meta.world_frame == WorldFrame::Extrinsics => return Ok(newest),
        Ok(_) => "it does not know where it stands".to_owned(),
        Err(failure) => failure.into_error().message,
    };
    let message = format!("no scene of camera {camera} to check the path against ({why}); nothing has moved. --unchecked goes without");
    Err(of_motion(CallError::precondition(message).at("camera")))
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use repose_proto::robot::StopState;
    use repose_runtime::{Call, Handler};

    use super::*;

    const WITHIN: Duration = Duration::from_secs(30);

    /// Motion of a robot at which some stop is latched by the time it is asked: it writes down what it is to clear, and clears it.
    #[derive(Default)]
    struct Clearing(Mutex<Vec<RobotResetRequest>>);

    #[async_trait::async_trait]
    impl Handler for Clearing {
        async fn call(&self, call: Call) -> Result<Payload, CallError> {
            let request: RobotResetRequest = call.payload.decode_json()?;
            self.0.lock().expect("what was asked").push(request);
            Payload::json(&RobotResetReply { was_stopped: true })
        }
    }

    fn shown(mode: &str, stop: Option<&StopState>) -> RobotState {
        let still = [0.0; 7];
        let state = serde_json::json!({
            "v": 1, "seq": 0, "stamp_ns": 0, "robot_ms": 0.0, "q_rad": still, "dq_rad_s": still, "gripper_width_m": 0.08,
            "gripper_settled": true, "gripper_holding": false, "mode": mode, "stop": stop
        });
        serde_json::from_value(state).expect("a state")
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_reset_clears_the_stop_that_was_shown_and_none_where_none_was() {
        let session = Session::embedded().await.expect("a session");
        let clearing = Arc::new(Clearing::default());
        let _motion = session.start(Service::Motion, clearing.clone()).await.expect("a worker");
        for mode in ["idle", "moving"] {
            let reply = clear(&session, "panda", &shown(mode, None), WITHIN).await.expect("there is nothing to clear");
            assert!(!reply.was_stopped, "{mode}");
        }
        assert!(clearing.0.lock().expect("what was asked").is_empty(), "one that has latched since stays");

        let stop = StopState { kind: "estop".to_owned(), reason: "a hand".to_owned(), estop_id: Some("e1".to_owned()) };
        let reply = clear(&session, "panda", &shown("stopped", Some(&stop)), WITHIN).await.expect("it is cleared");
        assert!(reply.was_stopped);
        let of_that = RobotResetRequest { robot: "panda".to_owned(), stop: Some(stop) };
        assert_eq!(*clearing.0.lock().expect("what was asked"), [of_that]);
    }
}
