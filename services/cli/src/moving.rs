//! Calls that move a robot: they end with this process, and Ctrl-C stops the robot before it ends the command.
//!
//! The first Ctrl-C cancels the call and waits until the robot stands; the second puts the emergency stop and leaves. A liveliness token says that
//! this process is there: where it dies otherwise, the motion service does what it is configured to (`on_client_loss`).

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use repose_proto::robot::{EmergencyStop, RobotMode, RobotState};
use repose_proto::{CallError, ErrorCode, Payload, limits};
use repose_runtime::{Answer, CallOptions, Caller, CancellationToken, Session, Traffic};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::{mpsc, watch};

use crate::client;
use crate::failure::Failure;

/// How long a call that moves a robot may take.
const LONGEST: Duration = Duration::from_secs(600);
/// How long a robot may take to come to rest.
const REST: Duration = Duration::from_secs(20);
/// How long the emergency stop is repeated before the command leaves in any case.
const LAST_STOP: Duration = Duration::from_secs(3);
/// Between two puts of an emergency stop.
const REPEAT: Duration = Duration::from_millis(20);
/// A joint below this speed stands, radians per second.
const STANDS_RAD_S: f64 = 1e-6;

/// Ctrl-C and SIGTERM from now on: while nothing moves they end the process as ever.
pub struct Interrupts {
    moving: Arc<AtomicBool>,
    count: watch::Receiver<usize>,
}

impl Interrupts {
    /// Listens.
    ///
    /// # Errors
    /// When the operating system refuses.
    pub fn listen() -> Result<Self, Failure> {
        let mut interrupt = signal(SignalKind::interrupt()).map_err(Failure::other)?;
        let mut terminate = signal(SignalKind::terminate()).map_err(Failure::other)?;
        let moving = Arc::new(AtomicBool::new(false));
        let (counted, count) = watch::channel(0);
        let is_moving = moving.clone();
        tokio::spawn(async move {
            loop {
                let number = tokio::select! {
                    _ = interrupt.recv() => libc::SIGINT,
                    _ = terminate.recv() => libc::SIGTERM,
                };
                if !is_moving.load(Ordering::Acquire) {
                    // The conventional status of a process that a signal ended.
                    std::process::exit(128 + number);
                }
                counted.send_modify(|count| *count += 1);
            }
        });
        Ok(Self { moving, count })
    }

    async fn next(&mut self) {
        // The listener never ends.
        let _listening = self.count.changed().await;
    }
}

/// Calls a method that moves `robot`, at most once; how far it is goes to `progress`, where somebody listens.
///
/// # Errors
/// The call's own; where it was interrupted, how the robot stands and what to do.
pub async fn call(
    session: &Session,
    motion: &Caller,
    (robot, method): (&str, &str),
    payload: Payload,
    interrupts: &mut Interrupts,
    progress: Option<mpsc::Sender<Payload>>,
) -> Result<Answer, Failure> {
    let id = uuid::Uuid::new_v4().to_string();
    let _alive = session.transport().declare_alive(&session.cell().live_client(&id)).await?;
    let cancel = CancellationToken::new();
    let options = CallOptions { id: Some(id), cancel: cancel.clone(), progress, ..CallOptions::at_most_once(LONGEST) };
    interrupts.moving.store(true, Ordering::Release);
    let answered = tokio::select! {
        answered = motion.call(method, payload, options) => answered.map_err(of_motion),
        () = interrupts.next() => {
            tracing::warn!(robot, "interrupted: the robot comes to rest on its path; Ctrl-C again puts the emergency stop and leaves");
            cancel.cancel();
            Err(stopped(session, robot, interrupts).await)
        }
    };
    interrupts.moving.store(false, Ordering::Release);
    answered
}

/// Waits until the robot stands, or puts the emergency stop when interrupted again; how it ended.
async fn stopped(session: &Session, robot: &str, interrupts: &mut Interrupts) -> Failure {
    let message = tokio::select! {
        rest = tokio::time::timeout(REST, rest(session, robot)) => match rest {
            Ok(Ok(state)) => format!("interrupted: {}", describe(robot, &state)),
            Ok(Err(failure)) => return failure,
            Err(_) => format!("interrupted, and {robot} has not shown that it stands within {} s", REST.as_secs()),
        },
        () = interrupts.next() => {
            match tokio::time::timeout(LAST_STOP, emergency_stop(session, robot, "repose", "interrupted twice")).await {
                Ok(Ok(state)) => format!("interrupted twice: {}", describe(robot, &state)),
                Ok(Err(failure)) => return failure,
                Err(_) => format!("interrupted twice: the emergency stop was put, and {robot} has not shown it"),
            }
        }
    };
    Failure::Other(CallError::new(ErrorCode::Cancelled, message))
}

/// The robot's state once it stands and its task is over.
async fn rest(session: &Session, robot: &str) -> Result<RobotState, Failure> {
    let mut states = session.subscribe_latest(&session.cell().robot_state(robot)).await?;
    loop {
        let sample = states.recv().await.ok_or_else(|| Failure::other("the session has closed"))?;
        let Ok(state) = sample.payload.decode_json::<RobotState>() else { continue };
        let stands = state.dq_rad_s.iter().all(|v| v.abs() < STANDS_RAD_S);
        let over = state.mode == RobotMode::Stopped || state.mode == RobotMode::Idle && state.open_task().is_none();
        if stands && over {
            return Ok(state);
        }
    }
}

/// Puts an emergency stop until a state shows it, or one that was latched before it.
///
/// # Errors
/// When the network refuses.
pub async fn emergency_stop(session: &Session, robot: &str, source: &str, reason: &str) -> Result<RobotState, Failure> {
    let mut states = session.subscribe_latest(&session.cell().robot_state(robot)).await?;
    let (source, reason) = (source.to_owned(), reason.to_owned());
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

/// A robot's state for a person: what it does, what it holds, who commands, and what can be done.
pub fn describe(robot: &str, state: &RobotState) -> String {
    let mut said = vec![match (&state.stop, state.mode) {
        (Some(stop), _) => format!("{robot} is stopped: {} ({})", stop.reason, stop.kind),
        (None, RobotMode::Stopped) => format!("{robot} is stopped and does not say why"),
        (None, RobotMode::Idle) => format!("{robot} stands"),
        (None, RobotMode::Moving) => format!("{robot} moves"),
    }];
    said.push(match (&state.held, state.gripper_holding) {
        (Some(held), _) => format!("it holds object {} of scene {}", held.object, held.scene_id.chars().take(12).collect::<String>()),
        (None, true) => format!("it holds something {:.0} mm wide", state.gripper_width_m * 1e3),
        (None, false) => format!("its hand is empty, fingers {:.0} mm apart", state.gripper_width_m * 1e3),
    });
    said.push(match (&state.owner, state.open_task()) {
        (Some(owner), Some(task)) => format!("{} commands it (task {task})", owner.id),
        (Some(owner), None) => format!("{} commanded it last", owner.id),
        (None, _) => "nobody has commanded it".to_owned(),
    });
    if state.mode == RobotMode::Stopped {
        said.push("`repose robot reset` clears the stop; then `repose robot open`, `retreat` and `home` bring it back".to_owned());
    }
    said.join("; ")
}

/// No grasp, no path, a latched stop: not what was asked is at fault, but what is there.
pub fn of_motion(error: CallError) -> Failure {
    match error.code {
        ErrorCode::FailedPrecondition => Failure::Other(error),
        _ => Failure::from(error),
    }
}
