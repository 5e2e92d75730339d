//! The robot's side of the command keys: who may command, which set-points are followed, and when the arm stops by itself.
//!
//! One owner at a time, by growing epochs; set-points are interpolated (cubic Hermite) at 1 kHz of robot time and each is held against
//! Franka's rules. A broken rule, a commander that falls silent (set-points run out, or the last command outlives its time to live) and an
//! emergency stop bring the arm to rest within the limits of velocity, acceleration and jerk, and latch: only a command that clears the stop
//! is accepted then. The rules refuse what could not be stopped any more, so whatever is sent, no limit is exceeded at any time.

use repose_panda::{CommandRuleSettings, CommandRules, Joints, MotionState, READY, Stop, StopSettings, Violation};
use repose_proto::robot::{EmergencyStop, GripperCommand, Owner, RobotCommand, RobotMode, StopState};

use crate::robot::stream::Stream;

/// How the arm is driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmSettings {
    /// What set-points are held against.
    pub rules: CommandRuleSettings,
    /// The share of the acceleration and jerk limits that a stop uses where there is room for it.
    pub gentle_share: f64,
    /// Set-points that are kept at most; a command that brings more, with those still to follow, is refused.
    pub max_set_points: usize,
}

impl Default for ArmSettings {
    fn default() -> Self {
        Self { rules: CommandRuleSettings::default(), gentle_share: StopSettings::default().gentle_share, max_set_points: 100_000 }
    }
}

/// Why a command was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Ignored {
    /// Its epoch is lower than the owner's, or another owner has the same.
    #[error("not the owner")]
    NotOwner,
    /// This command of this owner or a later one was taken already.
    #[error("sequence number passed")]
    Passed,
    /// Its time to live was over before it could be taken.
    #[error("expired")]
    Expired,
    /// A stop is latched.
    #[error("stopped")]
    Stopped,
    /// It clears a stop, and another one is latched.
    #[error("another stop is latched")]
    OtherStop,
    /// A new stream, while the arm still follows one or brakes.
    #[error("still moving")]
    Moving,
    /// More set-points than are kept.
    #[error("too many set-points")]
    TooMany,
}

/// The arm and its controller.
#[derive(Debug, Clone)]
pub struct Arm {
    settings: ArmSettings,
    motion: MotionState,
    owner: Option<Owner>,
    last_command: Option<u64>,
    expires_s: f64,
    stream: Option<Stream>,
    stream_ms: Option<f64>,
    stop: Option<StopState>,
    braking: Option<Stop>,
    gripper: Option<GripperCommand>,
}

impl Default for Arm {
    fn default() -> Self {
        Self::new(ArmSettings::default())
    }
}

impl Arm {
    /// An arm at rest in the ready pose, without an owner.
    pub fn new(settings: ArmSettings) -> Self {
        Self {
            settings,
            motion: MotionState::at_rest(READY),
            owner: None,
            last_command: None,
            expires_s: 0.0,
            stream: None,
            stream_ms: None,
            stop: None,
            braking: None,
            gripper: None,
        }
    }

    /// Back to the ready pose at rest, as if carried there; owner and latched stop stay.
    pub fn rehome(&mut self) {
        self.motion = MotionState::at_rest(READY);
        self.stream = None;
        self.braking = None;
        self.stream_ms = None;
        self.gripper = None;
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

    /// The gripper action to carry out, once.
    pub fn take_gripper(&mut self) -> Option<GripperCommand> {
        self.gripper.take()
    }

    /// What the arm is doing.
    pub fn mode(&self) -> RobotMode {
        match (&self.stop, &self.stream) {
            (Some(_), _) => RobotMode::Stopped,
            (None, Some(_)) => RobotMode::Moving,
            (None, None) => RobotMode::Idle,
        }
    }

    /// Takes an emergency stop: latches at once, and keeps the first reason.
    pub fn emergency_stop(&mut self, estop: &EmergencyStop) {
        let stop =
            StopState { kind: "estop".to_owned(), reason: format!("{}: {}", estop.source, estop.reason), estop_id: Some(estop.id.clone()) };
        match &mut self.stop {
            // A stop that latched for another reason becomes an emergency stop too, so that its sender sees it taken.
            Some(latched) if latched.estop_id.is_none() => *latched = stop,
            Some(_) => {}
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
        if let Some(owner) = &self.owner {
            let (same, newer) = (command.owner == *owner, command.owner.epoch > owner.epoch);
            if !same && !newer {
                return Err(Ignored::NotOwner);
            }
            if same && self.last_command.is_some_and(|last| command.seq <= last) {
                if self.last_command == Some(command.seq) {
                    self.expires_s = self.expires_s.max(expires_s);
                }
                return Err(Ignored::Passed);
            }
        }
        if self.stop.is_some() && !command.clear_stop {
            return Err(Ignored::Stopped);
        }
        if command.clear_stop && command.clears.is_some() && self.stop.is_some() && command.clears != self.stop {
            return Err(Ignored::OtherStop);
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
        self.expires_s = expires_s;
        if command.clear_stop && self.motion.is_at_rest() {
            self.stop = None;
        }
        if self.stop.is_some() {
            return Ok(());
        }
        if command.gripper.is_some() {
            self.gripper = command.gripper;
        }
        if command.starts_stream {
            self.start_stream(command);
        } else if let Some(stream) = &mut self.stream {
            stream.extend(&command.set_points);
            stream.ends |= command.ends_stream;
        }
        Ok(())
    }

    /// One millisecond of robot time; `now_s` is the receiver's monotonic clock.
    pub fn tick(&mut self, now_s: f64) {
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
        if now_s > self.expires_s && !stream.ends {
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
        self.stream = None;
        self.gripper = None;
        let CommandRuleSettings { limits, period_s, .. } = self.settings.rules;
        let settings = StopSettings { limits, period_s, gentle_share: self.settings.gentle_share };
        self.braking = (!self.motion.is_at_rest()).then(|| Stop::new(&self.motion, &settings));
    }

    fn is_at_rest(&self) -> bool {
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

#[cfg(test)]
mod tests {
    use repose_proto::robot::SetPoint;

    use super::*;

    /// Joint 0 from rest over `delta_rad` and back to rest in `span_ms`, smoothly, sampled every 10 ms.
    fn swing(delta_rad: f64, span_ms: f64) -> Vec<SetPoint> {
        let steps = (span_ms / 10.0) as usize;
        let at = |k: usize| {
            let s = k as f64 / steps as f64;
            let (place, speed) = (s * s * s * (10.0 - 15.0 * s + 6.0 * s * s), 30.0 * s * s * (1.0 - s) * (1.0 - s));
            let mut point = SetPoint { t_ms: k as f64 * 10.0, q_rad: READY, dq_rad_s: [0.0; 7] };
            point.q_rad[0] += delta_rad * place;
            point.dq_rad_s[0] = delta_rad * speed / (span_ms * 1e-3);
            point
        };
        (0..=steps).map(at).collect()
    }

    fn command(seq: u64, epoch: u64, set_points: Vec<SetPoint>) -> RobotCommand {
        RobotCommand {
            v: 1,
            seq,
            owner: Owner { id: "motion-1".to_owned(), epoch },
            ttl_ms: 1000,
            starts_stream: true,
            ends_stream: true,
            set_points,
            gripper: None,
            clear_stop: false,
            clears: None,
        }
    }

    fn run(arm: &mut Arm, ticks: usize, now_s: f64) {
        for _ in 0..ticks {
            arm.tick(now_s);
        }
    }

    #[test]
    fn a_stream_within_the_limits_is_followed_to_its_end() {
        let mut arm = Arm::default();
        arm.command(&command(1, 1, swing(0.5, 1000.0)), 0.0).expect("taken");
        assert_eq!(arm.mode(), RobotMode::Moving);
        run(&mut arm, 1100, 0.0);
        assert_eq!((arm.mode(), arm.stop()), (RobotMode::Idle, None));
        assert!((arm.q_rad()[0] - 0.5).abs() < 1e-6 && arm.stream_ms() == Some(1000.0));
    }

    #[test]
    fn each_broken_rule_stops_with_its_name() {
        let mut elsewhere = swing(0.5, 1000.0);
        elsewhere.iter_mut().for_each(|p| p.q_rad[3] += 0.1);
        for (name, points, kind) in [
            ("too fast", swing(2.5, 1000.0), "joint_velocity_limit"),
            ("too sudden", swing(0.3, 120.0), "joint_acceleration_limit"),
            ("out of range", swing(2.95, 4000.0), "joint_position_limit"),
            ("not where it stands", elsewhere, "start_pose_mismatch"),
            ("nothing", Vec::new(), "invalid_command"),
        ] {
            let mut arm = Arm::default();
            arm.command(&command(1, 1, points), 0.0).expect("taken");
            run(&mut arm, 5000, 0.0);
            assert_eq!(arm.stop().map(|s| s.kind.as_str()), Some(kind), "{name}");
            assert!(arm.motion.is_at_rest(), "{name}");
        }
    }

    #[test]
    fn a_silent_commander_stops_the_arm() {
        for expires in [false, true] {
            let mut arm = Arm::default();
            let mut first = command(1, 1, swing(0.8, 1000.0));
            first.ends_stream = false;
            if !expires {
                first.set_points.truncate(50);
            }
            arm.command(&first, 0.0).expect("taken");
            run(&mut arm, 400, 0.0);
            assert!(!arm.motion.is_at_rest());
            run(&mut arm, 600, if expires { 2.0 } else { 0.0 });
            assert_eq!(arm.stop().map(|s| s.kind.as_str()), Some("commander_silent"));
            assert!(arm.motion.is_at_rest());
        }
    }

    #[test]
    fn an_emergency_stop_latches_until_it_is_cleared() {
        let mut arm = Arm::default();
        arm.command(&command(1, 1, swing(0.5, 1000.0)), 0.0).expect("taken");
        run(&mut arm, 300, 0.0);
        arm.emergency_stop(&EmergencyStop { v: 1, id: "e1".to_owned(), source: "test".to_owned(), reason: "now".to_owned(), stamp_ns: 0 });
        run(&mut arm, 500, 0.0);
        assert_eq!(arm.mode(), RobotMode::Stopped);
        assert_eq!(arm.command(&command(2, 1, swing(0.5, 1000.0)), 0.0), Err(Ignored::Stopped));
        let mut clear = command(3, 1, Vec::new());
        (clear.clear_stop, clear.starts_stream) = (true, false);
        arm.command(&clear, 0.0).expect("taken");
        assert_eq!(arm.mode(), RobotMode::Idle);
    }

    #[test]
    fn a_stop_that_latched_meanwhile_is_not_cleared_with_another() {
        let mut arm = Arm::default();
        arm.command(&command(1, 1, Vec::new()), 0.0).expect("taken");
        let mut clear = command(2, 1, Vec::new());
        (clear.clear_stop, clear.starts_stream, clear.clears) = (true, false, arm.stop().cloned());
        arm.emergency_stop(&EmergencyStop::read(b"e1"));
        assert_eq!(arm.command(&clear, 0.0), Err(Ignored::OtherStop));
        assert_eq!(arm.mode(), RobotMode::Stopped);
        clear.clears = arm.stop().cloned();
        arm.command(&clear, 0.0).expect("taken");
        assert_eq!(arm.mode(), RobotMode::Idle);
    }

    #[test]
    fn a_command_that_waited_longer_than_it_may_live_is_not_taken() {
        let mut arm = Arm::default();
        let first = command(1, 1, swing(0.5, 1000.0));
        assert_eq!(arm.late_command(&first, 0.0, 1.1), Err(Ignored::Expired));
        assert_eq!((arm.mode(), arm.last_command()), (RobotMode::Idle, None));
        // What has lived for most of its time when it is taken lives for the rest.
        let mut open = first.clone();
        open.ends_stream = false;
        arm.late_command(&open, 0.0, 0.9).expect("taken");
        run(&mut arm, 100, 0.95);
        assert_eq!(arm.mode(), RobotMode::Moving);
        run(&mut arm, 1, 1.05);
        assert_eq!(arm.stop().map(|s| s.kind.as_str()), Some("commander_silent"));
    }

    #[test]
    fn a_command_sent_again_is_acted_on_once_and_keeps_its_sender_from_being_silent() {
        let mut arm = Arm::default();
        let mut first = command(1, 1, swing(0.5, 2000.0));
        first.ends_stream = false;
        arm.command(&first, 0.0).expect("taken");
        run(&mut arm, 400, 0.8);
        assert_eq!(arm.command(&first, 0.8), Err(Ignored::Passed));
        run(&mut arm, 400, 1.7);
        assert_eq!((arm.mode(), arm.stream_ms()), (RobotMode::Moving, Some(800.0)), "it goes on where it was");
    }

    #[test]
    fn set_points_are_bounded_over_all_commands_of_a_stream() {
        let mut arm = Arm::new(ArmSettings { max_set_points: 120, ..ArmSettings::default() });
        let points = swing(0.5, 2000.0);
        let window = |seq: u64, range: std::ops::Range<usize>| {
            let mut window = command(seq, 1, points[range].to_vec());
            (window.starts_stream, window.ends_stream) = (seq == 1, false);
            window
        };
        arm.command(&window(1, 0..100), 0.0).expect("taken");
        assert_eq!(arm.command(&window(2, 100..150), 0.0), Err(Ignored::TooMany));
        arm.command(&window(2, 60..120), 0.0).expect("those that it replaces do not count");
        run(&mut arm, 500, 0.0);
        arm.command(&window(3, 120..160), 0.0).expect("nor do those that are behind");
        assert_eq!(arm.stop(), None);
    }

    #[test]
    fn only_the_newest_owner_commands_and_only_forwards() {
        let mut arm = Arm::default();
        arm.command(&command(7, 2, swing(0.1, 1000.0)), 0.0).expect("taken");
        let mut other = command(1, 2, Vec::new());
        other.owner.id = "motion-2".to_owned();
        assert_eq!(arm.command(&other, 0.0), Err(Ignored::NotOwner));
        assert_eq!(arm.command(&command(8, 1, Vec::new()), 0.0), Err(Ignored::NotOwner));
        assert_eq!(arm.command(&command(7, 2, Vec::new()), 0.0), Err(Ignored::Passed));
        assert_eq!(arm.command(&command(8, 2, swing(0.1, 1000.0)), 0.0), Err(Ignored::Moving));
        run(&mut arm, 1100, 0.0);
        other.owner.epoch = 3;
        other.starts_stream = false;
        arm.command(&other, 0.0).expect("a higher epoch takes over, whatever its sequence number");
        assert_eq!(arm.owner().map(|o| o.id.as_str()), Some("motion-2"));
    }
}
