//! A real robot: the control interface by `franka-rs`.
//!
//! Set-points go out as they are, without its low-pass filter and rate limiter: the arm's are smooth and within the limits, after a gap too.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

use franka::{
    ControlException, FrankaError, JointPositions, MoveControllerMode, MoveStatus, RealtimeConfig, Robot, RobotOptions, RobotState,
    VersionPolicy, motion_finished,
};
use repose_panda::{JointLimits, Model};

use super::fci::{Fci, Next, Reading, Trouble};
use super::identity::{identify, version_of};

/// By how much later than the robot's clock has gone on a reading may come, and how much later an answer may go out: for a cycle that is over, the
/// robot takes no set-point.
const LATE: Duration = Duration::from_millis(1);
/// A reading that is there in less than this had been waiting.
const QUEUED: Duration = Duration::from_micros(200);

/// From what torques and forces the robot takes a touch for a collision, and stops by a reflex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CollisionThresholds {
    /// Per joint, newton metres.
    pub torque_nm: [f64; 7],
    /// Along x, y, z (newtons) and about them (newton metres), at the end effector.
    pub force_n: [f64; 6],
}

/// How to reach a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct ConnectSettings {
    /// Its address, with `:PORT` where that is another than 1337.
    pub address: String,
    /// What it should be.
    pub model: Model,
    /// Whether a kernel and a priority for real time are demanded.
    pub realtime: RealtimeConfig,
    /// When it stops by itself.
    pub collision: CollisionThresholds,
}

/// Why there is no connection.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConnectError {
    /// It may be there later.
    #[error("{0}")]
    Unreachable(String),
    /// It is there, and another robot, or cannot be driven from this machine.
    #[error("{0}")]
    Unfit(String),
}

/// A connected robot.
pub struct Connection {
    robot: Arc<Robot>,
    collision: CollisionThresholds,
    /// Whether the robot has been told the thresholds: it takes them only while it is ready.
    is_prepared: bool,
    wanted: SyncSender<()>,
    outcome: Receiver<Result<(), String>>,
}

impl Connection {
    /// Connects to a robot; what it may be commanded under, and what is worth knowing of it.
    ///
    /// # Errors
    /// [`ConnectError`].
    pub fn open(settings: &ConnectSettings) -> Result<(Self, JointLimits, Vec<String>), ConnectError> {
        let version = version_of(settings.model);
        let options = RobotOptions::new(settings.realtime).with_version(VersionPolicy::Exact(version));
        let robot = Robot::with_options(&settings.address, options).map_err(|error| match error {
            FrankaError::IncompatibleVersion { server_version, library_version } => ConnectError::Unfit(format!(
                "model = \"{}\" speaks version {library_version} of FCI, and the robot at {} version {server_version} (a panda speaks 5, an fr3 10): \
                 it is another model, or its system has another release",
                settings.model.name(),
                settings.address,
            )),
            FrankaError::Realtime(message) => ConnectError::Unfit(format!("realtime = \"require\": {}", plain(&message))),
            other => ConnectError::Unreachable(format!("{}: {}", settings.address, plain(&other.to_string()))),
        })?;
        let (limits, notes) = match settings.model {
            Model::Panda => (settings.model.commanded_limits(), Vec::new()),
            Model::Fr3 => {
                let urdf = robot.robot_model().map_err(|e| ConnectError::Unreachable(plain(&e.to_string())))?;
                let identity =
                    identify(settings.model, &urdf).map_err(|why| ConnectError::Unfit(format!("{} is no fr3: {why}", settings.address)))?;
                (identity.limits, identity.notes)
            }
        };
        let robot = Arc::new(robot);
        let (wanted, outcome) = recovering(robot.clone()).map_err(|e| ConnectError::Unfit(format!("no thread for recoveries: {e}")))?;
        Ok((Self { robot, collision: settings.collision, is_prepared: false, wanted, outcome }, limits, notes))
    }

    fn prepare(&mut self) -> Result<(), Trouble> {
        if !self.is_prepared {
            let CollisionThresholds { torque_nm, force_n } = self.collision;
            self.robot.set_collision_behavior_simple(torque_nm, torque_nm, force_n, force_n).map_err(trouble)?;
            self.is_prepared = true;
        }
        Ok(())
    }
}

impl Fci for Connection {
    fn read(&mut self) -> Result<Reading, Trouble> {
        self.robot.read_once().map(|state| reading(&state)).map_err(trouble)
    }

    fn follow(&mut self, step: &mut dyn FnMut(&Reading) -> Next) -> Result<(), Trouble> {
        self.prepare()?;
        let mut motion = self.robot.start_joint_position_control(MoveControllerMode::JointImpedance).map_err(trouble)?;
        let mut last: Option<(Instant, u64)> = None;
        let mut is_behind = false;
        loop {
            let began = Instant::now();
            let (state, _) = motion.read_once().map_err(trouble)?;
            let (read, state) = (Instant::now(), reading(&state));
            let passed = |time_ms: u64| Duration::from_millis(state.time_ms.saturating_sub(time_ms));
            let is_late = last.is_some_and(|(then, time_ms)| read - then > passed(time_ms) + LATE);
            last = Some((read, state.time_ms));
            // Where the process was held up, the robot has gone on: the one that it waited for then is old, and so is what has queued up since.
            is_behind = if is_behind { read - began < QUEUED } else { is_late };
            if is_behind {
                continue;
            }
            let next = step(&state);
            is_behind = read.elapsed() > LATE;
            match next {
                Next::Go(_) if is_behind => {}
                Next::Go(q_rad) => motion.write_once(&JointPositions::new(q_rad), None).map_err(trouble)?,
                Next::End(q_rad) => return motion.write_once(&motion_finished(JointPositions::new(q_rad)), None).map_err(trouble),
            }
        }
    }

    fn recover(&mut self) {
        // Where one is under way, its end is awaited.
        if let Err(TrySendError::Disconnected(())) = self.wanted.try_send(()) {
            tracing::error!("the thread for recoveries has ended");
        }
    }

    fn recovered(&mut self) -> Option<Result<(), String>> {
        self.outcome.try_recv().ok()
    }
}

/// What asks the thread for recoveries, and what it answers.
type Recoveries = (SyncSender<()>, Receiver<Result<(), String>>);

/// A thread that has the robot acknowledge its errors, which takes it a second; it ends with the connection.
fn recovering(robot: Arc<Robot>) -> std::io::Result<Recoveries> {
    let (wanted, wishes) = sync_channel::<()>(1);
    let (outcomes, outcome) = sync_channel(1);
    let recover = move || {
        while wishes.recv().is_ok() {
            let ended = robot.automatic_error_recovery().map_err(|e| plain(&e.to_string()));
            if outcomes.send(ended).is_err() {
                return;
            }
        }
    };
    std::thread::Builder::new().name("recovery".to_owned()).spawn(recover)?;
    Ok((wanted, outcome))
}

fn reading(state: &RobotState) -> Reading {
    Reading {
        time_ms: state.time.as_millis(),
        mode: state.robot_mode,
        measured_rad: state.q,
        held_rad: state.q_d,
        held_rad_s: state.dq_d,
        held_rad_s2: state.ddq_d,
        errors: state.current_errors,
        success_rate: state.control_command_success_rate,
    }
}

/// What an error of the library means to the arm.
fn trouble(error: FrankaError) -> Trouble {
    let stopped = |kind: &str, reason: String| Trouble::Stopped { kind: kind.to_owned(), reason };
    match error {
        FrankaError::Network(message) | FrankaError::Protocol(message) => Trouble::Lost(plain(&message)),
        FrankaError::Control(exception) => stopped(kind_of(&exception), plain(&exception.message)),
        // Thresholds or a motion that the robot does not take now.
        FrankaError::Command(message) => stopped("motion_refused", plain(&message)),
        other => stopped("motion_refused", plain(&other.to_string())),
    }
}

/// The robot's own name for what ended a motion.
fn kind_of(exception: &ControlException) -> &'static str {
    if let Some(name) = exception.last_motion_errors.names().first() {
        return name;
    }
    match exception.move_status {
        Some(MoveStatus::EmergencyAborted) => "user_stop",
        Some(MoveStatus::PreemptedDueToActivatedSafetyFunctions | MoveStatus::CommandRejectedDueToActivatedSafetyFunctions) => {
            "safety_function"
        }
        Some(MoveStatus::StartAtSingularPoseRejected | MoveStatus::CommandNotPossibleRejected | MoveStatus::InvalidArgumentRejected) => {
            "motion_refused"
        }
        _ => "motion_aborted",
    }
}

/// A message of the library in one line, without its name.
fn plain(message: &str) -> String {
    let lines: Vec<&str> =
        message.lines().map(|line| line.trim().trim_start_matches("libfranka:").trim()).filter(|l| !l.is_empty()).collect();
    lines.join("; ")
}

#[cfg(test)]
mod tests {
    use franka::Errors;

    use super::*;

    #[test]
    fn a_reflex_is_told_by_the_robots_name_for_it() {
        let mut exception = ControlException::new("libfranka: Move command aborted: motion aborted by reflex!\n[\"cartesian_reflex\"]");
        exception.move_status = Some(MoveStatus::ReflexAborted);
        exception.last_motion_errors.0[Errors::index_of("cartesian_reflex").expect("a name")] = true;
        let told = trouble(FrankaError::Control(exception));
        let reason = "Move command aborted: motion aborted by reflex!; [\"cartesian_reflex\"]".to_owned();
        assert_eq!(told, Trouble::Stopped { kind: "cartesian_reflex".to_owned(), reason });
    }

    #[test]
    fn what_has_no_name_is_told_by_how_the_motion_ended() {
        for (status, kind) in [
            (MoveStatus::EmergencyAborted, "user_stop"),
            (MoveStatus::Preempted, "motion_aborted"),
            (MoveStatus::StartAtSingularPoseRejected, "motion_refused"),
            (MoveStatus::PreemptedDueToActivatedSafetyFunctions, "safety_function"),
        ] {
            let exception = ControlException { move_status: Some(status), ..ControlException::new("it ended") };
            assert_eq!(kind_of(&exception), kind);
        }
        assert_eq!(
            trouble(FrankaError::Network("libfranka: UDP receive: Timeout".to_owned())),
            Trouble::Lost("UDP receive: Timeout".to_owned())
        );
    }
}
