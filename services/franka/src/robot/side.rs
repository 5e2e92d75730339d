//! What a Franka robot does of what its cell commands, by the rules that the simulated robot is under too.
//!
//! The rules of the contract are those of [`Arm`]: owners and epochs, times to live, limits, stops that latch, commanders that fall silent. This
//! carries them to the robot. Between streams the robot holds itself where it is, and the arm stands there. A stream that is taken begins a motion
//! of the robot; the stream's clock starts with the motion's first millisecond. At every millisecond the arm says the next set-point; once it
//! has stood for [`SETTLE_MS`], the motion ends. Where the robot holds its joints a little off where the arm stands (it takes them as they are
//! when a motion ends), set-points begin there, and what is between the two fades out within the limits. So it does after a gap: the robot that
//! missed set-points has gone on by itself, and those that follow go on from there ([`Fade`]). Whatever ends a motion otherwise latches a stop
//! under the robot's own name for it.
//!
//! A driver that starts does not know what had stopped the robot before: it is stopped until somebody clears that.
//!
//! Clearing a stop is up to the contract's `reset` alone: only a command that would clear it has the robot acknowledge its errors, and it
//! clears once the robot is ready. While the user stop is pressed, nothing is cleared.
//!
//! Pure: readings, commands and time come in, what is to be done goes out.

use franka::RobotMode as FciMode;
use repose_panda::held_off::{BESIDE_SHARE, FADE_MS, HELD_OFF_RAD, with_room_to_fade};
use repose_panda::{JOINT_COUNT, JointLimits, Joints};
use repose_proto::RigidTransform;
use repose_proto::robot::{EmergencyStop, RobotCommand, RobotMode, RobotState};
use repose_robot_side::{Arm, ArmSettings, FOLLOWING_ERROR, Ignored, StateDetails, state_of};

use super::fade::{Fade, FadeBounds, LONGEST_MS};
use super::fci::{Next, Reading, Trouble};
use super::hand::{Hand, HandCommand, HandHalt, HandReading};

/// How long the arm has to stand before its motion is ended, milliseconds: the joints reach their set-points meanwhile, and a stream that follows
/// closely goes on in the same motion.
pub const SETTLE_MS: u64 = 100;
/// The longest gap between readings that is made up for, milliseconds. The robot gives up after 20 lost set-points.
const CATCH_UP_MS: u64 = 100;
/// The share that a fade takes while the arm stands: fast enough to be over before the next gap on a machine that often misses set-points.
const ALONE_SHARE: f64 = 0.05;
/// Between two recoveries, seconds.
const RECOVERY_EVERY_S: f64 = 1.0;

/// What the driver is told once, beside the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct SideSettings {
    /// The arm and its limits.
    pub arm: ArmSettings,
    /// The most that the hand presses with, newtons.
    pub max_grip_force_n: f64,
    /// Whether there is a hand.
    pub has_hand: bool,
    /// Where the robot's base stands in the world, where that is known.
    pub world_from_base: Option<RigidTransform>,
}

/// What the loop is to do with a robot that stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Do {
    /// Read on.
    Read,
    /// Begin a motion.
    Follow,
    /// Have the robot acknowledge its errors.
    Recover,
}

/// Why a command was not taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// By the rules of every arm.
    #[error(transparent)]
    Ignored(#[from] Ignored),
    /// Nothing was heard of the robot yet.
    #[error("the robot has not been reached yet")]
    NoRobot,
    /// A stop cannot be cleared: why.
    #[error("the stop cannot be cleared: {0}")]
    NotReady(String),
    /// The robot is acknowledging its errors; the sender repeats the command.
    #[error("the robot is recovering")]
    Recovering,
}

/// How far a recovery is.
#[derive(Debug, Clone, PartialEq)]
enum Recovery {
    None,
    Wanted,
    Running,
    Ended { at_s: f64, refusal: Option<String> },
}

/// One robot.
#[derive(Debug, Clone)]
pub struct Side {
    settings: SideSettings,
    arm: Option<Arm>,
    hand: Hand,
    had_hand: bool,
    /// What the robot said last; none while it is not connected, and none of a motion that has ended.
    reading: Option<Reading>,
    /// The robot's clock at the last reading, milliseconds.
    clock_ms: Option<u64>,
    /// Robot time since the first reading, milliseconds.
    robot_ms: u64,
    in_motion: bool,
    still_ms: u64,
    /// From where the arm is to where the robot is sent.
    fade: Fade,
    /// Where the arm was at the last millisecond and the two before, radians.
    way_rad: [Joints; 3],
    recovery: Recovery,
    states: u64,
}

impl Side {
    /// A robot of which nothing is known yet.
    pub fn new(settings: SideSettings) -> Self {
        Self {
            settings,
            arm: None,
            hand: Hand::default(),
            had_hand: false,
            reading: None,
            clock_ms: None,
            robot_ms: 0,
            in_motion: false,
            still_ms: 0,
            fade: Fade::default(),
            way_rad: [[0.0; JOINT_COUNT]; 3],
            recovery: Recovery::None,
            states: 0,
        }
    }

    /// The robot is there; whether it may be commanded under these limits: those of the first time, for they are the robot's.
    pub fn connected(&mut self, limits: JointLimits) -> bool {
        let limits = with_room_to_fade(&limits);
        if self.arm.is_none() {
            self.settings.arm.rules.limits = limits;
        }
        (self.clock_ms, self.reading, self.recovery) = (None, None, Recovery::None);
        self.settings.arm.rules.limits == limits
    }

    /// The robot is not there any more.
    pub fn lost(&mut self, why: String) {
        self.in_motion = false;
        self.reading = None;
        if let Some(arm) = &mut self.arm {
            let stands = *arm.q_rad();
            arm.halted("connection_lost", why, &stands);
        }
    }

    /// The process is to end: whatever moves comes to rest.
    pub fn end(&mut self) {
        if let Some(arm) = self.arm.as_mut().filter(|arm| arm.mode() == RobotMode::Moving) {
            arm.fault("driver_ended", "the driver was told to end".to_owned());
        }
    }

    /// Takes an emergency stop; whether there is a robot yet that it stops.
    pub fn emergency_stop(&mut self, stop: &EmergencyStop) -> bool {
        self.arm.as_mut().map(|arm| arm.emergency_stop(stop)).is_some()
    }

    /// Takes a command that came at `received_s`.
    ///
    /// # Errors
    /// [`Refused`] when it was not taken.
    pub fn command(&mut self, command: &RobotCommand, received_s: f64, now_s: f64) -> Result<(), Refused> {
        let arm = self.arm.as_mut().ok_or(Refused::NoRobot)?;
        if !command.clear_stop || arm.stop().is_none() {
            return Ok(arm.late_command(command, received_s, now_s)?);
        }
        let mut cleared = arm.clone();
        cleared.late_command(command, received_s, now_s)?;
        if cleared.stop().is_none() {
            self.make_ready(now_s)?;
        }
        self.arm = Some(cleared);
        Ok(())
    }

    /// Whether the robot would move if it were told to; a recovery is begun where that helps.
    fn make_ready(&mut self, now_s: f64) -> Result<(), Refused> {
        let not_ready = |why: &str| Err(Refused::NotReady(why.to_owned()));
        let Some(reading) = self.reading.filter(|_| !self.in_motion) else {
            return not_ready("the robot is not connected, or still moves");
        };
        match &self.recovery {
            Recovery::Wanted | Recovery::Running => return Err(Refused::Recovering),
            Recovery::Ended { at_s, refusal: Some(refusal) } if now_s < at_s + RECOVERY_EVERY_S => return not_ready(refusal),
            _ => {}
        }
        let recent = matches!(self.recovery, Recovery::Ended { at_s, .. } if now_s < at_s + RECOVERY_EVERY_S);
        match (reading.mode, reading.errors.any()) {
            (FciMode::Idle, false) => Ok(()),
            // It takes some readings until the robot says that it has recovered.
            (FciMode::Idle | FciMode::Reflex, _) if recent => Err(Refused::Recovering),
            (FciMode::Idle | FciMode::Reflex, _) => {
                self.recovery = Recovery::Wanted;
                Err(Refused::Recovering)
            }
            (mode, _) => not_ready(unready(mode).1),
        }
    }

    /// A recovery has ended, with the robot's refusal if it refused.
    pub fn recovered(&mut self, outcome: Result<(), String>, now_s: f64) {
        self.recovery = Recovery::Ended { at_s: now_s, refusal: outcome.err() };
    }

    /// Takes what the hand says of itself.
    pub fn hand(&mut self, reading: HandReading) {
        self.hand.read(reading);
        self.had_hand |= reading.connected;
        if self.hand.take_failure() {
            self.hand_failed("the hand could not carry out a command; the log has its words");
        }
    }

    /// Latches a stop where the hand does not do what it was told.
    pub fn hand_failed(&mut self, why: &str) {
        if let Some(arm) = self.arm.as_mut().filter(|arm| arm.stop().is_none()) {
            arm.fault("gripper_failed", why.to_owned());
        }
    }

    /// A reading of a robot that this process does not move; what to do then.
    pub fn standing(&mut self, reading: &Reading, now_s: f64) -> Do {
        let since_ms = self.advance(reading);
        let settings = self.settings.arm;
        let arm = self.arm.get_or_insert_with(|| Arm::found_at(reading.held_rad, settings, now_s, stopped_by(reading)));
        arm.set_grips(self.hand.state().holding, now_s);
        if arm.stop().is_none() {
            if let Some((kind, reason)) = stopped_by(reading) {
                arm.halted(&kind, reason, &reading.held_rad);
            } else if self.had_hand && !self.hand.is_connected() {
                arm.fault("hand_lost", "the hand is not connected any more".to_owned());
            }
        }
        if arm.mode() == RobotMode::Moving {
            (self.in_motion, self.clock_ms, self.still_ms) = (true, None, 0);
            return Do::Follow;
        }
        (0..since_ms).for_each(|_| arm.tick(now_s));
        if apart(&reading.held_rad, arm.q_rad()) > HELD_OFF_RAD {
            arm.settle(&reading.held_rad);
        }
        if self.recovery == Recovery::Wanted {
            self.recovery = Recovery::Running;
            return Do::Recover;
        }
        Do::Read
    }

    /// A reading of a robot that follows set-points; the next one.
    pub fn following(&mut self, reading: &Reading, now_s: f64) -> Next {
        let begins = self.clock_ms.is_none();
        let since_ms = self.advance(reading);
        let Some(arm) = &mut self.arm else { return Next::End(reading.held_rad) };
        if begins {
            let mut offset_rad = std::array::from_fn(|i| reading.held_rad[i] - arm.q_rad()[i]);
            if apart(&reading.held_rad, arm.q_rad()) > HELD_OFF_RAD {
                arm.halted("start_pose_mismatch", "the robot was moved as its motion began".to_owned(), &reading.held_rad);
                offset_rad = [0.0; JOINT_COUNT];
            }
            (self.fade, self.way_rad) = (Fade::at_rest(&offset_rad, FADE_MS), [*arm.q_rad(); 3]);
        }
        arm.set_grips(self.hand.state().holding, now_s);
        // Not `Arm::measured`: it takes an arm at rest to stand where it was measured, and set-points that jump there would follow.
        if arm.stop().is_none()
            && let Some(reason) = off_set_points(&reading.measured_rad, arm.q_rad(), self.settings.arm.following_tolerance_rad)
        {
            arm.fault(FOLLOWING_ERROR, reason);
        }
        for left_ms in (0..since_ms).rev() {
            // The robot is where the arm would be one millisecond before the set-point that is asked for.
            if left_ms == 0 && since_ms > 1 {
                let share = if arm.is_at_rest() { ALONE_SHARE } else { BESIDE_SHARE };
                let bounds = FadeBounds { limits: &self.settings.arm.rules.limits, share, gap_ms: since_ms as f64 };
                self.fade = Fade::going_on(&offsets(reading, &self.way_rad), &bounds);
            }
            arm.tick(now_s);
            self.way_rad = [*arm.q_rad(), self.way_rad[0], self.way_rad[1]];
        }
        self.still_ms = if arm.is_at_rest() { self.still_ms + since_ms } else { 0 };
        let offset_rad = if since_ms > 0 { self.fade.step() } else { self.fade.now() };
        let q_rad = std::array::from_fn(|i| arm.q_rad()[i] + offset_rad[i]);
        // A fade that no gap cuts short comes to its end: only where it should long have is next to nothing enough.
        let has_faded = self.fade.is_over() || (self.still_ms >= SETTLE_MS + LONGEST_MS && self.fade.is_nothing());
        if self.still_ms >= SETTLE_MS && has_faded { Next::End(q_rad) } else { Next::Go(q_rad) }
    }

    /// The motion is over.
    pub fn ended(&mut self, outcome: Result<(), Trouble>) {
        self.in_motion = false;
        let last = self.reading.take();
        match outcome {
            Ok(()) => {}
            Err(Trouble::Lost(why)) => self.lost(why),
            Err(Trouble::Stopped { kind, reason }) => {
                if let Some(arm) = &mut self.arm {
                    let stands = last.map_or(*arm.q_rad(), |reading| reading.held_rad);
                    arm.halted(&kind, reason, &stands);
                }
            }
        }
    }

    /// What the hand is to leave off, once for every stop that latches.
    pub fn take_hand_halt(&mut self) -> Option<HandHalt> {
        self.arm.as_mut()?.take_hand_halt().then(|| self.hand.halt())
    }

    /// The command that the hand is to be given now, with its number.
    pub fn take_hand_command(&mut self) -> Option<(u64, HandCommand)> {
        let arm = self.arm.as_mut()?;
        let action = arm.take_gripper()?;
        if !self.settings.has_hand {
            arm.fault("no_hand", "the configuration says that there is no hand".to_owned());
            return None;
        }
        if !self.hand.is_connected() {
            arm.fault("hand_lost", "the hand is not connected".to_owned());
            return None;
        }
        let is_to_grasp = arm.is_to_grasp();
        Some(self.hand.command(&action, is_to_grasp, self.settings.max_grip_force_n))
    }

    /// What the arm does.
    pub fn mode(&self) -> Option<RobotMode> {
        let mode = self.arm.as_ref()?.mode();
        // The motion goes on for a moment after the stream.
        Some(if mode == RobotMode::Idle && self.in_motion { RobotMode::Moving } else { mode })
    }

    /// Why it is stopped: kind and reason.
    pub fn stop(&self) -> Option<(&str, &str)> {
        let stop = self.arm.as_ref()?.stop()?;
        Some((&stop.kind, &stop.reason))
    }

    /// What it shows of itself; nothing before the robot was reached.
    pub fn state(&mut self, stamp_ns: u64) -> Option<RobotState> {
        let (mode, arm) = (self.mode()?, self.arm.as_ref()?);
        self.states += 1;
        let shown = StateDetails {
            seq: self.states,
            stamp_ns,
            robot_ms: self.robot_ms as f64,
            gripper: self.hand.state(),
            world_from_base: self.settings.world_from_base,
        };
        Some(RobotState { mode, ..state_of(arm, &shown) })
    }

    /// Keeps a reading; how many milliseconds of the robot's clock have passed since the last.
    fn advance(&mut self, reading: &Reading) -> u64 {
        let before_ms = self.clock_ms.replace(reading.time_ms).unwrap_or(reading.time_ms);
        let since_ms = reading.time_ms.saturating_sub(before_ms).min(CATCH_UP_MS);
        self.reading = Some(*reading);
        self.robot_ms += since_ms;
        since_ms
    }
}

/// What is to be said of the first joint that was measured too far from its set-point; what is no number is.
fn off_set_points(measured_rad: &Joints, set_rad: &Joints, tolerance_rad: f64) -> Option<String> {
    let joint = (0..JOINT_COUNT).find(|&i| !(0.0..=tolerance_rad).contains(&(measured_rad[i] - set_rad[i]).abs()))?;
    Some(format!("joint {joint} was measured at {:.4} rad and set to {:.4} rad", measured_rad[joint], set_rad[joint]))
}

/// How far off the arm's way the robot is, and was a millisecond ago and two: by where it holds its joints, and how fast.
fn offsets(reading: &Reading, way_rad: &[Joints; 3]) -> [Joints; 3] {
    const DT_S: f64 = 1e-3;
    let before = |joint: usize, milliseconds: usize| {
        let (speed, acceleration) = (reading.held_rad_s[joint], reading.held_rad_s2[joint]);
        // As differences: the speed is that of the last millisecond.
        reading.held_rad[joint] - [0.0, speed, 2.0 * speed - acceleration * DT_S][milliseconds] * DT_S
    };
    std::array::from_fn(|milliseconds| std::array::from_fn(|joint| before(joint, milliseconds) - way_rad[milliseconds][joint]))
}

/// The furthest that a joint is from where it is in another configuration, radians.
fn apart(a: &Joints, b: &Joints) -> f64 {
    (0..JOINT_COUNT).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max)
}

/// Why a robot that this process does not move would not move if it were told to: kind and reason.
fn stopped_by(reading: &Reading) -> Option<(String, String)> {
    if reading.mode == FciMode::Reflex || reading.errors.any() {
        return Some(named(reading));
    }
    let (kind, reason) = unready(reading.mode);
    (reading.mode != FciMode::Idle).then(|| (kind.to_owned(), reason.to_owned()))
}

/// The stop of a robot that has stopped by itself: its own name for the first of its errors, and all of them.
fn named(reading: &Reading) -> (String, String) {
    let names = reading.errors.names();
    match names.first() {
        Some(first) => ((*first).to_owned(), format!("the robot reports {}", names.join(", "))),
        None => ("reflex".to_owned(), "the robot is in reflex mode and names no error".to_owned()),
    }
}

/// The stop of a robot that does not stand ready.
fn unready(mode: FciMode) -> (&'static str, &'static str) {
    match mode {
        FciMode::UserStopped => ("user_stop", "the user stop is pressed"),
        FciMode::Guiding => ("guiding", "somebody guides the arm by hand"),
        FciMode::Move => ("other_motion", "another program moves the robot"),
        _ => ("not_ready", "the robot is not ready: its brakes have to be open and FCI activated"),
    }
}
