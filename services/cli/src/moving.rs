//! Calls that move a robot: they end with this process, and Ctrl-C stops the robot before it ends the command.
//!
//! The first Ctrl-C cancels the call and waits until the robot stands; the second puts the emergency stop and leaves. A liveliness token says that
//! this process is there: where it dies otherwise, the motion service does what it is configured to (`on_client_loss`).

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use repose_proto::robot::{RobotMode, RobotState};
use repose_proto::{CallError, ErrorCode, Payload};
use repose_runtime::{Answer, CallOptions, Caller, CancellationToken, Session, call_moving, emergency_stop, read_robot_state};
use repose_sentences::robot::describe;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::{mpsc, watch};

use crate::failure::Failure;

/// How long a call that moves a robot may take.
const LONGEST: Duration = Duration::from_secs(600);
/// How long a robot may take to come to rest.
const REST: Duration = Duration::from_secs(20);
/// How long the emergency stop is repeated before the command leaves in any case.
const LAST_STOP: Duration = Duration::from_secs(3);
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
) -> Result<Answer, CallError> {
    let cancel = CancellationToken::new();
    let options = CallOptions { cancel: cancel.clone(), progress, ..CallOptions::at_most_once(LONGEST) };
    interrupts.moving.store(true, Ordering::Release);
    let answered = tokio::select! {
        answered = call_moving(session, motion, method, payload, options) => answered,
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
async fn stopped(session: &Session, robot: &str, interrupts: &mut Interrupts) -> CallError {
    let message = tokio::select! {
        rest = tokio::time::timeout(REST, rest(session, robot)) => match rest {
            Ok(Ok(state)) => format!("interrupted: {}", describe(robot, &state)),
            Ok(Err(error)) => return error,
            Err(_) => format!("interrupted, and {robot} has not shown that it stands within {} s", REST.as_secs()),
        },
        () = interrupts.next() => {
            match tokio::time::timeout(LAST_STOP, emergency_stop(session, robot, "repose", "interrupted twice")).await {
                Ok(Ok(state)) => format!("interrupted twice: {}", describe(robot, &state)),
                Ok(Err(error)) => return error,
                Err(_) => format!("interrupted twice: the emergency stop was put, and {robot} has not shown it"),
            }
        }
    };
    CallError::new(ErrorCode::Cancelled, message)
}

/// The robot's state once it stands and its task is over.
async fn rest(session: &Session, robot: &str) -> Result<RobotState, CallError> {
    let mut states = session.subscribe_latest(&session.cell().robot_state(robot)).await?;
    loop {
        let sample = states.recv().await.ok_or_else(|| CallError::internal("the session has closed"))?;
        let Ok(state) = read_robot_state(&sample) else { continue };
        let stands = state.dq_rad_s.iter().all(|v| v.abs() < STANDS_RAD_S);
        let over = state.mode == RobotMode::Stopped || state.mode == RobotMode::Idle && state.open_task().is_none();
        if stands && over {
            return Ok(state);
        }
    }
}

/// No grasp, no path, a latched stop: not what was asked is at fault, but what is there.
pub fn of_motion(error: CallError) -> Failure {
    match error.code {
        ErrorCode::FailedPrecondition => Failure::Other(error),
        _ => Failure::from(error),
    }
}
