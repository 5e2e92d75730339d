//! A robot that knows Franka's rules, a driver, and time in milliseconds.
//!
//! The robot judges set-points by itself, by backward differences and the official limits: it does not ask the driver's own rules.

use franka::{Errors, RobotMode as FciMode};
use repose_panda::{CommandRuleSettings, JOINT_COUNT, JointLimits, Joints, Model, READY};
use repose_proto::robot::{EmergencyStop, Owner, RobotCommand, RobotMode, RobotState, SetPoint};
use repose_robot_side::{ArmSettings, straight_way};

use crate::robot::fci::{Next, Reading, Trouble};
use crate::robot::hand::{HandCommand, HandHalt, HandReading};
use crate::robot::side::{Do, Refused, Side, SideSettings};

/// How long a recovery takes, milliseconds.
pub const RECOVERY_MS: u64 = 40;

/// The robot.
#[derive(Debug, Clone)]
pub struct Robot {
    limits: JointLimits,
    pub clock_ms: u64,
    pub mode: FciMode,
    pub errors: Errors,
    /// Where it holds its joints, and the differences over a millisecond.
    pub held_rad: Joints,
    velocity: Joints,
    acceleration: Joints,
    /// How far its joints are off where it holds them, radians.
    pub off_rad: f64,
    /// How far off where they were sent it takes its joints to be when a motion ends, radians.
    pub sag_rad: f64,
    pub in_motion: bool,
    recovering_ms: Option<u64>,
    /// Whether the robot refuses to recover.
    pub is_stubborn: bool,
    /// Set-points that it would not have taken: what the driver must never send.
    pub violations: Vec<String>,
    pub recoveries: usize,
    /// Every place of every millisecond.
    pub trace: Vec<Joints>,
}

impl Robot {
    fn new(model: Model) -> Self {
        Self {
            limits: model.limits(),
            clock_ms: 5_000,
            mode: FciMode::Idle,
            errors: Errors::default(),
            held_rad: READY,
            velocity: [0.0; JOINT_COUNT],
            acceleration: [0.0; JOINT_COUNT],
            off_rad: 0.0,
            sag_rad: 0.0,
            in_motion: false,
            recovering_ms: None,
            is_stubborn: false,
            violations: Vec::new(),
            recoveries: 0,
            trace: vec![READY],
        }
    }

    pub fn reading(&self) -> Reading {
        let mut measured_rad = self.held_rad;
        measured_rad[0] += self.off_rad;
        Reading {
            time_ms: self.clock_ms,
            mode: self.mode,
            measured_rad,
            held_rad: self.held_rad,
            held_rad_s: self.velocity,
            held_rad_s2: self.acceleration,
            errors: self.errors,
            success_rate: 1.0,
        }
    }

    /// Goes to a set-point, or stops by a reflex.
    fn go(&mut self, q_rad: &Joints) {
        const DT_S: f64 = 1e-3;
        let velocity: Joints = std::array::from_fn(|i| (q_rad[i] - self.held_rad[i]) / DT_S);
        let acceleration: Joints = std::array::from_fn(|i| (velocity[i] - self.velocity[i]) / DT_S);
        for i in 0..JOINT_COUNT {
            let jerk = (acceleration[i] - self.acceleration[i]) / DT_S;
            let inside = (self.limits.position_lower_rad[i]..=self.limits.position_upper_rad[i]).contains(&q_rad[i]);
            // Rounding of angles is blown up by the third difference.
            let broken = !inside
                || velocity[i].abs() > self.limits.speed_at(i, q_rad[i], velocity[i]) + 1e-9
                || acceleration[i].abs() > self.limits.acceleration_rad_s2[i] + 1e-3
                || jerk.abs() > self.limits.jerk_rad_s3[i] + 1.0;
            if broken || !q_rad[i].is_finite() {
                self.violations
                    .push(format!("joint {i} at {}: {} rad/s, {} rad/s², {jerk} rad/s³", q_rad[i], velocity[i], acceleration[i]));
            }
        }
        (self.held_rad, self.velocity, self.acceleration) = (*q_rad, velocity, acceleration);
    }

    /// Goes on without a set-point: with the acceleration that it has.
    fn go_on(&mut self) {
        const DT_S: f64 = 1e-3;
        for i in 0..JOINT_COUNT {
            self.velocity[i] += self.acceleration[i] * DT_S;
            self.held_rad[i] += self.velocity[i] * DT_S;
        }
    }

    /// Stops by itself.
    fn halt(&mut self) {
        (self.velocity, self.acceleration) = ([0.0; JOINT_COUNT], [0.0; JOINT_COUNT]);
        self.in_motion = false;
    }
}

/// The robot, its driver, and a commander.
pub struct Bench {
    pub side: Side,
    pub robot: Robot,
    pub hand: HandReading,
    pub orders: Vec<HandCommand>,
    pub halts: Vec<HandHalt>,
    pub now_ms: u64,
    pub owner: Owner,
    pub seq: u64,
    pub last: Option<RobotCommand>,
    pub is_connected: bool,
    limits: JointLimits,
}

impl Bench {
    /// A robot that stands ready.
    pub fn new(model: Model) -> Self {
        let mut bench = Self::started(model, FciMode::Idle);
        assert!(bench.reset(20));
        bench
    }

    /// A robot that a driver has just found in that mode.
    pub fn started(model: Model, mode: FciMode) -> Self {
        let limits = model.commanded_limits();
        let rules = CommandRuleSettings { limits, ..CommandRuleSettings::default() };
        let arm = ArmSettings { model, rules, following_tolerance_rad: 0.1, ..ArmSettings::default() };
        let mut side = Side::new(SideSettings { arm, max_grip_force_n: 40.0, has_hand: true, world_from_base: None });
        assert!(side.connected(limits));
        let hand = HandReading { width_m: 0.08, connected: true, ..HandReading::default() };
        let owner = Owner { id: "motion-1".to_owned(), epoch: 1 };
        let robot = Robot { mode, ..Robot::new(model) };
        let mut bench = Self {
            side,
            robot,
            hand,
            orders: Vec::new(),
            halts: Vec::new(),
            now_ms: 0,
            owner,
            seq: 0,
            last: None,
            is_connected: true,
            limits,
        };
        bench.run(3);
        bench
    }

    pub fn now_s(&self) -> f64 {
        self.now_ms as f64 * 1e-3
    }

    /// Lets time pass, as the control loop does.
    pub fn run(&mut self, milliseconds: u64) {
        for _ in 0..milliseconds {
            self.now_ms += 1;
            self.robot.clock_ms += 1;
            self.side.hand(self.hand);
            self.halts.extend(self.side.take_hand_halt());
            if self.is_connected {
                self.cycle();
            }
            self.robot.trace.push(self.robot.held_rad);
        }
    }

    /// Lets time pass in which the driver does not run: the robot gets no set-points.
    pub fn miss(&mut self, milliseconds: u64) {
        for _ in 0..milliseconds {
            self.now_ms += 1;
            self.robot.clock_ms += 1;
            if self.robot.in_motion {
                self.robot.go_on();
            }
            self.robot.trace.push(self.robot.held_rad);
        }
    }

    fn cycle(&mut self) {
        self.robot.recovering_ms = match self.robot.recovering_ms {
            Some(0) => {
                let refused = self.robot.is_stubborn || self.robot.mode == FciMode::UserStopped;
                if !refused {
                    (self.robot.mode, self.robot.errors) = (FciMode::Idle, Errors::default());
                }
                let outcome = if refused { Err("Automatic Error Recovery command rejected".to_owned()) } else { Ok(()) };
                self.side.recovered(outcome, self.now_s());
                None
            }
            left => left.map(|left| left - 1),
        };
        let reading = self.robot.reading();
        if self.robot.in_motion {
            match self.side.following(&reading, self.now_s()) {
                Next::Go(q_rad) => self.robot.go(&q_rad),
                Next::End(q_rad) => {
                    self.robot.go(&q_rad);
                    self.robot.halt();
                    self.robot.held_rad = q_rad.map(|q| q + self.robot.sag_rad);
                    self.robot.mode = FciMode::Idle;
                    self.side.ended(Ok(()));
                }
            }
        } else {
            match self.side.standing(&reading, self.now_s()) {
                Do::Read => {}
                Do::Follow => {
                    assert_eq!(
                        (self.robot.mode, self.robot.errors.any()),
                        (FciMode::Idle, false),
                        "a motion is begun on a robot that is ready"
                    );
                    (self.robot.in_motion, self.robot.mode) = (true, FciMode::Move);
                }
                Do::Recover => {
                    self.robot.recoveries += 1;
                    self.robot.recovering_ms = Some(RECOVERY_MS);
                }
            }
        }
        self.orders.extend(self.side.take_hand_command().map(|(_, order)| order));
    }

    /// The robot stops by a reflex.
    pub fn reflex(&mut self, name: &str) {
        self.robot.errors.0[Errors::index_of(name).expect("a name of libfranka's")] = true;
        let moved = self.robot.in_motion;
        self.robot.halt();
        self.robot.mode = FciMode::Reflex;
        if moved {
            self.side.ended(Err(Trouble::Stopped { kind: name.to_owned(), reason: format!("motion aborted by reflex! [{name:?}]") }));
        }
    }

    /// Somebody presses the user stop, or lets it go.
    pub fn user_stop(&mut self, pressed: bool) {
        if !pressed && self.robot.mode != FciMode::UserStopped {
            return;
        }
        let moved = self.robot.in_motion;
        self.robot.halt();
        let released = if self.robot.errors.any() { FciMode::Reflex } else { FciMode::Idle };
        self.robot.mode = if pressed { FciMode::UserStopped } else { released };
        if pressed && moved {
            self.side.ended(Err(Trouble::Stopped { kind: "user_stop".to_owned(), reason: "User Stop pressed!".to_owned() }));
        }
    }

    /// The connection is lost; the robot misses its set-points and stops.
    pub fn disconnect(&mut self) {
        if self.robot.in_motion {
            self.robot.errors.0[Errors::index_of("communication_constraints_violation").expect("a name of libfranka's")] = true;
            self.robot.mode = FciMode::Reflex;
            self.side.ended(Err(Trouble::Lost("UDP receive: Timeout".to_owned())));
        } else {
            self.side.lost("UDP receive: Timeout".to_owned());
        }
        self.robot.halt();
        self.robot.recovering_ms = None;
        self.is_connected = false;
    }

    pub fn reconnect(&mut self) {
        assert!(self.side.connected(self.limits));
        self.is_connected = true;
    }

    pub fn estop(&mut self) {
        let stop =
            EmergencyStop { v: 1, id: format!("stop-{}", self.now_ms), source: "test".to_owned(), reason: "now".to_owned(), stamp_ns: 0 };
        assert!(self.side.emergency_stop(&stop));
    }

    /// A command of this commander's, with the next number.
    pub fn next(&mut self) -> RobotCommand {
        self.seq += 1;
        RobotCommand::new(self.owner.clone(), self.seq, 400)
    }

    pub fn send(&mut self, command: RobotCommand) -> Result<(), Refused> {
        let taken = self.side.command(&command, self.now_s(), self.now_s());
        self.last = Some(command);
        taken
    }

    /// Asks for the stop to be cleared as motion's reset does: again and again, for so long; whether it was.
    pub fn reset(&mut self, milliseconds: u64) -> bool {
        self.owner.epoch += 1;
        for _ in 0..milliseconds / 20 {
            let command = RobotCommand { clear_stop: true, ..self.next() };
            if self.send(command) == Ok(()) && self.side.stop().is_none() {
                return true;
            }
            self.run(20);
        }
        false
    }

    /// A smooth motion from where the arm is, a set-point every 10 ms.
    pub fn smooth(&mut self, to: &Joints, span_ms: f64) -> Vec<SetPoint> {
        straight_way(&self.state().q_rad, to, span_ms)
    }

    /// Begins a whole stream to a place.
    pub fn stream(&mut self, to: &Joints, span_ms: f64) -> Result<(), Refused> {
        let set_points = self.smooth(to, span_ms);
        let command = RobotCommand { set_points, starts_stream: true, ends_stream: true, ..self.next() };
        self.send(command)
    }

    pub fn state(&mut self) -> RobotState {
        self.side.state(0).expect("a robot that was reached")
    }

    pub fn stopped_by(&mut self) -> Option<String> {
        let state = self.state();
        assert_eq!(state.stop.is_some(), state.mode == RobotMode::Stopped);
        state.stop.map(|stop| stop.kind)
    }
}
