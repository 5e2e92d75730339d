//! What the arm takes, follows and latches.

use repose_proto::robot::SetPoint;

use repose_proto::robot::Task;

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
        task: None,
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
fn an_arm_that_stands_beyond_its_limits_comes_back_and_goes_no_further() {
    // As a driver has them that keeps off the robot's own.
    let mut settings = ArmSettings::default();
    settings.rules.limits.position_upper_rad[0] -= 0.005;
    let mut stands_rad = READY;
    stands_rad[0] = settings.rules.limits.position_upper_rad[0] + 0.003;
    let from_there = |delta_rad| {
        let mut points = swing(delta_rad, 2000.0);
        points.iter_mut().for_each(|p| p.q_rad[0] += stands_rad[0] - READY[0]);
        let mut arm = Arm::standing_at(stands_rad, settings);
        arm.command(&command(1, 1, points), 0.0).expect("taken");
        run(&mut arm, 2100, 0.0);
        arm
    };
    let back = from_there(-0.5);
    assert_eq!((back.mode(), back.stop()), (RobotMode::Idle, None));
    assert!((back.q_rad()[0] - stands_rad[0] + 0.5).abs() < 1e-6);
    let further = from_there(0.001);
    assert_eq!(further.stop().map(|s| s.kind.as_str()), Some("joint_position_limit"));
    assert!(further.q_rad()[0] <= stands_rad[0]);
}

#[test]
fn a_joint_beyond_its_limits_may_stay_where_it_is_while_others_move() {
    let mut settings = ArmSettings::default();
    settings.rules.limits.position_upper_rad[6] -= 0.005;
    for k in 1..50 {
        let mut stands_rad = READY;
        stands_rad[6] = settings.rules.limits.position_upper_rad[6] + 0.0001 * f64::from(k);
        let mut points = swing(-0.5, 2000.0);
        points.iter_mut().for_each(|p| p.q_rad[6] = stands_rad[6]);
        let mut arm = Arm::standing_at(stands_rad, settings);
        arm.command(&command(1, 1, points), 0.0).expect("taken");
        run(&mut arm, 2100, 0.0);
        assert_eq!((arm.mode(), arm.stop()), (RobotMode::Idle, None), "{k}");
        assert!((arm.q_rad()[0] - READY[0] + 0.5).abs() < 1e-6);
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
fn an_arm_that_a_driver_finds_is_stopped_and_what_was_seen_before_is_old() {
    let reflex = ("joint_reflex".to_owned(), "a touch".to_owned());
    for (own, kind) in [(None, DRIVER_STARTED), (Some(reflex), "joint_reflex")] {
        let mut arm = Arm::found_at(READY, ArmSettings::default(), 3.0, own);
        assert_eq!(arm.stop().map(|stop| stop.kind.as_str()), Some(kind));
        assert_eq!(arm.command(&command(1, 1, swing(0.5, 1000.0)), 3.0), Err(Ignored::Stopped));
        arm.tick(3.25);
        assert_eq!(arm.since_handling_ms(), Some(250), "whatever the hand did before");
        let clear = RobotCommand { clear_stop: true, starts_stream: false, ..command(2, 1, Vec::new()) };
        arm.command(&clear, 3.25).expect("taken");
        assert_eq!(arm.mode(), RobotMode::Idle);
    }
}

#[test]
fn a_second_emergency_stop_is_not_cleared_with_the_first() {
    let estop = |id: &str| EmergencyStop { v: 1, id: id.to_owned(), source: id.to_owned(), reason: "now".to_owned(), stamp_ns: 0 };
    for last in [&["b"][..], &["b", "a"], &["b", "c", "d", "a"]] {
        let mut arm = Arm::default();
        arm.emergency_stop(&estop("a"));
        let first = arm.stop().cloned();
        arm.emergency_stop(&estop("a"));
        assert_eq!(arm.stop(), first.as_ref(), "a repeat is the same stop");
        last.iter().for_each(|id| arm.emergency_stop(&estop(id)));
        assert_eq!(arm.stop().and_then(|stop| stop.estop_id.as_deref()), last.last().copied(), "its sender sees it");
        let mut clear = RobotCommand { clear_stop: true, starts_stream: false, clears: first, ..command(1, 1, Vec::new()) };
        assert_eq!(arm.command(&clear, 0.0), Err(Ignored::OtherStop), "{last:?}");
        clear.clears = arm.stop().cloned();
        arm.command(&clear, 0.0).expect("taken");
        arm.emergency_stop(&estop("e"));
        assert_eq!(arm.stop().map(|stop| stop.reason.as_str()), Some("e: now"), "those that were cleared are over");
    }
}

#[test]
fn an_emergency_stop_says_what_had_stopped_the_arm_before() {
    let mut arm = Arm::default();
    arm.fault("gripper_failed", "the hand does not answer".to_owned());
    let estop = |id: &str| EmergencyStop { v: 1, id: id.to_owned(), source: "a button".to_owned(), reason: "now".to_owned(), stamp_ns: 0 };
    for id in ["a", "b"] {
        arm.emergency_stop(&estop(id));
        let stop = arm.stop().expect("a stop");
        assert_eq!(stop.kind, "estop");
        assert!(
            stop.reason.starts_with("a button: now") && stop.reason.ends_with("before that gripper_failed: the hand does not answer"),
            "{stop:?}"
        );
    }
    let clear = RobotCommand { clear_stop: true, starts_stream: false, clears: arm.stop().cloned(), ..command(1, 1, Vec::new()) };
    arm.command(&clear, 0.0).expect("taken");
    arm.emergency_stop(&estop("c"));
    assert_eq!(arm.stop().map(|stop| stop.reason.as_str()), Some("a button: now"), "what was cleared is over");
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

/// A command of a task that keeps it open, or closes it.
fn task_command(seq: u64, epoch: u64, open: bool) -> RobotCommand {
    let task = Some(Task { id: "t1".to_owned(), open, grasps: None });
    RobotCommand { starts_stream: false, ends_stream: false, task, ..command(seq, epoch, Vec::new()) }
}

#[test]
fn a_commander_that_falls_silent_within_a_task_latches_the_arm_at_rest_and_outside_of_it_does_not() {
    let mut arm = Arm::default();
    arm.command(&task_command(1, 1, true), 0.0).expect("taken");
    run(&mut arm, 10, 0.9);
    assert_eq!((arm.mode(), arm.task()), (RobotMode::Idle, Some("t1")));
    assert_eq!(arm.command(&task_command(1, 1, true), 0.9), Err(Ignored::Passed), "a repeat");
    run(&mut arm, 10, 1.8);
    assert_eq!(arm.mode(), RobotMode::Idle, "its commander is still there");
    run(&mut arm, 1, 1.95);
    let stop = arm.stop().cloned().expect("latched");
    assert!(stop.kind == "commander_silent" && stop.reason.contains("t1"), "{stop:?}");
    assert_eq!(arm.task(), Some("t1"), "the task stays open until somebody clears the stop");
    let mut clear = command(1, 2, Vec::new());
    (clear.clear_stop, clear.starts_stream) = (true, false);
    arm.command(&clear, 2.0).expect("anybody clears");
    assert_eq!((arm.mode(), arm.task()), (RobotMode::Idle, None));

    arm.command(&task_command(2, 2, true), 2.0).expect("taken");
    arm.command(&task_command(3, 2, false), 2.1).expect("closed");
    run(&mut arm, 10, 99.0);
    assert_eq!((arm.mode(), arm.task()), (RobotMode::Idle, None), "silence after a task means nothing");
}

#[test]
fn a_commander_that_falls_silent_after_its_last_set_points_latches_too() {
    let mut arm = Arm::default();
    let whole = RobotCommand { task: task_command(1, 1, true).task, ..command(1, 1, swing(0.5, 1000.0)) };
    arm.command(&whole, 0.0).expect("taken");
    run(&mut arm, 300, 0.3);
    assert_eq!(arm.mode(), RobotMode::Moving);
    run(&mut arm, 900, 1.1);
    assert_eq!(arm.stop().map(|s| s.kind.as_str()), Some("commander_silent"));
    assert!(arm.motion.is_at_rest());
}

#[test]
fn a_task_that_is_closed_with_an_object_in_the_hand_or_on_the_way_latches() {
    for on_the_way in [false, true] {
        let mut arm = Arm::default();
        arm.command(&task_command(1, 1, true), 0.0).expect("taken");
        if on_the_way {
            arm.command(&command(2, 1, swing(0.5, 1000.0)), 0.0).expect("taken");
            run(&mut arm, 300, 0.1);
        } else {
            arm.set_grips(true, 0.1);
        }
        arm.command(&task_command(3, 1, false), 0.2).expect("taken");
        run(&mut arm, 1000, 0.3);
        assert_eq!(arm.stop().map(|s| s.kind.as_str()), Some("task_unfinished"), "{on_the_way}");
        assert!(arm.motion.is_at_rest());
    }
}

#[test]
fn within_a_task_nobody_else_commands_and_no_other_task_opens() {
    let mut arm = Arm::default();
    arm.command(&task_command(1, 1, true), 0.0).expect("taken");
    assert_eq!(arm.command(&task_command(1, 2, true), 0.1), Err(Ignored::OtherTask), "a newer epoch");
    let mut clear = command(1, 2, Vec::new());
    (clear.clear_stop, clear.starts_stream) = (true, false);
    assert_eq!(arm.command(&clear, 0.1), Err(Ignored::OtherTask), "there is no stop to clear");
    let mut other = task_command(2, 1, true);
    other.task = Some(Task { id: "t2".to_owned(), open: true, grasps: None });
    assert_eq!(arm.command(&other, 0.1), Err(Ignored::OtherTask));
    arm.command(&RobotCommand { task: None, ..task_command(3, 1, true) }, 0.1).expect("a command that says nothing of it leaves it open");
    assert_eq!(arm.task(), Some("t1"));
    arm.emergency_stop(&EmergencyStop::read(b"e1"));
    arm.command(&RobotCommand { clears: arm.stop().cloned(), ..clear }, 0.2).expect("a stop is cleared by anybody");
    assert_eq!(arm.task(), None);
}

#[test]
fn what_was_to_be_grasped_is_said_to_be_held_while_the_fingers_find_something() {
    let mut arm = Arm::default();
    let held = HeldObject { scene_id: "s".to_owned(), object: 3, low_m: [-0.01; 3], high_m: [0.02; 3] };
    let mut close = task_command(1, 1, true);
    close.gripper = Some(GripperCommand { width_m: 0.0, force_n: 30.0 });
    close.task.iter_mut().for_each(|task| task.grasps = Some(held.clone()));
    arm.command(&close, 0.0).expect("taken");
    assert_eq!(arm.held(), None, "the fingers are on their way");
    arm.set_grips(true, 0.1);
    arm.command(&task_command(2, 1, true), 0.1).expect("taken");
    assert_eq!(arm.held(), Some(&held));
    let mut open = task_command(3, 1, true);
    open.gripper = Some(GripperCommand { width_m: 0.08, force_n: 30.0 });
    arm.command(&open, 0.2).expect("taken");
    assert_eq!(arm.held(), Some(&held), "the fingers have not moved yet");
    arm.set_grips(false, 0.3);
    assert_eq!(arm.held(), None);
    let close = RobotCommand { gripper: Some(GripperCommand { width_m: 0.0, force_n: 30.0 }), ..task_command(4, 1, true) };
    arm.command(&close, 0.4).expect("taken");
    arm.set_grips(true, 0.5);
    assert_eq!(arm.held(), None, "what they find now nobody has told");
}

#[test]
fn an_object_that_was_to_be_let_go_when_a_stop_latched_is_still_said_to_be_held() {
    let mut arm = Arm::default();
    let held = HeldObject { scene_id: "s".to_owned(), object: 3, low_m: [-0.01; 3], high_m: [0.02; 3] };
    let gripper = |seq, width_m, grasps| RobotCommand {
        gripper: Some(GripperCommand { width_m, force_n: 30.0 }),
        task: Some(Task { id: "t1".to_owned(), open: true, grasps }),
        ..task_command(seq, 1, true)
    };
    arm.command(&gripper(1, 0.0, Some(held.clone())), 0.0).expect("taken");
    arm.set_grips(true, 0.1);
    arm.command(&gripper(2, 0.08, None), 0.2).expect("taken");
    arm.emergency_stop(&EmergencyStop::read(b"e1"));
    assert_eq!((arm.take_gripper(), arm.held()), (None, Some(&held)));
    // A hand that had begun says that it holds nothing while it opens, and that it does once it has left that off.
    arm.set_grips(false, 0.3);
    arm.set_grips(true, 0.4);
    assert_eq!((arm.held(), arm.is_to_grasp()), (Some(&held), false));
}

#[test]
fn how_long_ago_the_hand_took_or_let_go_of_something_is_told_whoever_commanded_it() {
    let mut arm = Arm::default();
    let gripper = |seq, width_m, grasps| RobotCommand {
        gripper: Some(GripperCommand { width_m, force_n: 30.0 }),
        task: Some(Task { id: "t1".to_owned(), open: true, grasps }),
        ..task_command(seq, 1, true)
    };
    arm.command(&gripper(1, 0.08, None), 1.0).expect("taken");
    arm.tick(2.0);
    assert_eq!(arm.since_handling_ms(), None, "an empty hand that opens moves nothing");
    let held = HeldObject { scene_id: "s".to_owned(), object: 3, low_m: [-0.01; 3], high_m: [0.02; 3] };
    arm.command(&gripper(2, 0.0, Some(held)), 3.0).expect("taken");
    arm.tick(3.5);
    assert_eq!(arm.since_handling_ms(), Some(500));
    arm.set_grips(true, 3.5);
    arm.command(&gripper(3, 0.08, None), 8.0).expect("taken");
    arm.tick(8.25);
    assert_eq!(arm.since_handling_ms(), Some(250), "it has let go");
}

#[test]
fn what_the_hand_takes_hold_of_untold_and_what_slips_out_of_it_makes_scenes_old_too() {
    let mut arm = Arm::default();
    let close = RobotCommand { gripper: Some(GripperCommand { width_m: 0.0, force_n: 30.0 }), ..task_command(1, 1, true) };
    arm.command(&close, 1.0).expect("taken");
    arm.tick(1.5);
    assert_eq!(arm.since_handling_ms(), None, "it was not told to grasp anything, and has not");
    arm.set_grips(true, 1.5);
    arm.tick(1.75);
    assert_eq!(arm.since_handling_ms(), Some(250), "it has taken hold of something");
    arm.set_grips(true, 1.75);
    arm.tick(4.0);
    assert_eq!(arm.since_handling_ms(), Some(2500), "it still holds that");
    arm.set_grips(false, 4.0);
    arm.tick(4.5);
    assert_eq!(arm.since_handling_ms(), Some(500), "it has slipped out, and lies where no camera had seen it");
}

#[test]
fn what_was_seen_before_the_world_was_made_anew_is_old() {
    let mut arm = Arm::default();
    arm.tick(5.0);
    assert_eq!(arm.since_handling_ms(), None);
    arm.rehome();
    arm.tick(5.5);
    assert_eq!(arm.since_handling_ms(), Some(500));
}

#[test]
fn an_arm_that_does_not_follow_its_set_points_latches_and_one_that_was_moved_by_hand_stands_there() {
    let mut arm = Arm::new(ArmSettings { following_tolerance_rad: 0.05, ..ArmSettings::default() });
    let mut behind = READY;
    behind[0] -= 0.04;
    arm.measured(&behind);
    assert_eq!(arm.q_rad(), &READY, "a servo's droop is not followed");
    arm.command(&command(1, 1, swing(0.5, 1000.0)), 0.0).expect("taken");
    run(&mut arm, 300, 0.0);
    arm.measured(&behind);
    let stop = arm.stop().cloned().expect("latched");
    assert!(stop.kind == FOLLOWING_ERROR && stop.reason.contains("joint 0"), "{stop:?}");
    arm.measured(&behind);
    assert!(!arm.motion.is_at_rest(), "it brakes first");
    run(&mut arm, 1000, 0.0);
    let mut elsewhere = READY;
    elsewhere[3] += 0.3;
    arm.measured(&elsewhere);
    assert_eq!(arm.q_rad(), &elsewhere);
    elsewhere[3] = f64::NAN;
    arm.measured(&elsewhere);
    assert!(arm.q_rad()[3].is_finite(), "what was not measured is not believed");
    let mut clear = command(2, 1, Vec::new());
    (clear.clear_stop, clear.starts_stream) = (true, false);
    arm.command(&clear, 0.0).expect("taken");
    assert_eq!(arm.mode(), RobotMode::Idle);
}

#[test]
fn the_hand_halts_once_for_every_stop_and_for_that_of_a_driver_that_has_started() {
    let mut arm = Arm::found_at(READY, ArmSettings::default(), 0.0, None);
    assert_eq!([arm.take_hand_halt(), arm.take_hand_halt()], [true, false]);
    arm.emergency_stop(&EmergencyStop::read(b"e1"));
    assert!(!arm.take_hand_halt(), "it was stopped already");
    let mut clear = command(1, 1, Vec::new());
    (clear.clear_stop, clear.starts_stream) = (true, false);
    arm.command(&clear, 0.0).expect("taken");
    assert!(!arm.take_hand_halt());
    arm.emergency_stop(&EmergencyStop::read(b"e2"));
    assert_eq!([arm.take_hand_halt(), arm.take_hand_halt()], [true, false]);
}
