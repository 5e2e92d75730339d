//! The robot's side of the keys: state out, timed set-points and stops in. Plain puts, JSON.
//!
//! One owner commands a robot at a time. A commander takes ownership with an epoch higher than any that `state` showed; the robot's
//! side ignores commands of lower epochs, of other owners under the same epoch, and of sequence numbers it has passed. So a command may be
//! sent again under its number when it may have been lost: it is acted on once, and the last one's repeat only begins its time to live anew.
//! Limits are enforced there, whatever a command asks for.
//!
//! What must not be left half done is a task: a command opens it, a later one closes it, and in between its owner is heard at least once in every
//! time to live. The robot's side latches a stop when it is not, moving or at rest, and when a task is closed with an object in the hand. So a
//! robot whose commander dies never stands there with an object in its hand and no stop latched.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{check_finite, check_range};
use crate::{CallError, Message, RigidTransform, keys, limits};

/// The models that have the Panda's links, joints and hand: whoever knows its shape and reach knows theirs.
pub const PANDA_LIKE: [&str; 2] = ["panda", "fr3"];

/// A timed joint set-point. Positions between two are interpolated at 1 kHz of robot time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SetPoint {
    /// Robot time since the start of the stream or phase, milliseconds.
    pub t_ms: f64,
    /// Joint positions, radians.
    pub q_rad: [f64; 7],
    /// Joint velocities, radians per second.
    pub dq_rad_s: [f64; 7],
}

impl SetPoint {
    /// Refuses numbers that are not finite and negative times.
    ///
    /// # Errors
    /// `invalid_argument` that names the field below `field`.
    pub fn validate(&self, field: &str) -> Result<(), CallError> {
        check_range(&format!("{field}.t_ms"), self.t_ms, 0.0..=1e9)?;
        check_finite(&format!("{field}.q_rad"), &self.q_rad)?;
        check_finite(&format!("{field}.dq_rad_s"), &self.dq_rad_s)
    }
}

/// What the gripper is to do.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GripperCommand {
    /// Opening to reach, metres, 0 to 0.08.
    pub width_m: f64,
    /// Grip force when something is in the way, newtons.
    pub force_n: f64,
}

impl GripperCommand {
    /// Checks the gripper's range.
    ///
    /// # Errors
    /// `invalid_argument` that names the field below `field`.
    pub fn validate(&self, field: &str) -> Result<(), CallError> {
        check_range(&format!("{field}.width_m"), self.width_m, 0.0..=0.08)?;
        check_range(&format!("{field}.force_n"), self.force_n, 0.0..=70.0)
    }
}

/// Who commands, and since which epoch.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Owner {
    /// The commander's name: its worker id.
    pub id: String,
    /// Grows with every change of owner, to 2^53 - 1 at most.
    pub epoch: u64,
}

/// What the arm is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RobotMode {
    /// Standing, ready.
    Idle,
    /// Following set-points.
    Moving,
    /// A stop is latched: standing, or braking to it. Nothing but a reset is accepted.
    Stopped,
}

/// Why a stop is latched.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct StopState {
    /// `estop`, or the name of the reflex: `commander_silent`, `task_unfinished`, `joint_position_limit`, `joint_velocity_limit`,
    /// `joint_acceleration_limit`, `start_pose_mismatch`, `invalid_command`.
    pub kind: String,
    /// The same for a person.
    pub reason: String,
    /// The emergency stop's id, when it was one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub estop_id: Option<String>,
}

/// A task as a command tells of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// The task's id, 1 to 64 characters; an execution's is the id of its request.
    pub id: String,
    /// Whether it goes on. The command that says no is its last one.
    pub open: bool,
    /// With a gripper action that closes: what is to be held from then on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grasps: Option<HeldObject>,
}

/// What a robot's side says of tasks.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TaskState {
    /// The open task's id; none between tasks. A stop that latches leaves it open; whoever clears the stop closes it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
}

/// An object in the hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HeldObject {
    /// The scene in which it was seen.
    pub scene_id: String,
    /// Its id there.
    pub object: u16,
    /// The lower corner of a box around it, in the frame of the tool centre point (z is the approach, y the opening), metres.
    pub low_m: [f64; 3],
    /// The upper corner, metres.
    pub high_m: [f64; 3],
}

impl HeldObject {
    /// Checks the box.
    ///
    /// # Errors
    /// `invalid_argument` that names the field below `field`.
    pub fn validate(&self, field: &str) -> Result<(), CallError> {
        check_finite(&format!("{field}.low_m"), &self.low_m)?;
        check_finite(&format!("{field}.high_m"), &self.high_m)?;
        match (0..3).find(|&i| self.low_m[i] > self.high_m[i]) {
            Some(i) => Err(CallError::invalid(format!("{field}.high_m[{i}]"), "expected at least what low_m says")),
            None => Ok(()),
        }
    }
}

/// State of a robot, put at a fixed rate and on every change of mode. Receivers ignore fields that they do not know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RobotState {
    /// Contract version, 1.
    pub v: u32,
    /// Counts states.
    pub seq: u64,
    /// When, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// Robot time, milliseconds since the robot's side started; runs at its own rate in simulation.
    pub robot_ms: f64,
    /// Joint positions, radians.
    pub q_rad: [f64; 7],
    /// Joint velocities, radians per second.
    pub dq_rad_s: [f64; 7],
    /// Gripper opening, metres.
    pub gripper_width_m: f64,
    /// Whether the gripper has reached its commanded width, or stands against something.
    pub gripper_settled: bool,
    /// Whether the gripper stands against something before its commanded width.
    pub gripper_holding: bool,
    /// What the arm is doing.
    pub mode: RobotMode,
    /// Why it is stopped, when it is.
    pub stop: Option<StopState>,
    /// Who commands it.
    pub owner: Option<Owner>,
    /// The last command taken.
    pub last_command: Option<u64>,
    /// Robot time on the current stream, milliseconds: how far the set-points have been followed; none before the first.
    pub stream_ms: Option<f64>,
    /// The open task, if there is one. A robot's side that knows tasks always says this; to one that does not, commands say none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task: Option<TaskState>,
    /// What is in the hand, as far as it was told; none where `gripper_holding` is false.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held: Option<HeldObject>,
    /// How long ago the hand last closed on an object or let go of one, milliseconds by the robot's own clock; none where it has not since the
    /// robot's side started. A scene that was seen before that is out of date.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since_handling_ms: Option<u64>,
    /// The robot's model, `panda` or `fr3`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Where the robot's base stands in the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world_from_base: Option<RigidTransform>,
    /// How far ahead of itself it needs set-points, milliseconds: a controller that takes whole trajectories needs whole streams. Commanders
    /// send at least as much, as far as their streams go.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub horizon_ms: Option<u64>,
}

impl RobotState {
    /// The id of the open task.
    pub fn open_task(&self) -> Option<&str> {
        self.task.as_ref()?.id.as_deref()
    }
}

impl Message for RobotState {
    const SCHEMA: &'static str = "RobotState.v1";

    /// Refuses what no robot can be in. Joints beyond an arm's limits are none of that: a person who guides it by hand brings it there.
    fn validate(&self) -> Result<(), CallError> {
        check_finite("robot_ms", &[self.robot_ms])?;
        check_finite("q_rad", &self.q_rad)?;
        if let Some(i) = self.q_rad.iter().position(|joint_rad| joint_rad.abs() > limits::MAX_JOINT_RAD) {
            check_range(&format!("q_rad[{i}]"), self.q_rad[i], -limits::MAX_JOINT_RAD..=limits::MAX_JOINT_RAD)?;
        }
        check_finite("dq_rad_s", &self.dq_rad_s)?;
        check_range("gripper_width_m", self.gripper_width_m, -limits::MAX_GRIPPER_OVERLAP_M..=limits::MAX_GRIPPER_WIDTH_M)?;
        check_finite("stream_ms", self.stream_ms.as_slice())?;
        self.held.as_ref().map_or(Ok(()), |held| held.validate("held"))?;
        self.world_from_base.as_ref().map_or(Ok(()), |pose| pose.validate("world_from_base"))
    }
}

/// A command: a window of a stream of set-points, or a gripper action, or the clearing of a stop.
///
/// A stream starts with a command whose first set-point has `t_ms` 0 and whose `starts_stream` is set; later commands overlap or
/// extend it. The robot's side starts its stream clock when it takes the first one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotCommand {
    /// Contract version, 1.
    pub v: u32,
    /// Counts this owner's commands; must grow.
    pub seq: u64,
    /// Who commands.
    pub owner: Owner,
    /// How long after receipt the command may still be acted on, milliseconds.
    pub ttl_ms: u64,
    /// Whether the set-points begin a new stream.
    #[serde(default)]
    pub starts_stream: bool,
    /// Whether the stream ends with the last set-point here (then running out of them is no silence).
    #[serde(default)]
    pub ends_stream: bool,
    /// Set-points from now on, at least 200 ms of them unless the stream ends.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub set_points: Vec<SetPoint>,
    /// A gripper action.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper: Option<GripperCommand>,
    /// Clears a latched stop.
    #[serde(default)]
    pub clear_stop: bool,
    /// The stop that is cleared: another one stays latched. Without it whichever is latched is cleared.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clears: Option<StopState>,
    /// The task that the command belongs to, and whether it goes on. None leaves an open task as it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task: Option<Task>,
}

impl RobotCommand {
    /// A command that asks for nothing: its owner is there.
    pub fn new(owner: Owner, seq: u64, ttl_ms: u64) -> Self {
        Self {
            v: limits::VERSION,
            seq,
            owner,
            ttl_ms,
            starts_stream: false,
            ends_stream: false,
            set_points: Vec::new(),
            gripper: None,
            clear_stop: false,
            clears: None,
            task: None,
        }
    }
}

impl Message for RobotCommand {
    const SCHEMA: &'static str = "RobotCommand.v1";

    fn validate(&self) -> Result<(), CallError> {
        if self.v != limits::VERSION {
            return Err(CallError::invalid("v", format!("expected version {}, got {}", limits::VERSION, self.v)));
        }
        keys::validate_chunk("owner.id", &self.owner.id)?;
        if self.owner.epoch > limits::MAX_EPOCH {
            return Err(CallError::invalid("owner.epoch", format!("expected at most {}, got {}", limits::MAX_EPOCH, self.owner.epoch)));
        }
        check_range("ttl_ms", self.ttl_ms as f64, 1.0..=10_000.0)?;
        let mut last_ms = f64::NEG_INFINITY;
        for (i, point) in self.set_points.iter().enumerate() {
            point.validate(&format!("set_points[{i}]"))?;
            if point.t_ms <= last_ms {
                return Err(CallError::invalid(format!("set_points[{i}].t_ms"), "times must increase"));
            }
            last_ms = point.t_ms;
        }
        if let Some(task) = &self.task {
            check_range("task.id", task.id.chars().count() as f64, 1.0..=limits::MAX_TASK_ID as f64)?;
            task.grasps.as_ref().map_or(Ok(()), |held| held.validate("task.grasps"))?;
        }
        self.gripper.map_or(Ok(()), |g| g.validate("gripper"))
    }
}

/// An emergency stop: latches at the robot's side, is repeated until `state` shows it, and is cleared only by motion's `reset`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EmergencyStop {
    /// Contract version, 1.
    pub v: u32,
    /// The stop's id.
    pub id: String,
    /// Who asks for it.
    pub source: String,
    /// Why.
    pub reason: String,
    /// When, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
}

/// Longest text of a stop that is kept, characters: every state repeats it.
const STOP_TEXT: usize = 256;

impl EmergencyStop {
    /// The stop that was put on the key, whatever came: nothing that may be a cry for help is refused for its form. What can be read of it is
    /// kept. The same bytes give the same id, so a repeat is the same stop.
    pub fn read(bytes: &[u8]) -> Self {
        let read = if bytes.len() > limits::MAX_STOP_BYTES {
            Err(format!("{} bytes", bytes.len()))
        } else {
            serde_json::from_slice::<serde_json::Value>(bytes).map_err(|error| error.to_string())
        };
        let said = |field: &str| read.as_ref().ok().and_then(|value| value.get(field));
        let text = |field: &str| {
            let text = said(field).and_then(serde_json::Value::as_str).filter(|text| !text.is_empty())?;
            Some(text.chars().take(STOP_TEXT).collect::<String>())
        };
        // Whoever may stop writes these, and people read them on terminals: nothing in them is for the terminal.
        let words = |field: &str| text(field).map(|text| text.replace(char::is_control, " "));
        let reason = match &read {
            Ok(_) => words("reason").unwrap_or_else(|| "unreadable stop: no reason".to_owned()),
            Err(error) => format!("unreadable stop: {error}"),
        };
        Self {
            v: limits::VERSION,
            id: text("id").unwrap_or_else(|| format!("unnamed-{}", &blake3::hash(bytes).to_hex()[..16])),
            source: words("source").unwrap_or_else(|| "unknown".to_owned()),
            reason,
            stamp_ns: said("stamp_ns").and_then(serde_json::Value::as_u64).unwrap_or(0),
        }
    }
}

impl Message for EmergencyStop {
    const SCHEMA: &'static str = "EmergencyStop.v1";
}
