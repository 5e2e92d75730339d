//! The robot's side of the command keys: who may command, which set-points are followed, and when the arm stops by itself.
//!
//! One owner at a time, by growing epochs; set-points are interpolated (cubic Hermite) at 1 kHz of robot time and each is checked against
//! Franka's rules. A broken rule, a commander that falls silent (set-points run out, or the last command outlives its time to live) and an
//! emergency stop bring the arm to rest within the limits of velocity, acceleration and jerk, and latch: only a command that clears the stop
//! is accepted then. The rules refuse what could not be stopped any more, so whatever is sent, no limit is exceeded at any time.
//!
//! Within a task the commander must be heard at rest too, nobody else may command, and a task that is closed with an object in the hand, or
//! while the arm moves, latches: so nobody leaves the arm with something in its hand unnoticed.
//!
//! A real arm is not where its set-points are. It is told where the joints were measured ([`Arm::measured`]): further off than the tolerance, it
//! latches while it follows set-points, and is taken to stand where it was measured while it does not (somebody has moved it by hand).

mod ignored;
mod settings;
#[cfg(test)]
mod tests;

pub use ignored::Ignored;
pub use settings::ArmSettings;

use std::collections::VecDeque;

use repose_panda::{CommandRuleSettings, CommandRules, CommanderWatch, Joints, Model, MotionState, READY, Stop, StopSettings, Violation};
use repose_proto::robot::{EmergencyStop, GripperCommand, HeldObject, Owner, RobotCommand, RobotMode, StopState, Task};

use crate::stream::Stream;

/// The stop of an arm that does not follow its set-points.
pub const FOLLOWING_ERROR: &str = "following_error";

/// Emergency stops that the reason of a stop tells of, each of which may be of some hundred characters: every state repeats them.
const ESTOPS: usize = 3;

/// The stop of an arm whose driver has started.
pub const DRIVER_STARTED: &str = "driver_started";

/// The arm and its controller.
#[derive(Debug, Clone)]
pub struct Arm {
    settings: ArmSettings,
    motion: MotionState,
    owner: Option<Owner>,
    last_command: Option<u64>,
    watch: CommanderWatch,
    stream: Option<Stream>,
    stream_ms: Option<f64>,
    stop: Option<StopState>,
    /// The emergency stops of the latched stop, with what they say, the newest first.
    estops: VecDeque<(String, String)>,
    /// What had stopped it before them, by kind and reason.
    stopped_before: Option<String>,
    braking: Option<Stop>,
    /// Whether the hand was told to halt for the latched stop.
    hand_halted: bool,
    gripper: Option<GripperCommand>,
    /// What the last gripper action was to grasp.
    grasps: Option<HeldObject>,
    /// What is between the fingers where they stand against something: what was last to be grasped, until they have let go of it.
    in_hand: Option<HeldObject>,
    /// Whether the fingers stand against something.
    grips: bool,
    /// The newest instant that was handed in, seconds of the receiver's monotonic clock.
    now_s: f64,
    /// When the hand was last told to close on an object, or to open while it held one, or was last seen to take hold of something or to lose it, or
    /// may last have been before its driver started, or the world was last made anew, on the same clock.
    handled_s: Option<f64>,
}

impl Default for Arm {
    fn default() -> Self {
        Self::new(ArmSettings::default())
    }
}

impl Arm {
    /// An arm at rest in the ready pose, without an owner.
    pub fn new(settings: ArmSettings) -> Self {
        Self::standing_at(READY, settings)
    }

    /// The same where the arm stands now, radians.
    pub fn standing_at(stands_rad: Joints, settings: ArmSettings) -> Self {
        Self {
            settings,
            motion: MotionState::at_rest(stands_rad),
            owner: None,
            last_command: None,
            watch: CommanderWatch::default(),
            stream: None,
            stream_ms: None,
            stop: None,
            estops: VecDeque::new(),
            stopped_before: None,
            braking: None,
            hand_halted: false,
            gripper: None,
            grasps: None,
            in_hand: None,
            grips: false,
            now_s: 0.0,
            handled_s: None,
        }
    }

    /// The same of an arm that a driver has found there at `now_s`. What stopped it before, and what its hand has moved, nobody knows any more:
    /// it is stopped, for a reason of its own (kind and reason) or because its driver has started, and what was seen before is old.
    pub fn found_at(stands_rad: Joints, settings: ArmSettings, now_s: f64, stopped_by: Option<(String, String)>) -> Self {
        let started =
            || (DRIVER_STARTED.to_owned(), "the driver has started, and does not know what had stopped the robot before".to_owned());
        let (kind, reason) = stopped_by.unwrap_or_else(started);
        let mut arm = Self { now_s, handled_s: Some(now_s), ..Self::standing_at(stands_rad, settings) };
        arm.halted(&kind, reason, &stands_rad);
        arm
    }

    /// Back to the ready pose at rest, as if carried there, among other things than before: what was seen of those is old. Owner and latched stop
    /// stay.
    pub fn rehome(&mut self) {
        self.handled_s = Some(self.now_s);
        self.motion = MotionState::at_rest(READY);
        self.stream = None;
        self.braking = None;
        self.stream_ms = None;
        self.gripper = None;
        self.grasps = None;
        self.in_hand = None;
        self.grips = false;
    }

    /// What it is.
    pub fn model(&self) -> Model {
        self.settings.model
    }

    /// Joint positions, radians.
    pub fn q_rad(&self) -> &Joints {
        &self.motion.position_rad
    }

    /// Joint velocities, radians per second.
    pub fn dq_rad_s(&self) -> &Joints {
        &self.motion.velocity_rad_s
    }

    /// Who commands.
    pub fn owner(&self) -> Option<&Owner> {
        self.owner.as_ref()
    }

    /// The last command taken.
    pub fn last_command(&self) -> Option<u64> {
        self.last_command
    }

    /// How far the stream has been followed, milliseconds.
    pub fn stream_ms(&self) -> Option<f64> {
        self.stream_ms
    }

    /// Why it is stopped.
    pub fn stop(&self) -> Option<&StopState> {
        self.stop.as_ref()
    }

    /// The open task.
    pub fn task(&self) -> Option<&str> {
        self.watch.task()
    }

    /// What the hand holds, as far as it was told.
    pub fn held(&self) -> Option<&HeldObject> {
        self.in_hand.as_ref().filter(|_| self.grips)
    }

    /// How long ago the hand last took hold of an object or let go of one, or may have, milliseconds; none where it has not yet.
    pub fn since_handling_ms(&self) -> Option<u64> {
        self.handled_s.map(|handled_s| ((self.now_s - handled_s).max(0.0) * 1e3) as u64)
    }

    /// Whether the last gripper action was to grasp something, as far as it was told.
    pub fn is_to_grasp(&self) -> bool {
        self.grasps.is_some()
    }

    /// Says where the joints were measured, radians.
    pub fn measured(&mut self, measured_rad: &Joints) {
        let set_rad = self.motion.position_rad;
        let near = 0.0..=self.settings.following_tolerance_rad;
        // What is no number is not near.
        let off = |i: &usize| !near.contains(&(measured_rad[*i] - set_rad[*i]).abs());
        let Some(joint) = (0..measured_rad.len()).find(off) else { return };
        if self.stream.is_some() || (self.stop.is_none() && self.task().is_some()) {
            let reason = format!("joint {joint} was measured at {:.4} rad and set to {:.4} rad", measured_rad[joint], set_rad[joint]);
            self.reflex(FOLLOWING_ERROR, reason);
        } else if self.motion.is_at_rest() && measured_rad.iter().all(|q| q.is_finite()) {
            self.motion = MotionState::at_rest(*measured_rad);
        }
    }

    /// Says where the arm stands that something else has brought to rest: a controller whose trajectory was canceled. Of no effect while it
    /// follows set-points or brakes.
    pub fn settle(&mut self, stands_rad: &Joints) {
        if self.is_at_rest() && stands_rad.iter().all(|q| q.is_finite()) {
            self.motion = MotionState::at_rest(*stands_rad);
        }
    }

    /// Latches a stop of an arm that has stopped by itself and stands at `stands_rad`: nothing is left to brake. The first reason is kept.
    pub fn halted(&mut self, kind: &str, reason: String, stands_rad: &Joints) {
        if self.stop.is_none() {
            self.reflex(kind, reason);
        }
        self.braking = None;
        let stands = if stands_rad.iter().all(|q| q.is_finite()) { *stands_rad } else { self.motion.position_rad };
        self.motion = MotionState::at_rest(stands);
    }

    /// Latches a stop for a fault that the arm cannot see by itself: of what moves it, or of what tells of it.
    pub fn fault(&mut self, kind: &str, reason: String) {
        self.reflex(kind, reason);
    }

    /// Says whether the fingers stand against something at `now_s` of the receiver's monotonic clock. Where that changes the hand has taken hold of
    /// something or lost it, whatever it was told: nobody told it to lose what slips out of it, and a commander need not say that it is to grasp. After a
    /// time without a word of the hand or the arm nobody knows when that was: it counts as now.
    pub fn set_grips(&mut self, grips: bool, now_s: f64) {
        if grips != self.grips {
            self.handled_s = Some(now_s);
        }
        self.grips = grips;
    }

    /// The gripper action to carry out, once.
    pub fn take_gripper(&mut self) -> Option<GripperCommand> {
        self.gripper.take()
    }

    /// Whether the hand is to leave off what it does now: once for every stop that latches, and for that of an arm whose driver has started.
    pub fn take_hand_halt(&mut self) -> bool {
        let was_halted = std::mem::replace(&mut self.hand_halted, self.stop.is_some());
        self.stop.is_some() && !was_halted
    }

    /// What the arm is doing.
    pub fn mode(&self) -> RobotMode {
        match (&self.stop, &self.stream) {
            (Some(_), _) => RobotMode::Stopped,
            (None, Some(_)) => RobotMode::Moving,
            (None, None) => RobotMode::Idle,
        }
    }

    /// Takes an emergency stop: latches at once. A stop that is latched already takes the newest one's id: its sender sees it taken, and whoever
    /// clears the stop as it was before does not clear this one. The reason goes on to say those before it, whatever they were, so that nobody takes a
    /// hand that has failed for a button that was pressed, and so that the stop is another even when a repeat of an earlier one comes last.
    pub fn emergency_stop(&mut self, estop: &EmergencyStop) {
        if self.stop.as_ref().is_some_and(|latched| latched.estop_id.as_ref() == Some(&estop.id)) {
            return;
        }
        self.estops.retain(|(id, _)| *id != estop.id);
        self.estops.push_front((estop.id.clone(), format!("{}: {}", estop.source, estop.reason)));
        self.estops.truncate(ESTOPS);
        if let Some(StopState { kind, reason, estop_id: None }) = &self.stop {
            self.stopped_before = Some(format!("{kind}: {reason}"));
        }
        let said: Vec<&str> = self.estops.iter().map(|(_, said)| said.as_str()).chain(self.stopped_before.as_deref()).collect();
        let stop = StopState { kind: "estop".to_owned(), reason: said.join("; before that "), estop_id: Some(estop.id.clone()) };
        match &mut self.stop {
            Some(latched) => *latched = stop,
            None => self.latch(stop),
        }
    }

    /// Takes a command, received at `now_s` of the receiver's monotonic clock. Its content must have been validated.
    ///
    /// # Errors
    /// [`Ignored`] when it was not taken; nothing has changed then, but that the last command's repeat begins its time to live anew: its sender
    /// is not silent.
    pub fn command(&mut self, command: &RobotCommand, now_s: f64) -> Result<(), Ignored> {
        self.late_command(command, now_s, now_s)
    }

    /// The same for a command that has waited: received at `received_s`, it comes to be looked at now.
    ///
    /// # Errors
    /// As [`Self::command`]; [`Ignored::Expired`] when it has waited too long.
    pub fn late_command(&mut self, command: &RobotCommand, received_s: f64, now_s: f64) -> Result<(), Ignored> {
        let expires_s = received_s + command.ttl_ms as f64 * 1e-3;
        if now_s > expires_s {
            return Err(Ignored::Expired);
        }
        let task = self.watch.task().filter(|_| !command.clear_stop || self.stop.is_none());
        if let Some(owner) = &self.owner {
            let (same, newer) = (command.owner == *owner, command.owner.epoch > owner.epoch);
            if !same && !newer {
                return Err(Ignored::NotOwner);
            }
            if same && self.last_command.is_some_and(|last| command.seq <= last) {
                if self.last_command == Some(command.seq) {
                    self.watch.repeat(expires_s);
                }
                return Err(Ignored::Passed);
            }
            if !same && self.stop.is_none() && task.is_some() {
                return Err(Ignored::OtherTask);
            }
        }
        if self.stop.is_some() && !command.clear_stop {
            return Err(Ignored::Stopped);
        }
        if command.clear_stop && command.clears.is_some() && self.stop.is_some() && command.clears != self.stop {
            return Err(Ignored::OtherStop);
        }
        if task.is_some_and(|open| command.task.as_ref().is_some_and(|task| task.id != open)) {
            return Err(Ignored::OtherTask);
        }
        let kept = self.stream.as_ref().zip(command.set_points.first()).map_or(0, |(stream, first)| stream.kept(first));
        if kept + command.set_points.len() > self.settings.max_set_points {
            return Err(Ignored::TooMany);
        }
        if command.starts_stream && !self.is_at_rest() {
            return Err(Ignored::Moving);
        }
        self.owner = Some(command.owner.clone());
        self.last_command = Some(command.seq);
        self.watch.take(expires_s);
        if command.clear_stop && self.motion.is_at_rest() {
            self.stop = None;
            self.estops.clear();
            self.stopped_before = None;
            self.watch.close();
        }
        if self.stop.is_some() {
            return Ok(());
        }
        if let Some(task) = command.task.as_ref().filter(|task| task.open) {
            self.watch.open(&task.id);
        }
        if command.gripper.is_some() {
            self.gripper = command.gripper;
            self.grasps = command.task.as_ref().and_then(|task| task.grasps.clone());
            // A hand that holds something and is told to let go may never do so: a stop drops the action, or the hand leaves it off.
            if self.grasps.is_some() || !self.grips {
                self.in_hand.clone_from(&self.grasps);
            }
            if self.grips || self.grasps.is_some() {
                self.handled_s = Some(now_s);
            }
        }
        if command.starts_stream {
            self.start_stream(command);
        } else if let Some(stream) = &mut self.stream {
            stream.extend(&command.set_points);
            stream.ends |= command.ends_stream;
        }
        if let Some(task) = command.task.as_ref().filter(|task| !task.open && self.stop.is_none()) {
            self.close_task(task);
        }
        Ok(())
    }

    /// Closes a task that has left nothing half done; latches a stop where it has.
    fn close_task(&mut self, task: &Task) {
        let left = match (self.grips, self.is_at_rest()) {
            (true, _) => "an object in the hand",
            (false, false) => "the arm on its way",
            (false, true) => return self.watch.close(),
        };
        self.reflex("task_unfinished", format!("task {} was closed with {left}", task.id));
    }

    /// One millisecond of robot time; `now_s` is the receiver's monotonic clock.
    pub fn tick(&mut self, now_s: f64) {
        self.now_s = now_s;
        if let Some(task) = self.watch.lost_task(now_s).filter(|_| self.stop.is_none()) {
            self.reflex("commander_silent", format!("task {task} is open and its commander has fallen silent"));
        }
        self.follow(now_s);
        // A stop that latched in this very millisecond moves in it too: to stand for one would be a jump.
        if let Some(braking) = &mut self.braking {
            self.motion = braking.step();
            if self.motion.is_at_rest() {
                self.braking = None;
            }
        }
    }

    /// The stream's next place, or a reflex.
    fn follow(&mut self, now_s: f64) {
        let Some(stream) = &mut self.stream else { return };
        if self.watch.is_silent(now_s) && !stream.ends {
            self.reflex("commander_silent", "the last command outlived its time to live".to_owned());
            return;
        }
        stream.advance();
        let Some(end_ms) = stream.end_ms() else {
            self.reflex("commander_silent", "the stream has no set-points".to_owned());
            return;
        };
        let is_over = stream.clock_ms > end_ms + 1e-6;
        if is_over && !stream.ends {
            self.reflex("commander_silent", format!("set-points ran out at {end_ms:.0} ms"));
            return;
        }
        let target = stream.at(stream.clock_ms.min(end_ms));
        match stream.rules.accept(&target) {
            Ok(()) => {
                self.motion = *stream.rules.state();
                self.stream_ms = Some(stream.clock_ms.min(end_ms));
                // The last position is held until the arm stands there.
                if is_over && self.motion.is_at_rest() {
                    self.stream = None;
                }
            }
            Err(violation) => self.reflex(kind_of(&violation), violation.to_string()),
        }
    }

    fn start_stream(&mut self, command: &RobotCommand) {
        let Some(first) = command.set_points.first() else {
            self.reflex("invalid_command", "a stream starts without set-points".to_owned());
            return;
        };
        let stands_rad = self.motion.position_rad;
        if let Err(violation) = CommandRules::new(&stands_rad, self.settings.rules).accept(&first.q_rad) {
            self.reflex(kind_of(&violation), violation.to_string());
            return;
        }
        self.stream_ms = Some(first.t_ms);
        self.stream = Some(Stream::new(first, command, &stands_rad, self.settings.rules));
    }

    fn reflex(&mut self, kind: &str, reason: String) {
        self.latch(StopState { kind: kind.to_owned(), reason, estop_id: None });
    }

    fn latch(&mut self, stop: StopState) {
        self.stop = Some(stop);
        self.gripper = None;
        let CommandRuleSettings { limits, period_s, .. } = self.settings.rules;
        // An arm that comes back from beyond them has those of its stream.
        let limits = self.stream.take().map_or(limits, |stream| *stream.rules.limits());
        let settings = StopSettings { limits, period_s, gentle_share: self.settings.gentle_share };
        self.braking = (!self.motion.is_at_rest()).then(|| Stop::new(&self.motion, &settings));
    }

    /// Whether it stands, and nothing is left to follow or to brake.
    pub fn is_at_rest(&self) -> bool {
        self.stream.is_none() && self.motion.is_at_rest()
    }
}

/// The contract's name of a broken rule.
fn kind_of(violation: &Violation) -> &'static str {
    match violation {
        Violation::NotFinite { .. } => "invalid_command",
        Violation::StartPoseInvalid { .. } => "start_pose_mismatch",
        Violation::PositionLimits { .. } | Violation::NoRoomToStop { .. } => "joint_position_limit",
        Violation::VelocityLimits { .. } | Violation::NoRoomToSlow { .. } => "joint_velocity_limit",
        Violation::VelocityDiscontinuity { .. } | Violation::AccelerationDiscontinuity { .. } => "joint_acceleration_limit",
    }
}
