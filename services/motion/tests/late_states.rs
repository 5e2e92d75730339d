//! An execution over a link that loses the robot's states, and by a controller that hears late of what it is to do.

mod common;

use common::{Robot, plan, task};
use repose_motion::execution::{Execution, ExecutionAction, ExecutionSettings};
use repose_proto::motion::{ExecuteReply, ExecutionOutcome};
use repose_proto::robot::Owner;

/// Cancels the first stream after its states have been lost for so long; the arm must not be sent back on its way.
fn cancelled_after(silent_ms: u64) -> ExecuteReply {
    let mut slow = plan();
    slow.phases.iter_mut().flat_map(|phase| &mut phase.set_points).for_each(|point| point.t_ms *= 4.0);
    let mut robot = Robot::new();
    let (mut execution, mut steps) = Execution::begin(slow, task(), &robot.state, 0, ExecutionSettings::default()).unwrap();
    let mut silent_since = None;
    for now_ms in (0..20_000).step_by(10) {
        let before_rad = robot.state.q_rad[0];
        robot.advance();
        assert!(robot.state.q_rad[0] >= before_rad, "back from {before_rad} to {} after {silent_ms} ms", robot.state.q_rad[0]);
        if robot.state.stream_ms.is_some_and(|followed_ms| followed_ms >= 1000.0) {
            let since_ms = *silent_since.get_or_insert(now_ms);
            if now_ms == since_ms + silent_ms {
                steps.extend(execution.cancel("cancelled", now_ms));
            }
        }
        if silent_since.is_none_or(|since_ms| now_ms >= since_ms + silent_ms) {
            steps.extend(execution.on_state(&robot.state, now_ms));
        }
        if now_ms % 50 == 0 {
            steps.extend(execution.on_tick(now_ms));
        }
        for step in steps.drain(..) {
            match step {
                ExecutionAction::Send(command) => robot.take(&command),
                ExecutionAction::Progress(_) => {}
                ExecutionAction::Done(reply) => return reply,
            }
        }
    }
    panic!("the execution never ended");
}

#[test]
fn a_robot_is_not_silent_while_it_is_not_listened_to() {
    let robot = Robot::new();
    let settings = ExecutionSettings::default();
    let (mut execution, _) = Execution::begin(plan(), task(), &robot.state, 0, settings).unwrap();
    let ends = |steps: &[ExecutionAction]| steps.iter().any(|step| matches!(step, ExecutionAction::Done(_)));
    let mut shown = robot.state.clone();
    // It shows that it has taken the first command, and the process stands still until long after it would be taken for silent.
    (shown.owner, shown.last_command) = (Some(Owner { id: task().commander, epoch: 1 }), Some(1));
    shown.gripper_settled = false;
    assert!(!ends(&execution.on_state(&shown, 50)) && !ends(&execution.on_tick(60)));
    assert!(!ends(&execution.on_tick(60_000)), "its states may have come meanwhile, and be read after this");
    // It is missed all the same where it stays silent.
    let missed_ms = (60_050u64..).step_by(50).find(|now_ms| ends(&execution.on_tick(*now_ms))).unwrap();
    assert!(missed_ms <= 60_000 + settings.state_timeout_ms, "{missed_ms}");
}

#[test]
fn an_arm_that_went_on_while_its_states_were_lost_comes_to_rest_ahead_of_where_it_is() {
    for silent_ms in [0, 300, 700] {
        let reply = cancelled_after(silent_ms);
        assert_eq!((reply.outcome, reply.reason.as_deref()), (ExecutionOutcome::Stopped, Some("cancelled")), "{silent_ms} ms");
        // It goes 0.025 rad/s, and 0.25 s further from where it is.
        let farthest_rad = 0.025 * (1.4 + 1e-3 * silent_ms as f64);
        assert!(reply.joints_rad[0] <= farthest_rad, "{} of {farthest_rad} after {silent_ms} ms", reply.joints_rad[0]);
    }
}

/// How far ahead of the arm a cancelled stream begins to slow down, milliseconds.
fn slows_ahead_ms(horizon_ms: Option<u64>) -> f64 {
    let mut robot = Robot::new();
    robot.state.horizon_ms = horizon_ms;
    let (mut execution, mut steps) = Execution::begin(plan(), task(), &robot.state, 0, ExecutionSettings::default()).unwrap();
    for now_ms in (0..20_000).step_by(10) {
        robot.advance();
        steps.extend(execution.on_state(&robot.state, now_ms));
        if let Some(followed_ms) = robot.state.stream_ms.filter(|followed_ms| *followed_ms > 100.0) {
            let halt = execution.cancel("cancelled", now_ms);
            let [ExecutionAction::Send(command)] = &halt[..] else { panic!("{halt:?}") };
            // The plan's set-points are 20 ms apart, those of slowing down are closer.
            let slows = command.set_points.windows(2).find(|pair| pair[1].t_ms - pair[0].t_ms < 15.0).expect("it slows down");
            return slows[1].t_ms - followed_ms;
        }
        for step in steps.drain(..) {
            if let ExecutionAction::Send(command) = step {
                robot.take(&command);
            }
        }
    }
    panic!("it never moved");
}

#[test]
fn a_controller_of_whole_trajectories_is_slowed_down_from_where_it_can_still_be_told() {
    let usual_ms = slows_ahead_ms(None);
    assert!((150.0..180.0).contains(&usual_ms), "{usual_ms} ms");
    let whole_ms = slows_ahead_ms(Some(600_000));
    assert!((400.0..430.0).contains(&whole_ms), "{whole_ms} ms");
}
