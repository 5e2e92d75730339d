//! A robot of ROS, its clock, and joints that are where its controller has them.

use repose_panda::READY;
use repose_proto::robot::{Owner, RobotCommand, RobotMode, SetPoint};
use repose_proto::{CallError, RigidTransform};
use repose_ros_messages::{FollowJointTrajectoryResult, JointState};

use crate::config::RobotConfig;
use crate::robot::events::{Do, Told};
use crate::robot::side::RosSide;
use crate::robot::unended::OTHERS;

pub(super) fn config(gripper: bool) -> RobotConfig {
    let hand = if gripper { "gripper_action = \"/hand/gripper_cmd\"\n" } else { "" };
    let robot = format!("name = \"panda\"\ntrajectory_action = \"/arm/follow_joint_trajectory\"\n{hand}");
    RobotConfig { world_from_base: Some(RigidTransform::IDENTITY), ..toml::from_str(&robot).expect("a robot") }
}

pub(super) fn side(config: RobotConfig) -> RosSide {
    let arm = config.arm("robot").expect("a model");
    RosSide::new(config, arm)
}

/// Joint 0 at `s` of a swing of a second over `delta_rad`, and its speed.
pub(super) fn swung(from_rad: f64, delta_rad: f64, s: f64, t_ms: f64, rate: f64) -> SetPoint {
    let (place, speed) = (s * s * s * (10.0 - 15.0 * s + 6.0 * s * s), 30.0 * s * s * (1.0 - s) * (1.0 - s));
    let mut point = SetPoint { t_ms, q_rad: READY, dq_rad_s: [0.0; 7] };
    (point.q_rad[0], point.dq_rad_s[0]) = (from_rad + delta_rad * place, delta_rad * speed * rate);
    point
}

/// Joint 0 from where it stands over `delta_rad` and back to rest in a second.
pub(super) fn swing(from_rad: f64, delta_rad: f64) -> Vec<SetPoint> {
    (0..=100).map(|k| swung(from_rad, delta_rad, f64::from(k) / 100.0, f64::from(k) * 10.0, 1.0)).collect()
}

/// The same swing slowed down to rest from `slows_ms` on, within 400 ms.
pub(super) fn halted(slows_ms: f64, from_rad: f64, delta_rad: f64) -> Vec<SetPoint> {
    let at = |k: u32| {
        let u = f64::from(k) / 40.0;
        let rate = 1.0 - u * u * u * (10.0 - 15.0 * u + 6.0 * u * u);
        let s = 1e-3 * slows_ms + 0.4 * (u - u.powi(4) * (2.5 - 3.0 * u + u * u));
        swung(from_rad, delta_rad, s, slows_ms + 10.0 * f64::from(k), rate)
    };
    (0..=40).map(at).collect()
}

/// A robot, its clock, and joints that are where its controller has them.
pub(super) struct Trial {
    pub(super) side: RosSide,
    pub(super) now_ms: u64,
    seq: u64,
    pub(super) joints_rad: [f64; 7],
    pub(super) fingers_m: f64,
    todo: Vec<Do>,
}

impl Trial {
    /// A robot that stands ready.
    pub(super) fn new(gripper: bool) -> Self {
        Self::ready(config(gripper))
    }

    pub(super) fn ready(config: RobotConfig) -> Self {
        let mut trial = Self::started(config);
        trial.hears_of_nothing_of_others();
        assert!(trial.clears());
        trial
    }

    /// A robot whose joints were just told to a bridge that has started.
    pub(super) fn started(config: RobotConfig) -> Self {
        let mut trial = Self { side: side(config), now_ms: 0, seq: 0, joints_rad: READY, fingers_m: 0.04, todo: Vec::new() };
        trial.run(20);
        trial
    }

    /// The controller goes on to say that it carries out nothing of others.
    pub(super) fn hears_of_nothing_of_others(&mut self) {
        self.run(2100);
        self.side.told(Told::NotThere(OTHERS), self.now_ms);
        self.todo.clear();
    }

    /// Asks for the latched stop to be cleared; whether it was.
    pub(super) fn clears(&mut self) -> bool {
        self.seq += 1;
        let owner = Owner { id: "motion-1".to_owned(), epoch: 1 };
        let command = RobotCommand { clear_stop: true, ..RobotCommand::new(owner, self.seq, 500) };
        self.side.command(&command, self.now_ms, self.now_ms).is_ok() && self.mode() == RobotMode::Idle
    }

    /// Lets so many milliseconds pass, in steps of four.
    pub(super) fn run(&mut self, ms: u64) {
        for _ in 0..ms / 4 {
            self.now_ms += 4;
            self.tell_joints();
            self.todo.extend(self.side.step(self.now_ms));
        }
    }

    fn tell_joints(&mut self) {
        let fingers = ["panda_finger_joint1", "panda_finger_joint2"].map(str::to_owned);
        let name = (1..=7).map(|i| format!("panda_joint{i}")).chain(fingers).collect();
        let position = self.joints_rad.into_iter().chain([self.fingers_m; 2]).collect();
        self.side.joints(&JointState { name, position, ..JointState::default() }, self.now_ms);
    }

    pub(super) fn command(&mut self, change: impl FnOnce(&mut RobotCommand)) {
        self.try_command(change).expect("taken");
    }

    pub(super) fn try_command(&mut self, change: impl FnOnce(&mut RobotCommand)) -> Result<(), CallError> {
        self.seq += 1;
        let mut command = RobotCommand::new(Owner { id: "motion-1".to_owned(), epoch: 1 }, self.seq, 500);
        change(&mut command);
        let todo = self.side.command(&command, self.now_ms, self.now_ms)?;
        self.todo.extend(todo);
        Ok(())
    }

    pub(super) fn start(&mut self, set_points: Vec<SetPoint>) {
        self.try_start(set_points).expect("taken");
    }

    pub(super) fn try_start(&mut self, set_points: Vec<SetPoint>) -> Result<(), CallError> {
        self.try_command(|command| (command.set_points, command.starts_stream, command.ends_stream) = (set_points, true, true))
    }

    pub(super) fn done(&mut self) -> Vec<Do> {
        std::mem::take(&mut self.todo)
    }

    /// The same but for cancels of what others may have sent.
    pub(super) fn done_of_own(&mut self) -> Vec<Do> {
        self.done().into_iter().filter(|todo| *todo != Do::Cancel(OTHERS)).collect()
    }

    pub(super) fn mode(&mut self) -> RobotMode {
        self.side.state(self.now_ms, 0).expect("a state").mode
    }

    pub(super) fn stop_kind(&mut self) -> Option<String> {
        self.side.state(self.now_ms, 0).expect("a state").stop.map(|stop| stop.kind)
    }
}

pub(super) fn ended(number: u64, status: i8) -> Told {
    Told::Ended(number, status, FollowJointTrajectoryResult::default())
}
