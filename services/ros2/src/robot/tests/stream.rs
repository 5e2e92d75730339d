//! Set-points as goals of the arm's controller, and controllers that do not do as they are told.

use repose_panda::READY;
use repose_proto::robot::{RobotMode, Task};
use repose_ros_messages::status;

use super::trial::{Trial, config, ended, halted, side, swing, swung};
use crate::config::RobotConfig;
use crate::robot::events::{Do, Told};
use crate::robot::goal::REPLACE_LEAD_MS;

#[test]
fn an_arm_is_checked_against_the_limits_of_its_own_model() {
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
fn a_stream_that_is_brought_to_rest_on_its_way_takes_the_place_of_the_goal() {
    let mut trial = Trial::new(false);
    let whole = swing(READY[0], 0.1);
    trial.start(whole.clone());
    trial.side.told(Told::Accepted(1), trial.now_ms);
    trial.run(100);
    trial.done();
    trial.command(|command| (command.set_points, command.ends_stream) = (whole[20..].to_vec(), true));
    assert_eq!(trial.done(), [], "what it has already");
    trial.command(|command| (command.set_points, command.ends_stream) = (halted(400.0, READY[0], 0.1), true));
    let [Do::Follow(2, trajectory)] = &trial.done()[..] else { panic!("another goal") };
    let first_ms = trajectory.points[0].time_from_start.as_ms();
    assert!(first_ms > REPLACE_LEAD_MS && first_ms <= REPLACE_LEAD_MS + 10.0, "{first_ms}");
    assert_eq!(trajectory.points.last().map(|p| p.velocities[0].abs() < 1e-9), Some(true));
    trial.side.told(ended(1, status::ABORTED), trial.now_ms);
    assert_eq!((trial.stop_kind(), trial.mode()), (None, RobotMode::Moving), "the goal whose place was taken does not matter");
    trial.side.told(Told::Accepted(2), trial.now_ms);
    trial.joints_rad[0] = halted(400.0, READY[0], 0.1)[40].q_rad[0];
    trial.run(800);
    trial.side.told(ended(2, status::SUCCEEDED), trial.now_ms);
    assert_eq!(trial.mode(), RobotMode::Idle);
}

#[test]
fn a_stream_that_is_over_before_a_controller_could_be_told_otherwise_is_not_sent_again() {
    let mut trial = Trial::new(false);
    let whole = swing(READY[0], 0.05);
    trial.start(whole.clone());
    trial.side.told(Told::Accepted(1), trial.now_ms);
    trial.run(840);
    trial.done();
    // As it is, with a set-point more.
    let beside = swung(READY[0], 0.05, 0.8555, 855.5, 1.0);
    trial.command(|command| (command.set_points, command.ends_stream) = ([&[beside][..], &whole[86..]].concat(), true));
    assert_eq!((trial.done(), trial.mode()), (Vec::new(), RobotMode::Moving));
    trial.run(300);
    trial.side.told(ended(1, status::SUCCEEDED), trial.now_ms);
    assert_eq!(trial.mode(), RobotMode::Idle);
}

#[test]
fn an_arm_that_others_move_stands_where_its_joints_are() {
    let mut trial = Trial::new(false);
    let shown = |trial: &mut Trial| trial.side.state(trial.now_ms, 0).expect("a state").q_rad;
    trial.joints_rad[0] += 0.05;
    trial.run(40);
    assert_eq!(shown(&mut trial), trial.joints_rad);
    for _ in 0..35 {
        trial.joints_rad[0] += 0.01;
        trial.run(4);
        assert_eq!(shown(&mut trial), trial.joints_rad);
    }
    let stands_rad = trial.joints_rad;
    trial.joints_rad[0] += 0.004;
    trial.run(40);
    assert_eq!(shown(&mut trial), stands_rad, "a servo's droop is not followed");
    trial.start(swing(stands_rad[0], 0.1));
    assert!(matches!(trial.done()[..], [Do::Follow(1, _)]));
}

#[test]
fn a_stream_of_an_open_task_that_starts_where_the_joints_are_not_latches_a_stop() {
    let mut trial = Trial::new(false);
    trial.command(|command| command.task = Some(Task { id: "t1".to_owned(), open: true, grasps: None }));
    trial.joints_rad[0] += 0.03;
    trial.run(40);
    assert_eq!(trial.side.state(trial.now_ms, 0).expect("a state").q_rad, READY, "the task's next stream starts where it was");
    trial.start(swing(READY[0], 0.3));
    assert_eq!((trial.done(), trial.stop_kind().as_deref()), (Vec::new(), Some("start_pose_mismatch")));
}

#[test]
fn a_stream_that_follows_another_is_taken_once_the_joints_are_told_of_where_it_starts() {
    let mut trial = Trial::new(false);
    trial.start(swing(READY[0], 0.05));
    trial.side.told(Told::Accepted(1), trial.now_ms);
    trial.run(1100);
    trial.side.told(ended(1, status::SUCCEEDED), trial.now_ms);
    trial.done();
    let next = || swing(READY[0] + 0.05, 0.05);
    trial.run(100);
    assert!(trial.try_start(next()).is_err_and(|why| why.message.contains("not told of yet")));
    assert_eq!((trial.done(), trial.mode()), (Vec::new(), RobotMode::Idle));
    trial.joints_rad[0] += 0.05;
    trial.run(8);
    trial.start(next());
    assert!(matches!(trial.done()[..], [Do::Follow(2, _)]));
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
