//! A robot of ROS with controllers that do as they are told, and with others.

use repose_panda::READY;
use repose_proto::RigidTransform;
use repose_proto::robot::{EmergencyStop, Owner, RobotCommand, RobotMode, SetPoint, Task};
use repose_ros_messages::{FollowJointTrajectoryResult, GripperCommandResult, JointState, status};

use super::side::{Do, RosSide, Told};
use super::unended::BEFORE;
use crate::config::RobotConfig;

fn config(gripper: bool) -> RobotConfig {
    let hand = if gripper { "gripper_action = \"/hand/gripper_cmd\"\n" } else { "" };
    let robot = format!("name = \"panda\"\ntrajectory_action = \"/arm/follow_joint_trajectory\"\n{hand}");
    RobotConfig { world_from_base: Some(RigidTransform::IDENTITY), ..toml::from_str(&robot).expect("a robot") }
}

fn side(config: RobotConfig) -> RosSide {
    let arm = config.arm("robot").expect("a model");
    RosSide::new(config, arm)
}

/// Joint 0 at `s` of a swing of a second over `delta_rad`, and its speed.
fn swung(from_rad: f64, delta_rad: f64, s: f64, t_ms: f64, rate: f64) -> SetPoint {
    let (place, speed) = (s * s * s * (10.0 - 15.0 * s + 6.0 * s * s), 30.0 * s * s * (1.0 - s) * (1.0 - s));
    let mut point = SetPoint { t_ms, q_rad: READY, dq_rad_s: [0.0; 7] };
    (point.q_rad[0], point.dq_rad_s[0]) = (from_rad + delta_rad * place, delta_rad * speed * rate);
    point
}

/// Joint 0 from where it stands over `delta_rad` and back to rest in a second.
fn swing(from_rad: f64, delta_rad: f64) -> Vec<SetPoint> {
    (0..=100).map(|k| swung(from_rad, delta_rad, f64::from(k) / 100.0, f64::from(k) * 10.0, 1.0)).collect()
}

/// The same swing slowed down to rest from 200 ms on, within 400 ms.
fn halted(from_rad: f64, delta_rad: f64) -> Vec<SetPoint> {
    let at = |k: u32| {
        let u = f64::from(k) / 40.0;
        let rate = 1.0 - u * u * u * (10.0 - 15.0 * u + 6.0 * u * u);
        let s = 0.2 + 0.4 * (u - u.powi(4) * (2.5 - 3.0 * u + u * u));
        swung(from_rad, delta_rad, s, 200.0 + 10.0 * f64::from(k), rate)
    };
    (0..=40).map(at).collect()
}

/// A robot, its clock, and joints that are where its controller has them.
struct Trial {
    side: RosSide,
    now_ms: u64,
    seq: u64,
    joints_rad: [f64; 7],
    fingers_m: f64,
    todo: Vec<Do>,
}

impl Trial {
    /// A robot that stands ready.
    fn new(gripper: bool) -> Self {
        Self::ready(config(gripper))
    }

    fn ready(config: RobotConfig) -> Self {
        let mut trial = Self::started(config);
        trial.hears_of_nothing_before();
        assert!(trial.clears());
        trial
    }

    /// A robot whose joints were just told to a bridge that has started.
    fn started(config: RobotConfig) -> Self {
        let mut trial = Self { side: side(config), now_ms: 0, seq: 0, joints_rad: READY, fingers_m: 0.04, todo: Vec::new() };
        trial.run(20);
        trial
    }

    /// The controller goes on to say that it carries out nothing of before.
    fn hears_of_nothing_before(&mut self) {
        self.run(2100);
        self.side.told(Told::NotThere(BEFORE), self.now_ms);
        self.todo.clear();
    }

    /// Asks for the latched stop to be cleared; whether it was.
    fn clears(&mut self) -> bool {
        self.seq += 1;
        let owner = Owner { id: "motion-1".to_owned(), epoch: 1 };
        let command = RobotCommand { clear_stop: true, ..RobotCommand::new(owner, self.seq, 500) };
        self.side.command(&command, self.now_ms, self.now_ms).is_ok() && self.mode() == RobotMode::Idle
    }

    /// Lets so many milliseconds pass, in steps of four.
    fn run(&mut self, ms: u64) {
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

    fn command(&mut self, change: impl FnOnce(&mut RobotCommand)) {
        self.seq += 1;
        let mut command = RobotCommand::new(Owner { id: "motion-1".to_owned(), epoch: 1 }, self.seq, 500);
        change(&mut command);
        let todo = self.side.command(&command, self.now_ms, self.now_ms).expect("taken");
        self.todo.extend(todo);
    }

    fn start(&mut self, set_points: Vec<SetPoint>) {
        self.command(|command| (command.set_points, command.starts_stream, command.ends_stream) = (set_points, true, true));
    }

    fn done(&mut self) -> Vec<Do> {
        std::mem::take(&mut self.todo)
    }

    fn mode(&mut self) -> RobotMode {
        self.side.state(self.now_ms, 0).expect("a state").mode
    }

    fn stop_kind(&mut self) -> Option<String> {
        self.side.state(self.now_ms, 0).expect("a state").stop.map(|stop| stop.kind)
    }
}

fn ended(number: u64, status: i8) -> Told {
    Told::Ended(number, status, FollowJointTrajectoryResult::default())
}

#[test]
fn a_bridge_that_starts_is_stopped_until_somebody_clears_that() {
    let mut trial = Trial::started(config(false));
    assert_eq!(trial.stop_kind().as_deref(), Some("driver_started"));
    assert!(trial.side.state(trial.now_ms, 0).is_some_and(|state| state.since_handling_ms.is_some()), "plans of before are old");
    trial.hears_of_nothing_before();
    assert_eq!(trial.stop_kind().as_deref(), Some("driver_started"));
    assert!(trial.clears());
}

#[test]
fn what_an_earlier_process_left_is_canceled_until_the_controller_has_said_that_nothing_is_left() {
    let mut trial = Trial::started(config(false));
    trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
    trial.run(1000);
    assert_eq!(trial.done(), vec![Do::Cancel(BEFORE); 5]);
    assert!(!trial.clears(), "the arm may be on its way");
    trial.side.told(Told::Ending(BEFORE), trial.now_ms);
    trial.run(1600);
    assert!(trial.side.overdue_cancels(trial.now_ms).is_some());
    trial.side.told(Told::NotThere(BEFORE), trial.now_ms);
    assert!(!trial.clears(), "the controller may still be ending it");
    trial.run(500);
    trial.side.told(Told::NotThere(BEFORE), trial.now_ms);
    trial.done();
    trial.run(1000);
    assert_eq!((trial.done(), trial.side.overdue_cancels(trial.now_ms)), (Vec::new(), None));
    assert!(trial.clears());
}

#[test]
fn an_arm_whose_controller_is_not_there_at_the_start_stays_stopped_and_that_is_told() {
    let mut trial = Trial::started(config(false));
    trial.run(2000);
    assert_eq!(trial.side.overdue_cancels(trial.now_ms), None, "it has time to answer");
    trial.run(8000);
    assert!(trial.side.overdue_cancels(trial.now_ms).is_some_and(|told| told.contains("before this start")));
    assert!(!trial.clears());
}

#[test]
fn a_bridge_that_is_told_to_end_cancels_the_goal_first() {
    let mut trial = Trial::new(false);
    trial.side.end();
    assert!(trial.side.has_ended());
    assert_eq!(trial.stop_kind(), None, "nothing is under way");
    trial.start(swing(READY[0], 0.3));
    trial.side.told(Told::Accepted(1), trial.now_ms);
    trial.run(40);
    trial.done();
    trial.side.end();
    trial.run(4);
    assert_eq!((trial.done(), trial.stop_kind().as_deref()), (vec![Do::Cancel(1)], Some("driver_ended")));
    assert!(!trial.side.has_ended());
    trial.side.told(ended(1, status::CANCELED), trial.now_ms);
    assert!(trial.side.has_ended());
}

#[test]
fn a_robot_whose_base_is_not_known_stays_stopped() {
    let mut trial = Trial::started(RobotConfig { world_from_base: None, ..config(false) });
    trial.hears_of_nothing_before();
    assert!(!trial.clears());
    assert!(trial.side.unknown_base().is_some_and(|told| told.contains("panda_link0")));
    trial.side.stands(RigidTransform::IDENTITY);
    assert_eq!(trial.side.unknown_base(), None);
    assert!(trial.clears());
}

#[test]
fn an_arm_is_held_against_the_limits_of_its_own_model() {
    // 2.4 rad/s at joint 1: an FR3 may 2.62, a Panda 2.175.
    for (model, stop) in [("panda", Some("joint_velocity_limit")), ("fr3", None)] {
        let mut trial = Trial::ready(RobotConfig { model: model.to_owned(), ..config(false) });
        trial.start(swing(READY[0], 1.3));
        assert_eq!(trial.stop_kind().as_deref(), stop, "{model}");
        assert_eq!(trial.side.state(trial.now_ms, 0).expect("a state").model.as_deref(), Some(model));
    }
}

#[test]
fn a_stream_becomes_one_goal_begins_when_it_is_accepted_and_is_over_when_the_controller_says_so() {
    let mut trial = Trial::new(false);
    trial.start(swing(READY[0], 0.3));
    let [Do::Follow(1, trajectory)] = &trial.done()[..] else { panic!("one goal") };
    assert_eq!((trajectory.joint_names[0].as_str(), trajectory.points.len()), ("panda_joint1", 100));
    assert_eq!(trajectory.points[0].time_from_start.as_ms(), 10.0);
    assert_eq!(trajectory.points[99].positions[0], READY[0] + 0.3);
    trial.run(200);
    let waiting = trial.side.state(trial.now_ms, 0).expect("a state");
    assert_eq!((waiting.mode, waiting.stream_ms), (RobotMode::Moving, Some(0.0)), "the controller has not begun");
    trial.side.told(Told::Accepted(1), trial.now_ms);
    for k in 0..26 {
        trial.joints_rad[0] = READY[0] + 0.3 * f64::from(k) / 25.0;
        trial.run(40);
    }
    let late = trial.side.state(trial.now_ms, 0).expect("a state");
    assert_eq!((late.mode, late.stream_ms), (RobotMode::Moving, Some(1000.0)), "its result has not come");
    trial.side.told(ended(1, status::SUCCEEDED), trial.now_ms);
    assert_eq!((trial.mode(), trial.done().len()), (RobotMode::Idle, 0));
}

#[test]
fn what_a_controller_must_not_get_it_does_not_get() {
    for (name, points, kind) in
        [("too fast", swing(READY[0], 2.5), "joint_velocity_limit"), ("from elsewhere", swing(READY[0] + 0.1, 0.1), "start_pose_mismatch")]
    {
        let mut trial = Trial::new(false);
        trial.start(points);
        assert_eq!((trial.done(), trial.stop_kind().as_deref()), (Vec::new(), Some(kind)), "{name}");
    }
    let mut trial = Trial::new(false);
    trial.command(|command| (command.set_points, command.starts_stream) = (swing(READY[0], 0.3), true));
    assert_eq!((trial.done(), trial.stop_kind().as_deref()), (Vec::new(), Some("horizon_too_short")));
    trial.side.told(Told::Accepted(7), trial.now_ms);
    let mut trial = Trial::new(false);
    trial.command(|command| command.gripper = Some(repose_proto::robot::GripperCommand { width_m: 0.0, force_n: 10.0 }));
    trial.run(8);
    assert_eq!(trial.stop_kind().as_deref(), Some("no_gripper"));
}

#[test]
fn a_controller_that_refuses_aborts_or_falls_silent_latches_a_stop() {
    let trial = || {
        let mut trial = Trial::new(false);
        trial.start(swing(READY[0], 0.3));
        trial.done();
        trial
    };
    let mut refused = trial();
    refused.side.told(Told::Refused(1, "busy".to_owned()), refused.now_ms);
    assert_eq!(refused.stop_kind().as_deref(), Some("controller_refused"));
    let mut silent = trial();
    silent.run(2100);
    assert_eq!(silent.stop_kind().as_deref(), Some("controller_silent"));
    assert_eq!(silent.done(), [Do::Cancel(1)]);
    let mut aborted = trial();
    aborted.side.told(Told::Accepted(1), aborted.now_ms);
    aborted.run(40);
    aborted.side.told(ended(1, status::ABORTED), aborted.now_ms);
    assert_eq!(aborted.stop_kind().as_deref(), Some("controller_aborted"));
    let mut stuck = trial();
    stuck.side.told(Told::Accepted(1), stuck.now_ms);
    stuck.run(1200);
    assert_eq!(stuck.stop_kind().as_deref(), Some("following_error"), "its joints do not move");
}

#[test]
fn joints_that_are_told_of_late_and_a_bridge_that_pauses_are_no_fault() {
    let mut trial = Trial::new(false);
    trial.start(swing(READY[0], 1.0));
    // It was accepted a while before its word came, and is told of later still.
    trial.side.told(Told::Accepted(1), trial.now_ms);
    let began_ms = trial.now_ms;
    while trial.now_ms < began_ms + 1400 {
        // For a fifth of a second in the middle, nothing comes and nothing is done.
        trial.now_ms += if trial.now_ms == began_ms + 400 { 200 } else { 0 };
        let late_s = ((trial.now_ms - began_ms) as f64 / 1000.0 - 0.15).clamp(0.0, 1.0);
        trial.joints_rad = swung(READY[0], 1.0, late_s, 0.0, 1.0).q_rad;
        trial.run(4);
        assert_eq!(trial.stop_kind(), None, "after {} ms", trial.now_ms - began_ms);
    }
    trial.side.told(ended(1, status::SUCCEEDED), trial.now_ms);
    assert_eq!(trial.mode(), RobotMode::Idle);
}

#[test]
fn a_stop_cancels_the_goal_and_the_arm_stands_where_its_joints_are() {
    let mut trial = Trial::new(false);
    trial.start(swing(READY[0], 0.3));
    trial.side.told(Told::Accepted(1), trial.now_ms);
    trial.run(300);
    trial.done();
    trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
    trial.run(4);
    assert_eq!(trial.done(), [Do::Cancel(1)]);
    trial.joints_rad[0] = READY[0] + 0.07;
    trial.side.told(ended(1, status::CANCELED), trial.now_ms);
    trial.run(800);
    let state = trial.side.state(trial.now_ms, 0).expect("a state");
    assert_eq!((state.mode, state.q_rad[0]), (RobotMode::Stopped, READY[0] + 0.07));
    let stop = state.stop.expect("latched");
    assert_eq!(stop.kind, "estop", "the canceled goal is no fault of its own");
    trial.command(|command| (command.clear_stop, command.clears) = (true, Some(stop)));
    assert_eq!(trial.mode(), RobotMode::Idle);
    trial.start(swing(READY[0] + 0.07, 0.1));
    assert!(matches!(trial.done()[..], [Do::Follow(2, _)]), "it goes on from there");
}

/// A robot whose goal of a second is under way, and an emergency stop.
fn stopped_on_its_way(told: Option<Told>) -> Trial {
    let mut trial = Trial::new(false);
    trial.start(swing(READY[0], 0.3));
    told.into_iter().for_each(|told| trial.side.told(told, trial.now_ms));
    trial.run(40);
    trial.done();
    trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
    trial
}

#[test]
fn a_goal_that_does_not_end_is_canceled_again_and_its_stop_stays() {
    let mut trial = stopped_on_its_way(Some(Told::Accepted(1)));
    trial.run(1000);
    assert_eq!(trial.done(), vec![Do::Cancel(1); 4]);
    assert!(!trial.clears(), "the controller may still move the arm");
    trial.side.told(Told::NotThere(1), trial.now_ms);
    assert!(!trial.clears(), "the cancel may have come before the goal");
    trial.run(1100);
    assert!(trial.side.overdue_cancels(trial.now_ms).is_some());
    trial.side.told(Told::NotThere(1), trial.now_ms);
    trial.done();
    trial.run(1000);
    assert_eq!((trial.done(), trial.side.overdue_cancels(trial.now_ms)), (Vec::new(), None));
    assert!(trial.clears());
}

#[test]
fn a_goal_that_is_accepted_after_its_cancel_is_canceled_at_once() {
    let mut trial = stopped_on_its_way(None);
    trial.run(4);
    assert_eq!(trial.done(), [Do::Cancel(1)]);
    trial.side.told(Told::Accepted(1), trial.now_ms);
    trial.run(4);
    assert_eq!(trial.done(), [Do::Cancel(1)]);
    trial.side.told(ended(1, status::CANCELED), trial.now_ms);
    trial.run(1000);
    assert_eq!(trial.done(), []);
    assert!(trial.clears());
}

#[test]
fn a_goal_whose_answer_was_lost_is_canceled() {
    let mut trial = Trial::new(false);
    trial.start(swing(READY[0], 0.3));
    trial.done();
    trial.side.told(Told::Unanswered(1, "no answer".to_owned()), trial.now_ms);
    assert_eq!(trial.stop_kind().as_deref(), Some("controller_silent"));
    trial.run(4);
    assert_eq!(trial.done(), [Do::Cancel(1)]);
}

#[test]
fn a_goal_whose_successor_is_refused_is_canceled() {
    let mut trial = Trial::new(false);
    trial.start(swing(READY[0], 0.3));
    trial.side.told(Told::Accepted(1), trial.now_ms);
    trial.run(100);
    trial.command(|command| (command.set_points, command.ends_stream) = (halted(READY[0], 0.3), true));
    trial.done();
    trial.side.told(Told::Refused(2, "busy".to_owned()), trial.now_ms);
    trial.run(4);
    assert_eq!((trial.done(), trial.stop_kind().as_deref()), (vec![Do::Cancel(1)], Some("controller_refused")));
}

#[test]
fn a_stream_that_is_brought_to_rest_on_its_way_takes_the_place_of_the_goal() {
    let mut trial = Trial::new(false);
    let whole = swing(READY[0], 0.3);
    trial.start(whole.clone());
    trial.side.told(Told::Accepted(1), trial.now_ms);
    trial.run(100);
    trial.done();
    trial.command(|command| (command.set_points, command.ends_stream) = (whole[20..].to_vec(), true));
    assert_eq!(trial.done(), [], "what it has already");
    trial.command(|command| (command.set_points, command.ends_stream) = (halted(READY[0], 0.3), true));
    let [Do::Follow(2, trajectory)] = &trial.done()[..] else { panic!("another goal") };
    assert!(trajectory.points[0].time_from_start.as_ms() <= 10.0);
    assert_eq!(trajectory.points.last().map(|p| p.velocities[0].abs() < 1e-9), Some(true));
    trial.side.told(ended(1, status::ABORTED), trial.now_ms);
    assert_eq!((trial.stop_kind(), trial.mode()), (None, RobotMode::Moving), "the goal whose place was taken is of no matter");
    trial.side.told(Told::Accepted(2), trial.now_ms);
    trial.joints_rad[0] = halted(READY[0], 0.3)[40].q_rad[0];
    trial.run(600);
    trial.side.told(ended(2, status::SUCCEEDED), trial.now_ms);
    assert_eq!(trial.mode(), RobotMode::Idle);
}

#[test]
fn the_hand_closes_and_holds_what_stalls_it() {
    let mut trial = Trial::new(true);
    trial.command(|command| {
        command.gripper = Some(repose_proto::robot::GripperCommand { width_m: 0.02, force_n: 30.0 });
        command.task = Some(Task { id: "t1".to_owned(), open: true, grasps: None });
    });
    trial.run(8);
    assert_eq!(trial.done(), [Do::Grip(1, 0.01, 30.0)]);
    assert!(!trial.side.state(trial.now_ms, 0).expect("a state").gripper_settled);
    trial.fingers_m = 0.03;
    let stalled = GripperCommandResult { position: 0.03, effort: 30.0, stalled: true, reached_goal: false };
    trial.side.told(Told::Gripped(1, status::SUCCEEDED, stalled), trial.now_ms);
    trial.run(8);
    let state = trial.side.state(trial.now_ms, 0).expect("a state");
    assert!(state.gripper_settled && state.gripper_holding && (state.gripper_width_m - 0.06).abs() < 1e-9);
}

#[test]
fn a_stop_cancels_the_hand_until_its_goal_ends_unless_something_is_between_its_fingers() {
    for stalls in [false, true] {
        let mut trial = Trial::new(true);
        trial.command(|command| command.gripper = Some(repose_proto::robot::GripperCommand { width_m: 0.02, force_n: 30.0 }));
        trial.run(8);
        assert_eq!(trial.done(), [Do::Grip(1, 0.01, 30.0)]);
        if stalls {
            trial.side.told(Told::Stalled(1), trial.now_ms);
        }
        trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
        trial.run(400);
        assert_eq!(trial.done(), vec![Do::CancelGrip(1); if stalls { 0 } else { 2 }]);
        assert_eq!(trial.stop_kind().as_deref(), Some("estop"));
        trial.side.told(Told::Gripped(1, status::CANCELED, GripperCommandResult::default()), trial.now_ms);
        trial.run(400);
        assert_eq!((trial.done(), trial.stop_kind().as_deref()), (Vec::new(), Some("estop")));
        assert!(trial.clears());
    }
}

#[test]
fn a_goal_of_the_hand_that_fails_latches_a_stop_and_one_that_something_stalls_does_not() {
    let short = GripperCommandResult { position: 0.03, ..GripperCommandResult::default() };
    let stalled = GripperCommandResult { stalled: true, ..short };
    for (told, stop) in [
        (Told::NotGripped(1, "it refused the goal".to_owned()), Some("gripper_failed")),
        (Told::Gripped(1, status::ABORTED, short), Some("gripper_failed")),
        (Told::Gripped(1, status::ABORTED, stalled), None),
        // It was to grasp, and nothing was there.
        (Told::Gripped(1, status::ABORTED, GripperCommandResult { position: 0.01, ..short }), None),
        (Told::Gripped(1, status::SUCCEEDED, short), None),
        (Told::NotGripped(7, "another goal".to_owned()), None),
    ] {
        let mut trial = Trial::new(true);
        trial.command(|command| command.gripper = Some(repose_proto::robot::GripperCommand { width_m: 0.02, force_n: 30.0 }));
        trial.run(8);
        trial.side.told(told.clone(), trial.now_ms);
        assert_eq!(trial.stop_kind().as_deref(), stop, "{told:?}");
    }
}

#[test]
fn a_goal_of_the_hand_that_a_stop_has_canceled_is_no_failure_when_it_ends_late() {
    let mut trial = Trial::new(true);
    trial.command(|command| command.gripper = Some(repose_proto::robot::GripperCommand { width_m: 0.02, force_n: 30.0 }));
    trial.run(8);
    trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
    trial.run(8);
    assert!(trial.clears());
    trial.side.told(Told::Gripped(1, status::CANCELED, GripperCommandResult::default()), trial.now_ms);
    assert_eq!((trial.stop_kind(), trial.mode()), (None, RobotMode::Idle));
}

#[test]
fn joints_that_nobody_tells_of_are_not_shown_and_stop_an_arm_that_moves() {
    let mut trial = Trial::new(false);
    trial.now_ms += 600;
    assert!(trial.side.state(trial.now_ms, 0).is_none());
    trial.run(8);
    trial.start(swing(READY[0], 0.3));
    trial.side.told(Told::Accepted(1), trial.now_ms);
    trial.run(20);
    trial.now_ms += 600;
    let todo = trial.side.step(trial.now_ms);
    assert_eq!(todo, [Do::Cancel(1)]);
    trial.run(8);
    assert_eq!(trial.stop_kind().as_deref(), Some("joint_states_silent"));
    assert_eq!(side(config(false)).missing().len(), 7);
}
