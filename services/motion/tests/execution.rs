//! An execution against a robot that follows its set-points, and against one that does not.

mod common;

use std::collections::VecDeque;

use common::{NOW_NS, PHASES, Robot, joints, plan, task};
use repose_motion::execution::{Execution, ExecutionAction, ExecutionSettings, ExecutionTask};
use repose_proto::motion::{ExecutionOutcome, MotionPhase, MotionPlan, Phase};
use repose_proto::robot::{HeldObject, Owner, RobotMode, RobotState, StopState, TaskState};
use repose_proto::{ErrorCode, RigidTransform, limits};

/// Runs to the end; what was told on the way, and the last step.
fn run(robot: &mut Robot, meddle: impl FnMut(&mut Robot, &mut Execution, u64) -> Vec<ExecutionAction>) -> (Vec<Phase>, ExecutionAction) {
    run_late(robot, plan(), 0, meddle)
}

/// The same with a plan, on states that are late.
fn run_late(
    robot: &mut Robot,
    plan: MotionPlan,
    late_ms: usize,
    mut meddle: impl FnMut(&mut Robot, &mut Execution, u64) -> Vec<ExecutionAction>,
) -> (Vec<Phase>, ExecutionAction) {
    let (mut execution, mut steps) = Execution::begin(plan, task(), &robot.state, 0, ExecutionSettings::default()).unwrap();
    let (mut phases, mut shown) = (Vec::new(), VecDeque::new());
    for now_ms in (0..60_000).step_by(10) {
        robot.advance();
        steps.extend(meddle(robot, &mut execution, now_ms));
        if !robot.deaf {
            shown.push_back(robot.state.clone());
        }
        if shown.len() > late_ms / 10
            && let Some(state) = shown.pop_front()
        {
            steps.extend(execution.on_state(&state, now_ms));
        }
        if now_ms % 50 == 0 {
            steps.extend(execution.on_tick(now_ms));
        }
        for step in steps.drain(..) {
            match step {
                ExecutionAction::Send(command) => robot.take(&command),
                ExecutionAction::Progress(progress) => phases.push(progress.phase),
                done @ ExecutionAction::Done(_) => return (phases, done),
            }
        }
    }
    panic!("the execution never ended; phases {phases:?}");
}

fn outcome(step: &ExecutionAction) -> (ExecutionOutcome, Phase, String) {
    let ExecutionAction::Done(reply) = step else { panic!("{step:?}") };
    (reply.outcome, reply.phase, reply.reason.clone().unwrap_or_default())
}

#[test]
fn a_robot_that_follows_runs_through_all_phases() {
    let mut robot = Robot::new();
    let (phases, done) = run(&mut robot, |_, _, _| Vec::new());
    assert_eq!(phases, PHASES);
    assert_eq!(outcome(&done), (ExecutionOutcome::Done, Phase::Retreat, String::new()));
    assert!((robot.state.q_rad[0] - 0.0).abs() < 1e-9, "six moves to and fro");
    assert_eq!(robot.state.open_task(), None, "the task is closed");
}

#[test]
fn phases_that_ask_for_nothing_are_passed_over_however_many_they_are() {
    let nothing = MotionPhase { name: Phase::Lift, gripper: None, set_points: Vec::new() };
    let mut long = plan();
    long.phases.splice(1..1, std::iter::repeat_n(nothing, 200_000));
    let (phases, done) = run_late(&mut Robot::new(), long, 0, |_, _, _| Vec::new());
    assert_eq!((phases.as_slice(), outcome(&done).0), (&PHASES[..], ExecutionOutcome::Done), "{done:?}");
}

#[test]
fn the_task_is_open_and_kept_alive_from_the_first_command_to_the_last() {
    let mut robot = Robot::new();
    robot.heeds_ttl = true;
    let (mut open, mut grasped) = (Vec::new(), None);
    let grasps = HeldObject { scene_id: "0".repeat(64), object: 1, low_m: [-0.02; 3], high_m: [0.02; 3] };
    let named = ExecutionTask { grasps: Some(grasps.clone()), ..task() };
    let (mut execution, mut steps) = Execution::begin(plan(), named, &robot.state, 0, ExecutionSettings::default()).unwrap();
    'run: for now_ms in (0..60_000).step_by(10) {
        robot.advance();
        open.push(robot.state.open_task().map(str::to_owned));
        grasped = grasped.or_else(|| robot.grasps.clone());
        // Fingers that take their time: nothing but the task's keeping alive is sent meanwhile.
        robot.state.gripper_settled = robot.state.robot_ms % 2000.0 < 200.0;
        steps.extend(execution.on_state(&robot.state, now_ms));
        if now_ms % 50 == 0 {
            steps.extend(execution.on_tick(now_ms));
        }
        for step in steps.drain(..) {
            match step {
                ExecutionAction::Send(command) => robot.take(&command),
                ExecutionAction::Progress(_) => {}
                ExecutionAction::Done(reply) => {
                    assert_eq!(reply.outcome, ExecutionOutcome::Done, "{reply:?}");
                    break 'run;
                }
            }
        }
    }
    assert_eq!(grasped, Some(grasps));
    let kept = open[1..].iter().take_while(|task| task.as_deref() == Some("t1")).count();
    assert!(kept + 3 > open.len(), "open for {kept} of {} states", open.len());
    assert_eq!(robot.state.open_task(), None);
}

#[test]
fn a_robot_that_knows_no_tasks_is_told_of_none() {
    let mut robot = Robot::new();
    robot.state.task = None;
    let (_, done) = run(&mut robot, |_, _, _| Vec::new());
    assert_eq!((outcome(&done).0, robot.state.task), (ExecutionOutcome::Done, None));
}

#[test]
fn a_cancel_with_an_object_in_the_hand_ends_in_a_latched_stop() {
    for phase in [Phase::Grasp, Phase::Transfer] {
        let mut robot = Robot::new();
        let mut since_ms = None;
        let (_, done) = run(&mut robot, |robot, execution, now_ms| {
            let is_in_it = match phase {
                Phase::Grasp => robot.state.gripper_holding,
                _ => robot.state.gripper_holding && robot.state.mode == RobotMode::Moving,
            };
            if !is_in_it || since_ms.is_some() {
                return Vec::new();
            }
            since_ms = Some(now_ms);
            execution.cancel("cancelled", now_ms)
        });
        assert!(since_ms.is_some());
        assert_eq!((outcome(&done).0, robot.state.mode), (ExecutionOutcome::Stopped, RobotMode::Stopped), "{done:?}");
        let reason = outcome(&done).2;
        assert!(reason.contains("cancelled") && reason.contains("task_unfinished"), "{reason}");
    }
}

#[test]
fn a_state_that_is_late_starts_nothing_twice_and_is_no_silence() {
    let mut slow = plan();
    slow.phases.iter_mut().flat_map(|phase| &mut phase.set_points).for_each(|point| point.t_ms *= 3.0);
    let mut robot = Robot::new();
    robot.heeds_ttl = true;
    let (phases, done) = run_late(&mut robot, slow, 500, |_, _, _| Vec::new());
    assert_eq!(phases, PHASES);
    assert_eq!(outcome(&done).0, ExecutionOutcome::Done, "{done:?}");
}

#[test]
fn an_arm_that_stands_beside_the_end_of_a_phase_is_not_sent_on() {
    let mut robot = Robot::new();
    let (phases, done) = run(&mut robot, |robot, _, _| {
        if robot.state.robot_ms > 900.0 && robot.state.mode == RobotMode::Idle {
            robot.state.q_rad[1] = -0.695;
        }
        Vec::new()
    });
    assert_eq!((phases.len(), outcome(&done).0), (1, ExecutionOutcome::Stopped));
    assert!(outcome(&done).2.contains("did not follow"), "{done:?}");
}

#[test]
fn a_hand_that_is_held_up_on_its_way_to_the_object_has_not_grasped_it() {
    let mut robot = Robot::new();
    let (_, done) = run(&mut robot, |robot, _, _| {
        if robot.state.robot_ms > 1800.0 && robot.state.mode == RobotMode::Idle && !robot.state.gripper_holding {
            robot.state.q_rad[1] = -0.695;
        }
        Vec::new()
    });
    assert_eq!((outcome(&done).0, outcome(&done).1), (ExecutionOutcome::GraspLost, Phase::Approach), "{done:?}");
}

#[test]
fn fingers_that_close_on_nothing_end_it_at_the_grasp() {
    let mut robot = Robot::new();
    robot.holds = false;
    let (_, done) = run(&mut robot, |_, _, _| Vec::new());
    assert_eq!((outcome(&done).0, outcome(&done).1), (ExecutionOutcome::GraspLost, Phase::Grasp));
}

#[test]
fn fingers_that_say_that_they_have_settled_are_believed_where_they_were_sent_and_nowhere_else() {
    // An action is refused, and they say that they have settled: narrow they would be driven onto the object, wide they would have nothing, and closed
    // they would drag it along.
    for (refuses, phase, stand) in [(1, Phase::Standoff, "0.020"), (2, Phase::Grasp, "0.050"), (3, Phase::Release, "0.030")] {
        let mut robot = Robot::new();
        (robot.state.gripper_width_m, robot.refuses) = (0.02, refuses);
        let (phases, done) = run(&mut robot, |_, _, _| Vec::new());
        assert_eq!((phases.last(), outcome(&done).0), (Some(&phase), ExecutionOutcome::Stopped), "{done:?}");
        assert!(outcome(&done).2.contains(&format!("stands at {stand} m")), "{done:?}");
    }
}

#[test]
fn fingers_that_begin_late_are_waited_for() {
    for refuses in 1..=3 {
        let mut robot = Robot::new();
        robot.refuses = refuses;
        let mut since_ms = None;
        let (phases, done) = run(&mut robot, |robot, _, now_ms| {
            if let Some(gripper) = robot.refused
                && now_ms >= *since_ms.get_or_insert(now_ms) + 400
            {
                robot.act(gripper);
                robot.refused = None;
            }
            Vec::new()
        });
        assert_eq!((phases.as_slice(), outcome(&done).0), (&PHASES[..], ExecutionOutcome::Done), "{done:?}");
    }
}

#[test]
fn fingers_that_are_still_on_their_way_after_all_the_time_that_they_have_stop_the_execution() {
    for cancelled in [false, true] {
        let mut robot = Robot::new();
        robot.refuses = 2;
        let (phases, done) = run(&mut robot, |robot, execution, now_ms| {
            if robot.refused.is_none() {
                return Vec::new();
            }
            // Ten millimetres a second, from fifty on.
            robot.state.gripper_settled = false;
            robot.state.gripper_width_m -= 0.0001;
            if cancelled { execution.cancel("cancelled", now_ms) } else { Vec::new() }
        });
        assert_eq!((phases.last(), outcome(&done).0), (Some(&Phase::Grasp), ExecutionOutcome::Stopped), "{done:?}");
        assert!(outcome(&done).2.contains(if cancelled { "cancelled" } else { "gripper_timeout_ms" }), "{done:?}");
        assert!(robot.state.open_task().is_some(), "the robot's side latches a stop then: they may close on something yet");
    }
}

#[test]
fn a_task_is_not_closed_where_the_hand_does_not_get_through_with_letting_go() {
    for cancelled in [false, true] {
        let mut robot = Robot::new();
        robot.refuses = 3;
        let (phases, done) = run(&mut robot, |robot, execution, now_ms| {
            if robot.refused.is_none() {
                return Vec::new();
            }
            // A hand that has not ended an order says neither that it has settled nor that it holds anything.
            (robot.state.gripper_settled, robot.state.gripper_holding) = (false, false);
            if cancelled { execution.cancel("cancelled", now_ms) } else { Vec::new() }
        });
        assert_eq!((phases.last(), outcome(&done).0), (Some(&Phase::Release), ExecutionOutcome::Stopped), "{done:?}");
        assert!(robot.state.open_task().is_some(), "the robot's side latches a stop then: the object is in the hand");
    }
}

#[test]
fn a_task_is_not_closed_on_the_way_where_the_hand_does_not_say_whether_it_holds_the_object() {
    let mut robot = Robot::new();
    let mut is_carrying = false;
    let (phases, done) = run(&mut robot, |robot, execution, now_ms| {
        let begins = robot.state.gripper_holding && robot.state.mode == RobotMode::Moving;
        is_carrying |= begins;
        if is_carrying {
            // Fingers that press and tremble: neither settled nor, for the robot's side, holding.
            (robot.state.gripper_settled, robot.state.gripper_holding) = (false, false);
        }
        if begins { execution.cancel("cancelled", now_ms) } else { Vec::new() }
    });
    assert!(phases.last().is_some_and(|phase| phase.is_carrying()), "{phases:?}");
    assert_eq!((outcome(&done).0, outcome(&done).2.as_str()), (ExecutionOutcome::Stopped, "cancelled"), "{done:?}");
    assert!(robot.state.open_task().is_some(), "the robot's side latches a stop then: the object may be in the hand");
}

#[test]
fn an_object_lost_on_the_way_is_noticed_at_the_end_of_the_phase() {
    let mut robot = Robot::new();
    let (phases, done) = run(&mut robot, |robot, _, _| {
        if robot.state.robot_ms > 3800.0 {
            robot.state.gripper_holding = false;
            robot.state.gripper_width_m = 0.0;
        }
        Vec::new()
    });
    assert_eq!((outcome(&done).0, outcome(&done).1), (ExecutionOutcome::GraspLost, Phase::Transfer), "{phases:?}");
}

#[test]
fn an_object_that_slips_and_is_held_again_is_carried_on() {
    let (mut robot, mut stood) = (Robot::new(), 0);
    let (phases, done) = run(&mut robot, |robot, _, _| {
        stood += usize::from(robot.state.mode == RobotMode::Idle && !robot.state.gripper_settled);
        if robot.state.gripper_width_m == 0.03 && robot.state.robot_ms > 3000.0 {
            // It turns between the fingers as the arm comes to rest, …
            robot.state.gripper_width_m = 0.012;
            (robot.state.gripper_holding, robot.state.gripper_settled) = (false, false);
        }
        if robot.state.gripper_width_m == 0.012 && robot.state.mode == RobotMode::Idle && robot.state.robot_ms > 4500.0 {
            // … and they stand against it again.
            (robot.state.gripper_holding, robot.state.gripper_settled) = (true, true);
        }
        Vec::new()
    });
    assert!(stood > 10, "the arm waited for the fingers: {stood}");
    assert_eq!(phases, PHASES);
    assert_eq!(outcome(&done), (ExecutionOutcome::Done, Phase::Retreat, String::new()));
}

#[test]
fn a_latched_stop_ends_it_with_the_reason() {
    let mut robot = Robot::new();
    let (_, done) = run(&mut robot, |robot, _, _| {
        if robot.state.robot_ms > 700.0 {
            robot.state.mode = RobotMode::Stopped;
            robot.state.stop = Some(StopState { kind: "estop".to_owned(), reason: "button".to_owned(), estop_id: None });
        }
        Vec::new()
    });
    assert_eq!(outcome(&done), (ExecutionOutcome::Stopped, Phase::Standoff, "estop: button".to_owned()));
}

#[test]
fn another_owner_ends_it() {
    let mut robot = Robot::new();
    let (_, done) = run(&mut robot, |robot, _, _| {
        if robot.state.robot_ms > 700.0 {
            robot.state.owner = Some(Owner { id: "motion-2".to_owned(), epoch: 2 });
        }
        Vec::new()
    });
    assert!(outcome(&done).2.contains("motion-2"));
}

#[test]
fn a_robots_side_that_starts_anew_ends_it_and_is_not_sent_what_the_one_before_took() {
    let mut robot = Robot::new();
    let (phases, done) = run(&mut robot, |robot, _, now_ms| {
        if now_ms == 300 {
            assert_eq!(robot.state.mode, RobotMode::Moving);
            *robot = Robot::new();
        }
        Vec::new()
    });
    assert_eq!((phases.as_slice(), outcome(&done).0), (&[Phase::Standoff][..], ExecutionOutcome::Stopped), "{done:?}");
    assert!(outcome(&done).2.contains("started anew"), "{done:?}");
    assert_eq!(robot.state.owner, None, "nothing was sent");
}

#[test]
fn a_silent_robot_and_a_deaf_one_end_it() {
    let mut robot = Robot::new();
    let (_, done) = run(&mut robot, |robot, _, _| {
        robot.deaf = robot.state.robot_ms > 700.0;
        Vec::new()
    });
    assert!(outcome(&done).2.contains("silent"));

    let mut robot = Robot::new();
    let (_, done) = run(&mut robot, |robot, execution, now_ms| {
        robot.deaf = true;
        execution.on_state(&robot.state.clone(), now_ms)
    });
    assert!(outcome(&done).2.contains("does not take commands"));
}

#[test]
fn a_cancelled_motion_slows_down_on_its_path_and_leaves_the_robot_ready() {
    let mut robot = Robot::new();
    let mut cancelled_at = None;
    let (phases, done) = run(&mut robot, |robot, execution, now_ms| {
        if robot.state.robot_ms < 900.0 || robot.state.mode != RobotMode::Moving || cancelled_at.is_some() {
            return Vec::new();
        }
        cancelled_at = Some(now_ms);
        let steps = execution.cancel("cancelled", now_ms);
        assert!(execution.cancel("again", now_ms).is_empty(), "it is cancelled once");
        steps
    });
    assert!(cancelled_at.is_some());
    assert_eq!(outcome(&done), (ExecutionOutcome::Stopped, phases[phases.len() - 1], "cancelled".to_owned()));
    assert_eq!((robot.state.mode, robot.state.stop), (RobotMode::Idle, None));
    assert!(robot.state.q_rad[0] > 0.0 && robot.state.q_rad[0] < 0.1 + 1e-9, "between its start and its end: {}", robot.state.q_rad[0]);
}

#[test]
fn a_robot_that_needs_whole_streams_gets_each_at_once_and_then_signs_of_life_only() {
    let mut robot = Robot::new();
    robot.state.horizon_ms = Some(600_000);
    let (mut execution, mut steps) = Execution::begin(plan(), task(), &robot.state, 0, ExecutionSettings::default()).unwrap();
    let (mut streams, mut again) = (0, 0);
    for now_ms in (0..60_000).step_by(10) {
        robot.advance();
        steps.extend(execution.on_state(&robot.state, now_ms));
        if now_ms % 50 == 0 {
            steps.extend(execution.on_tick(now_ms));
        }
        for step in steps.drain(..) {
            match step {
                ExecutionAction::Send(command) => {
                    assert!(!command.starts_stream || command.ends_stream, "a stream that does not come whole");
                    streams += usize::from(command.starts_stream);
                    again += usize::from(!command.starts_stream && !command.set_points.is_empty());
                    robot.take(&command);
                }
                ExecutionAction::Progress(_) => {}
                ExecutionAction::Done(reply) => {
                    assert_eq!((reply.outcome, again), (ExecutionOutcome::Done, 0));
                    assert!(streams >= 4, "{streams} streams");
                    return;
                }
            }
        }
    }
    panic!("the execution never ended");
}

#[test]
fn a_cancel_while_the_fingers_open_waits_for_them_and_a_lost_network_ends_it_at_once() {
    for lost in [false, true] {
        let mut robot = Robot::new();
        let mut settled_at = None;
        let (phases, done) = run(&mut robot, |robot, execution, now_ms| {
            robot.state.gripper_settled = robot.state.robot_ms > 500.0;
            if now_ms != 200 {
                settled_at = settled_at.or(robot.state.gripper_settled.then_some(now_ms));
                return Vec::new();
            }
            let steps = if lost { execution.abandon("the network closed") } else { execution.cancel("cancelled", now_ms) };
            assert_eq!(steps.is_empty(), !lost, "{steps:?}");
            if lost {
                assert!(execution.on_tick(now_ms).is_empty() && execution.on_state(&robot.state, now_ms).is_empty(), "nothing afterwards");
            }
            steps
        });
        assert_eq!((phases.as_slice(), outcome(&done).0), (&[Phase::Standoff][..], ExecutionOutcome::Stopped));
        assert_eq!(settled_at.is_some(), !lost);
        assert_eq!(robot.state.mode, RobotMode::Idle, "there is nothing in the hand");
    }
}

#[test]
fn fingers_that_were_not_told_before_a_cancel_are_not_told_after_it() {
    let mut robot = Robot::new();
    robot.deaf = true;
    let (phases, done) = run(&mut robot, |robot, execution, now_ms| {
        robot.deaf = now_ms < 200;
        if now_ms == 100 { execution.cancel("cancelled", now_ms) } else { Vec::new() }
    });
    assert_eq!((phases.as_slice(), outcome(&done).0), (&[Phase::Standoff][..], ExecutionOutcome::Stopped), "{done:?}");
    assert_eq!((outcome(&done).2.as_str(), robot.actions), ("cancelled", 0));
    assert_eq!((robot.state.mode, robot.state.open_task()), (RobotMode::Idle, None));
}

#[test]
fn a_plan_that_does_not_fit_the_world_is_refused() {
    let begin = |plan: MotionPlan, state: &RobotState| {
        Execution::begin(plan, task(), state, 0, ExecutionSettings::default()).map(|_| ()).unwrap_err()
    };
    let idle = Robot::new().state;
    let refused = |error: repose_proto::CallError, field: &str| {
        assert_eq!((error.code, error.field.as_deref()), (ErrorCode::FailedPrecondition, Some(field)));
    };
    refused(begin(plan(), &RobotState { mode: RobotMode::Stopped, ..idle.clone() }), "robot");
    refused(begin(plan(), &RobotState { mode: RobotMode::Moving, ..idle.clone() }), "robot");
    refused(begin(plan(), &RobotState { gripper_holding: true, ..idle.clone() }), "robot");
    let busy = Some(TaskState { id: Some("another".to_owned()) });
    refused(begin(plan(), &RobotState { task: busy, ..idle.clone() }), "robot");
    refused(begin(plan(), &RobotState { q_rad: joints(0.05), ..idle.clone() }), "start_joints_rad");
    refused(
        begin(MotionPlan { start_tolerance_rad: 0.2, ..plan() }, &RobotState { q_rad: joints(0.005), ..idle.clone() }),
        "start_joints_rad",
    );
    let last = Owner { id: "motion-9".to_owned(), epoch: limits::MAX_EPOCH };
    refused(begin(plan(), &RobotState { owner: Some(last), ..idle.clone() }), "robot");
    refused(begin(MotionPlan { max_scene_age_ms: 500, ..plan() }, &idle), "scene_stamp_ns");
    refused(begin(MotionPlan { scene_stamp_ns: NOW_NS + 5_000_000_000, ..plan() }, &idle), "scene_stamp_ns");
    let base = |x_m: f64| RobotState {
        world_from_base: Some(RigidTransform([1.0, 0.0, 0.0, x_m, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0])),
        ..idle.clone()
    };
    refused(begin(plan(), &base(0.4)), "robot");
    let from_there = ExecutionSettings { world_from_base: nalgebra::Isometry3::translation(0.4, 0.0, 0.0), ..ExecutionSettings::default() };
    assert!(Execution::begin(plan(), task(), &base(0.4), 0, from_there).is_ok());
    refused(Execution::from_here(plan().phases, task(), &base(0.0), 0, from_there).map(|_| ()).unwrap_err(), "robot");
    let mut torn = plan();
    torn.phases[1].set_points.iter_mut().for_each(|p| p.q_rad[0] += 0.5);
    assert_eq!(begin(torn, &idle).code, ErrorCode::InvalidArgument);
}

#[test]
fn what_was_seen_before_the_robot_took_or_put_something_is_not_carried_out() {
    // Seen ten seconds ago, which is young enough.
    let plan = MotionPlan { scene_stamp_ns: NOW_NS - 10_000_000_000, max_scene_age_ms: 60_000, ..plan() };
    let begin = |since_handling_ms| {
        let state = RobotState { since_handling_ms, ..Robot::new().state };
        Execution::begin(plan.clone(), task(), &state, 0, ExecutionSettings::default()).map(|_| ())
    };
    assert_eq!(begin(None), Ok(()), "the hand has not moved anything yet");
    assert_eq!(begin(Some(20_000)), Ok(()), "the scene shows what it did");
    // A moment before: clocks of camera and motion may differ by as much.
    assert_eq!(begin(Some(9_000)), Ok(()));
    let error = begin(Some(3_000)).unwrap_err();
    assert_eq!((error.code, error.field.as_deref()), (ErrorCode::FailedPrecondition, Some("scene_stamp_ns")));
}
