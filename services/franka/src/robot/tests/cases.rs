//! What the driver does, case by case.

use franka::RobotMode as FciMode;
use repose_panda::{Model, READY};
use repose_proto::robot::{GripperCommand, RobotCommand, RobotMode, Task};

use super::bench::Bench;
use crate::robot::hand::{HandCommand, HandHalt, HandReading};
use crate::robot::side::Refused;

fn turned(by_rad: f64) -> [f64; 7] {
    let mut q_rad = READY;
    q_rad[0] += by_rad;
    q_rad
}

#[test]
fn a_stream_moves_the_robot_and_ends_in_its_own_time() {
    let mut bench = Bench::new(Model::Fr3);
    bench.stream(&turned(0.3), 1000.0).expect("taken");
    bench.run(500);
    assert_eq!((bench.state().mode, bench.robot.mode), (RobotMode::Moving, FciMode::Move));
    bench.run(540);
    assert!((bench.robot.held_rad[0] - 0.3).abs() < 1e-9);
    assert_eq!(bench.state().mode, RobotMode::Moving, "until the robot's motion is over");
    bench.run(100);
    assert_eq!((bench.state().mode, bench.robot.mode), (RobotMode::Idle, FciMode::Idle));
    assert_eq!((bench.state().model.as_deref(), bench.robot.violations.len()), (Some("fr3"), 0));
}

#[test]
fn a_stream_that_follows_closely_goes_on_in_the_same_motion() {
    let mut bench = Bench::new(Model::Fr3);
    bench.stream(&turned(0.1), 600.0).expect("taken");
    bench.run(640);
    bench.stream(&turned(0.0), 600.0).expect("taken");
    bench.run(50);
    assert_eq!(bench.robot.mode, FciMode::Move);
    bench.run(700);
    assert_eq!((bench.state().mode, bench.stopped_by()), (RobotMode::Idle, None));
    assert!((bench.robot.held_rad[0] - READY[0]).abs() < 1e-9);
}

#[test]
fn a_commander_that_falls_silent_stops_the_arm_and_the_stop_stays() {
    let mut bench = Bench::new(Model::Panda);
    let mut set_points = bench.smooth(&turned(1.0), 2000.0);
    set_points.truncate(100);
    let command = RobotCommand { set_points, starts_stream: true, ..bench.next() };
    bench.send(command).expect("taken");
    bench.run(2000);
    assert_eq!(bench.stopped_by().as_deref(), Some("commander_silent"));
    assert_eq!((bench.robot.mode, bench.robot.violations.len()), (FciMode::Idle, 0), "it was brought to rest within the limits");
    let stands = bench.robot.held_rad;
    assert_eq!(bench.stream(&turned(0.0), 1000.0), Err(Refused::Ignored(repose_robot_side::Ignored::Stopped)));
    bench.run(500);
    assert_eq!(bench.robot.held_rad, stands);
    assert!(bench.reset(100));
    assert_eq!((bench.state().mode, bench.robot.recoveries), (RobotMode::Idle, 0), "the robot itself had nothing to acknowledge");
}

#[test]
fn an_emergency_stop_brings_the_arm_to_rest_and_latches() {
    let mut bench = Bench::new(Model::Fr3);
    bench.stream(&turned(1.0), 1500.0).expect("taken");
    bench.run(700);
    bench.estop();
    assert_eq!(bench.stopped_by().as_deref(), Some("estop"));
    bench.run(1500);
    assert_eq!((bench.robot.mode, bench.robot.violations.len()), (FciMode::Idle, 0));
    assert!(bench.robot.held_rad[0] < 0.9, "it did not go on to the end");
    assert_eq!(bench.stopped_by().as_deref(), Some("estop"));
    assert!(bench.reset(100));
}

#[test]
fn a_reflex_is_told_by_its_name_and_acknowledged_by_a_reset_alone() {
    let mut bench = Bench::new(Model::Fr3);
    bench.stream(&turned(0.5), 1000.0).expect("taken");
    bench.run(400);
    bench.reflex("cartesian_reflex");
    bench.run(3000);
    assert_eq!(bench.stopped_by().as_deref(), Some("cartesian_reflex"));
    assert_eq!((bench.robot.mode, bench.robot.recoveries), (FciMode::Reflex, 0), "nobody has asked for a recovery");
    // A millisecond on from what it had last said; the next motion begins where it is.
    let off_rad = (bench.state().q_rad[0] - bench.robot.held_rad[0]).abs();
    assert!(off_rad < 2e-3, "it stands where the robot has stopped, but for {off_rad} rad");
    assert!(bench.reset(1000));
    assert_eq!((bench.robot.mode, bench.robot.recoveries), (FciMode::Idle, 1));
    bench.stream(&turned(0.2), 1000.0).expect("taken");
    bench.run(1300);
    assert!((bench.robot.held_rad[0] - 0.2).abs() < 1e-9);
}

#[test]
fn a_reflex_at_rest_latches_too() {
    let mut bench = Bench::new(Model::Panda);
    bench.reflex("joint_reflex");
    bench.run(10);
    assert_eq!(bench.stopped_by().as_deref(), Some("joint_reflex"));
}

#[test]
fn a_robot_that_does_not_recover_stays_stopped_and_is_asked_once_a_second_at_most() {
    let mut bench = Bench::new(Model::Fr3);
    bench.reflex("joint_reflex");
    bench.robot.is_stubborn = true;
    bench.run(10);
    assert!(!bench.reset(3000));
    assert_eq!(bench.stopped_by().as_deref(), Some("joint_reflex"));
    assert!((2..=4).contains(&bench.robot.recoveries), "{}", bench.robot.recoveries);
    bench.robot.is_stubborn = false;
    bench.run(1000);
    assert!(bench.reset(1000));
}

#[test]
fn nothing_is_cleared_while_the_user_stop_is_pressed() {
    let mut bench = Bench::new(Model::Fr3);
    bench.stream(&turned(0.5), 1000.0).expect("taken");
    bench.run(300);
    bench.user_stop(true);
    bench.run(100);
    assert_eq!(bench.stopped_by().as_deref(), Some("user_stop"));
    assert!(!bench.reset(500));
    bench.user_stop(false);
    bench.run(1500);
    assert_eq!(bench.stopped_by().as_deref(), Some("user_stop"), "letting it go clears nothing");
    assert!(bench.reset(500));
}

#[test]
fn a_lost_connection_latches_and_coming_back_clears_nothing() {
    let mut bench = Bench::new(Model::Fr3);
    bench.stream(&turned(0.5), 1000.0).expect("taken");
    bench.run(300);
    bench.disconnect();
    assert_eq!(bench.stopped_by().as_deref(), Some("connection_lost"));
    assert!(!bench.reset(300), "there is no robot to move");
    bench.reconnect();
    bench.run(500);
    assert_eq!(bench.stopped_by().as_deref(), Some("connection_lost"));
    assert!(bench.reset(1000));
    assert_eq!(bench.robot.recoveries, 1, "it had missed its set-points");
}

#[test]
fn a_robot_that_takes_its_joints_as_they_are_after_a_motion_begins_the_next_one_there() {
    let mut bench = Bench::new(Model::Fr3);
    bench.robot.sag_rad = 0.003;
    for (by_rad, span_ms) in [(0.3, 1000.0), (0.1, 600.0)] {
        bench.stream(&turned(by_rad), span_ms).expect("taken");
        bench.run(1500);
        assert_eq!((bench.stopped_by(), bench.state().mode), (None, RobotMode::Idle));
        assert!((bench.state().q_rad[0] - by_rad).abs() < 1e-9, "the arm stands where it was sent");
        assert!((bench.robot.held_rad[0] - by_rad - 0.003).abs() < 1e-9);
    }
    assert_eq!(bench.robot.violations, Vec::<String>::new());
}

#[test]
fn joints_off_their_set_points_stop_the_arm() {
    let mut bench = Bench::new(Model::Fr3);
    bench.stream(&turned(0.5), 1000.0).expect("taken");
    bench.run(300);
    bench.robot.off_rad = 0.2;
    bench.run(2000);
    assert_eq!(bench.stopped_by().as_deref(), Some("following_error"));
    assert_eq!(bench.robot.violations.len(), 0);
}

#[test]
fn an_arm_that_somebody_has_moved_stands_where_it_is() {
    let mut bench = Bench::new(Model::Fr3);
    bench.robot.held_rad = turned(0.7);
    bench.run(5);
    assert_eq!(bench.state().q_rad, turned(0.7));
    bench.stream(&turned(0.6), 1000.0).expect("taken");
    bench.run(1200);
    assert_eq!((bench.stopped_by(), bench.robot.violations.len()), (None, 0));
}

#[test]
fn set_points_that_only_a_panda_may_take_stop_an_fr3_before_they_reach_it() {
    // 12 rad/s² at joint 1: a Panda may 15, an FR3 10.
    let span_ms = (5.774 * 0.4f64 / 12.0).sqrt() * 1e3;
    for (model, stop) in [(Model::Panda, None), (Model::Fr3, Some("joint_acceleration_limit"))] {
        let mut bench = Bench::new(model);
        bench.stream(&turned(0.4), span_ms).expect("taken");
        bench.run(1500);
        assert_eq!((bench.stopped_by().as_deref(), bench.robot.violations.len()), (stop, 0), "{model:?}");
    }
}

#[test]
fn a_task_whose_commander_is_lost_at_rest_latches() {
    let mut bench = Bench::new(Model::Fr3);
    let task = Task { id: "task-1".to_owned(), open: true, grasps: None };
    let command = RobotCommand { task: Some(task), ..bench.next() };
    bench.send(command).expect("taken");
    bench.run(350);
    assert_eq!(bench.stopped_by(), None);
    bench.run(100);
    assert_eq!(bench.stopped_by().as_deref(), Some("commander_silent"));
}

#[test]
fn the_hand_is_told_once_and_its_loss_latches() {
    let mut bench = Bench::new(Model::Fr3);
    let command = RobotCommand { gripper: Some(GripperCommand { width_m: 0.02, force_n: 60.0 }), ..bench.next() };
    bench.send(command).expect("taken");
    bench.run(5);
    assert_eq!(bench.orders, [HandCommand::Close(0.02, 40.0)], "with no more force than the configuration allows");
    assert!(!bench.state().gripper_settled);
    bench.hand = HandReading { width_m: 0.045, grasps: true, ended: 1, failed: 0, connected: true };
    bench.run(5);
    assert!(bench.state().gripper_settled && bench.state().gripper_holding);
    bench.hand.connected = false;
    bench.run(5);
    assert_eq!(bench.stopped_by().as_deref(), Some("hand_lost"));
}

#[test]
fn a_stop_has_the_hand_leave_off_what_it_does_once() {
    let mut bench = Bench::new(Model::Fr3);
    bench.halts.clear();
    let command = RobotCommand { gripper: Some(GripperCommand { width_m: 0.02, force_n: 30.0 }), ..bench.next() };
    bench.send(command).expect("taken");
    bench.run(5);
    bench.estop();
    bench.run(50);
    assert_eq!(bench.halts, [HandHalt { up_to: 1, stops: true }]);
    assert!(bench.reset(20));
    bench.hand = HandReading { width_m: 0.045, grasps: true, ended: 1, failed: 0, connected: true };
    bench.run(5);
    bench.estop();
    bench.run(50);
    assert_eq!(bench.halts[1..], [HandHalt { up_to: 1, stops: false }], "what it holds does not fall");
}

#[test]
fn a_command_that_the_hand_could_not_carry_out_latches_a_stop_once() {
    let mut bench = Bench::new(Model::Fr3);
    let command = RobotCommand { gripper: Some(GripperCommand { width_m: 0.02, force_n: 30.0 }), ..bench.next() };
    bench.send(command).expect("taken");
    bench.run(5);
    bench.hand = HandReading { width_m: 0.08, grasps: false, ended: 1, failed: 1, connected: true };
    bench.run(5);
    assert_eq!(bench.stopped_by().as_deref(), Some("gripper_failed"));
    assert!(bench.reset(20));
    bench.run(50);
    assert_eq!(bench.stopped_by(), None);
}

#[test]
fn what_the_hand_held_before_the_driver_started_is_shown_as_held() {
    let mut bench = Bench::new(Model::Fr3);
    bench.hand = HandReading { width_m: 0.045, grasps: true, ended: 0, failed: 0, connected: true };
    bench.run(5);
    assert!(bench.state().gripper_settled && bench.state().gripper_holding);
}

#[test]
fn what_the_hand_lost_while_the_robot_was_not_connected_it_may_have_lost_just_now() {
    let mut bench = Bench::new(Model::Fr3);
    bench.hand = HandReading { width_m: 0.045, grasps: true, ended: 0, failed: 0, connected: true };
    bench.run(5);
    bench.disconnect();
    bench.run(30_000);
    bench.hand.grasps = false;
    bench.reconnect();
    bench.run(5);
    let state = bench.state();
    assert!(!state.gripper_holding && state.since_handling_ms.is_some_and(|since_ms| since_ms < 100), "{:?}", state.since_handling_ms);
}

#[test]
fn a_driver_that_is_told_to_end_brings_the_arm_to_rest_first() {
    let mut bench = Bench::new(Model::Fr3);
    bench.stream(&turned(0.8), 1500.0).expect("taken");
    bench.run(600);
    bench.side.end();
    bench.run(800);
    assert_eq!((bench.stopped_by().as_deref(), bench.robot.mode), (Some("driver_ended"), FciMode::Idle));
    assert_eq!(bench.robot.violations.len(), 0);
}

#[test]
fn a_robot_that_is_not_ready_at_the_start_is_stopped() {
    for (mode, kind) in
        [(FciMode::UserStopped, "user_stop"), (FciMode::Guiding, "guiding"), (FciMode::Other, "not_ready"), (FciMode::Move, "other_motion")]
    {
        assert_eq!(Bench::started(Model::Fr3, mode).stopped_by().as_deref(), Some(kind));
        let mut bench = Bench::new(Model::Fr3);
        bench.robot.mode = mode;
        bench.run(5);
        assert_eq!(bench.stopped_by().as_deref(), Some(kind), "and later");
    }
}

#[test]
fn a_driver_that_starts_moves_nothing_until_its_stop_is_cleared() {
    let mut bench = Bench::started(Model::Fr3, FciMode::Idle);
    assert_eq!(bench.stopped_by().as_deref(), Some("driver_started"), "whatever was latched before");
    assert!(bench.state().since_handling_ms.is_some(), "plans of before are old");
    assert_eq!(bench.stream(&turned(0.1), 1000.0), Err(Refused::Ignored(repose_robot_side::Ignored::Stopped)));
    assert!(bench.reset(20));
    assert_eq!((bench.state().mode, bench.robot.recoveries), (RobotMode::Idle, 0));
}

#[test]
fn a_motion_ends_though_set_points_go_on_being_missed() {
    for (in_time_ms, missed_ms) in [(10, 2), (1, 1), (7, 5), (19, 19)] {
        let mut bench = Bench::new(Model::Fr3);
        let to = READY.map(|q| q + 0.3);
        bench.stream(&to, 2000.0).expect("taken");
        bench.run(1000);
        let mut more_ms = 0;
        while bench.robot.in_motion {
            bench.miss(missed_ms);
            bench.run(in_time_ms);
            more_ms += missed_ms + in_time_ms;
            assert!(more_ms < 3000, "{missed_ms} of {} ms are missed, and the motion goes on", missed_ms + in_time_ms);
        }
        assert_eq!((bench.stopped_by(), &bench.robot.violations), (None, &Vec::new()));
        let off_rad = (0..7).map(|i| (bench.robot.held_rad[i] - to[i]).abs()).fold(0.0, f64::max);
        assert!(off_rad < 2e-6, "it ends {off_rad} rad beside where it was sent");
    }
}
