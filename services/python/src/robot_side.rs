//! The robot's side of a driver that is written in Python: commands and emergency stops in, set-points out, states shown.
//!
//! The rules are those of `repose_robot_side`, which the simulated robot is under too. Python's loop calls [`RobotSide::step`]; between two of
//! them nothing moves, since it is that loop which hands set-points to the joints.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use repose_panda::Joints;
use repose_proto::robot::{EmergencyStop, RobotCommand, RobotMode};
use repose_proto::{CallError, Payload, RigidTransform};
use repose_robot_side::{Arm, ArmSettings, GripperState, StateDetails, TICK_S, state_of};
use repose_runtime::{CancellationToken, Session, Traffic, now_ns};
use tokio::sync::{mpsc, watch};

use crate::connection::Connection;
use crate::error::raised;
use crate::waiting::wait_for;

/// Commands that may wait for the next step; more are refused.
const COMMANDS: usize = 64;
/// Emergency stops that may wait in the network, and for the next step; they are repeated.
const STOPS: usize = 16;
/// Longest time that a step makes up for when the loop was held up; more is lost to robot time.
const CATCH_UP: Duration = Duration::from_millis(60);
/// Longest time between two states: what is told more seldom is taken for silent.
const LONGEST_STATE_PERIOD: Duration = Duration::from_millis(50);
/// How far a joint may be off its set-point, radians. An arm at rest that is further off is sent where it was measured: with next to nothing, one
/// that sags a little under its weight would be sent lower and lower.
const FOLLOWING_RAD: std::ops::RangeInclusive<f64> = 0.001..=1.0;
/// How long it is listened for another driver of the same robot: states come twenty times a second or more often.
const LISTEN: Duration = Duration::from_millis(300);

/// A command and when it came, or why it cannot be read.
type Received = (Instant, Result<RobotCommand, CallError>);

/// Set-points and velocities (radians, radians per second), mode, gripper action (metres, newtons), stop (kind, reason), what was refused.
type Stepped = (Joints, Joints, &'static str, Option<(f64, f64)>, Option<(String, String)>, Vec<String>);

/// The controller of one robot.
#[pyclass(frozen, module = "repose._native")]
pub struct RobotSide {
    running: Mutex<Running>,
    end: CancellationToken,
}

struct Running {
    arm: Arm,
    commands: mpsc::Receiver<Received>,
    stops: Arc<Mutex<Vec<EmergencyStop>>>,
    states: watch::Sender<Option<Payload>>,
    world_from_base: Option<RigidTransform>,
    state_period: Duration,
    started: Instant,
    stepped: Instant,
    next_state: Instant,
    shown_mode: RobotMode,
    /// Time that was handed in and is not a whole tick yet, seconds.
    owed_s: f64,
    ticks: u64,
    states_made: u64,
}

#[pymethods]
impl RobotSide {
    /// Joins a robot that stands at `joints_rad` to its keys.
    #[new]
    #[pyo3(signature = (
        connection, robot, joints_rad, *, model, world_from_base, state_period_s, following_tolerance_rad, starts_stopped,
    ))]
    #[expect(clippy::too_many_arguments, reason = "named arguments of a function that only the package's own Python calls")]
    fn new(
        py: Python<'_>,
        connection: &Connection,
        robot: &str,
        joints_rad: Joints,
        model: &str,
        world_from_base: Option<[f64; 16]>,
        state_period_s: f64,
        following_tolerance_rad: f64,
        starts_stopped: bool,
    ) -> PyResult<Self> {
        let unknown = || raised(CallError::invalid("model", format!("expected panda or fr3, got {model:?}")));
        let settings = ArmSettings { following_tolerance_rad, ..ArmSettings::of_model(model).ok_or_else(unknown)? };
        if !FOLLOWING_RAD.contains(&following_tolerance_rad) {
            let message = format!("expected {} to {} rad, got {following_tolerance_rad}", FOLLOWING_RAD.start(), FOLLOWING_RAD.end());
            return Err(raised(CallError::invalid("following_tolerance_rad", message)));
        }
        let world_from_base = world_from_base.map(RigidTransform);
        repose_proto::keys::validate_chunk("name", robot).map_err(raised)?;
        world_from_base.map_or(Ok(()), |pose| pose.validate("world_from_base")).map_err(raised)?;
        if let Some(joint) = settings.rules.limits.outside(&joints_rad, 0.0) {
            let message = format!("joint {joint} stands at {:.4} rad, outside the arm's limits", joints_rad[joint]);
            return Err(raised(CallError::precondition(message).at("joints_rad")));
        }
        let state_period = Duration::try_from_secs_f64(state_period_s).ok().filter(|period| *period <= LONGEST_STATE_PERIOD);
        let state_period = state_period
            .ok_or_else(|| raised(CallError::invalid("state_period_s", format!("expected 0 to 0.05 s, got {state_period_s}"))))?;
        let (handle, end) = (connection.handle().map_err(raised)?, CancellationToken::new());
        let ends = wait_for(py, handle, || joined(connection.session().clone(), robot, end.clone()))?;
        let (commands, stops, states) = ends.map_err(raised)?;
        let now = Instant::now();
        let running = Running {
            arm: if starts_stopped { Arm::found_at(joints_rad, settings, 0.0, None) } else { Arm::standing_at(joints_rad, settings) },
            commands,
            stops,
            states,
            world_from_base,
            state_period,
            started: now,
            stepped: now,
            next_state: now,
            shown_mode: RobotMode::Idle,
            owed_s: 0.0,
            ticks: 0,
            states_made: 0,
        };
        Ok(Self { running: Mutex::new(running), end })
    }

    /// Goes on by `elapsed_s` of robot time, or by the time since the last step. `gripper`: opening (metres), settled, holding.
    #[pyo3(signature = (measured_rad, gripper, elapsed_s = None))]
    fn step(&self, measured_rad: Joints, gripper: (f64, bool, bool), elapsed_s: Option<f64>) -> PyResult<Stepped> {
        let (width_m, settled, holding) = gripper;
        if elapsed_s.is_some_and(|s| !(0.0..=1.0).contains(&s)) {
            return Err(raised(CallError::invalid("elapsed_s", format!("expected 0 to 1 s, got {elapsed_s:?}"))));
        }
        if !width_m.is_finite() {
            return Err(raised(CallError::invalid("width_m", format!("expected metres, got {width_m}"))));
        }
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(running.step(&measured_rad, GripperState { width_m, settled, holding }, elapsed_s))
    }

    /// Latches a stop on an arm that moves, because its driver ends: the steps that follow bring it to rest.
    fn end(&self) {
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        if running.arm.mode() == RobotMode::Moving {
            running.arm.fault("driver_ended", "the robot's driver has ended in mid-motion".to_owned());
        }
    }

    /// Leaves the keys.
    fn close(&self) {
        self.end.cancel();
    }
}

impl Drop for RobotSide {
    fn drop(&mut self) {
        self.end.cancel();
    }
}

impl Running {
    fn step(&mut self, measured_rad: &Joints, gripper: GripperState, elapsed_s: Option<f64>) -> Stepped {
        let now = Instant::now();
        let since = std::mem::replace(&mut self.stepped, now);
        let refused = self.take(now, gripper);
        self.arm.measured(measured_rad);
        self.owed_s += elapsed_s.unwrap_or_else(|| now.duration_since(since).min(CATCH_UP).as_secs_f64());
        let now_s = now.duration_since(self.started).as_secs_f64();
        while self.owed_s >= TICK_S {
            self.owed_s -= TICK_S;
            self.ticks += 1;
            self.arm.tick(now_s);
        }
        if now >= self.next_state || self.arm.mode() != self.shown_mode {
            self.next_state = now + self.state_period;
            self.shown_mode = self.arm.mode();
            self.show(gripper);
        }
        let action = self.arm.take_gripper().map(|g| (g.width_m, g.force_n));
        let stop = self.arm.stop().map(|s| (s.kind.clone(), s.reason.clone()));
        (*self.arm.q_rad(), *self.arm.dq_rad_s(), name_of(self.arm.mode()), action, stop, refused)
    }

    /// Hands what has come to the arm; what it does not take, and why.
    fn take(&mut self, now: Instant, gripper: GripperState) -> Vec<String> {
        let since_start = |at: Instant| at.saturating_duration_since(self.started).as_secs_f64();
        self.arm.set_grips(gripper.holding, since_start(now));
        for stop in self.stops.lock().unwrap_or_else(PoisonError::into_inner).drain(..) {
            self.arm.emergency_stop(&stop);
        }
        let mut refused = Vec::new();
        while let Ok((at, command)) = self.commands.try_recv() {
            let why = match command {
                Ok(command) => match self.arm.late_command(&command, since_start(at), since_start(now)) {
                    Ok(()) => continue,
                    Err(why) => format!("command {} of {}: {why}", command.seq, command.owner.id),
                },
                Err(error) => format!("a command that cannot be read: {error}"),
            };
            refused.push(why);
        }
        refused
    }

    fn show(&mut self, gripper: GripperState) {
        self.states_made += 1;
        let shown = StateDetails {
            seq: self.states_made,
            stamp_ns: now_ns(),
            robot_ms: self.ticks as f64 * TICK_S * 1e3,
            gripper,
            world_from_base: self.world_from_base,
        };
        // A state has nothing that JSON cannot say: its numbers were checked to be finite.
        if let Ok(payload) = Payload::json(&state_of(&self.arm, &shown)) {
            self.states.send_replace(Some(payload));
        }
    }
}

fn name_of(mode: RobotMode) -> &'static str {
    match mode {
        RobotMode::Idle => "idle",
        RobotMode::Moving => "moving",
        RobotMode::Stopped => "stopped",
    }
}

/// What comes from a robot's keys and goes to them: commands, emergency stops, states.
type Ends = (mpsc::Receiver<Received>, Arc<Mutex<Vec<EmergencyStop>>>, watch::Sender<Option<Payload>>);

/// Subscribes and publishes until `end`, where no other driver is there.
async fn joined(session: Session, robot: &str, end: CancellationToken) -> Result<Ends, CallError> {
    let cell = session.cell();
    let mut others = session.subscribe_latest(&cell.robot_state(robot)).await?;
    if tokio::time::timeout(LISTEN, others.recv()).await.is_ok() {
        let message = format!("another driver tells the state of robot {robot} in this cell: end it, or take another name");
        return Err(CallError::precondition(message).at("name"));
    }
    drop(others);
    let mut stops = session.subscribe_queue(&cell.robot_estop(robot), STOPS).await?;
    let mut incoming = session.subscribe_queue(&cell.robot_command(robot), COMMANDS).await?;
    let publisher = session.publisher(cell.robot_state(robot), Traffic::RobotState);
    let (states, mut newest) = watch::channel::<Option<Payload>>(None);
    let (sender, commands) = mpsc::channel(COMMANDS);
    let waiting: Arc<Mutex<Vec<EmergencyStop>>> = Arc::default();
    let latest = waiting.clone();
    let stopping = async move {
        while let Some(sample) = stops.recv().await {
            // Whatever comes here stops the arm: its form and its encoding do not matter.
            let stop = EmergencyStop::read(&sample.payload.bytes);
            let mut waiting = latest.lock().unwrap_or_else(PoisonError::into_inner);
            // The arm is stopped by those that wait; where there are too many, this one is repeated.
            if waiting.len() < STOPS && !waiting.contains(&stop) {
                waiting.push(stop);
            }
        }
    };
    let commanding = async move {
        while let Some(sample) = incoming.recv().await {
            // Where too many wait for a step, this one is lost; commanders repeat what is not taken.
            let _ = sender.try_send((Instant::now(), sample.payload.decode_json()));
        }
    };
    let telling = async move {
        while newest.changed().await.is_ok() {
            let payload = newest.borrow_and_update().clone();
            // What the network refuses now it may take with the next state.
            if let Some(payload) = payload {
                let _ = publisher.put(payload).await;
            }
        }
    };
    tokio::spawn(async move {
        tokio::select! {
            () = end.cancelled() => {}
            _ = async { tokio::join!(stopping, commanding, telling) } => {}
        }
    });
    Ok((commands, waiting, states))
}
