//! Goals of the hand's controller.

use repose_proto::robot::{EmergencyStop, GripperCommand, RobotMode, Task};
use repose_ros_messages::{GripperCommandResult, status};

use super::trial::{Trial, config};
use crate::robot::events::{Do, HandTold};

/// Whether the hand has settled, and whether it holds something.
fn gripper(trial: &mut Trial) -> (bool, bool) {
    let state = trial.side.state(trial.now_ms, 0).expect("a state");
    (state.gripper_settled, state.gripper_holding)
}

/// The hand opens, as its goal 2: nothing is stopped by that, and nothing is in it any more.
fn opens(trial: &mut Trial) {
    trial.command(|command| command.gripper = Some(GripperCommand { width_m: 0.08, force_n: 30.0 }));
    trial.run(8);
    trial.fingers_m = 0.04;
    trial.run(8);
    let reached = GripperCommandResult { position: 0.04, reached_goal: true, ..GripperCommandResult::default() };
    trial.side.told_by_hand(HandTold::Ended(2, status::SUCCEEDED, reached), trial.now_ms);
    trial.run(8);
    assert_eq!((gripper(trial), trial.stop_kind()), ((true, false), None));
}

/// A trial whose hand was just sent to close, as its goal 1.
fn gripping() -> Trial {
    let mut trial = Trial::new(true);
    trial.command(|command| command.gripper = Some(GripperCommand { width_m: 0.02, force_n: 30.0 }));
    trial.run(8);
    trial
}

#[test]
fn the_hand_closes_and_holds_what_stalls_it() {
    let mut trial = Trial::new(true);
    trial.command(|command| {
        command.gripper = Some(GripperCommand { width_m: 0.02, force_n: 30.0 });
        command.task = Some(Task { id: "t1".to_owned(), open: true, grasps: None });
    });
    trial.run(8);
    assert_eq!(trial.done(), [Do::Grip(1, 0.01, 30.0)]);
    assert!(!trial.side.state(trial.now_ms, 0).expect("a state").gripper_settled);
    trial.fingers_m = 0.03;
    let stalled = GripperCommandResult { position: 0.03, effort: 30.0, stalled: true, reached_goal: false };
    trial.side.told_by_hand(HandTold::Ended(1, status::SUCCEEDED, stalled), trial.now_ms);
    trial.run(8);
    let state = trial.side.state(trial.now_ms, 0).expect("a state");
    assert!(state.gripper_settled && state.gripper_holding && (state.gripper_width_m - 0.06).abs() < 1e-9);
}

#[test]
fn a_stop_cancels_the_hand_until_its_goal_ends_unless_something_is_between_its_fingers() {
    for stalls in [false, true] {
        let mut trial = gripping();
        assert_eq!(trial.done(), [Do::Grip(1, 0.01, 30.0)]);
        if stalls {
            trial.side.told_by_hand(HandTold::Stalled(1), trial.now_ms);
        }
        trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
        trial.run(400);
        assert_eq!(trial.done_of_own(), vec![Do::CancelGrip(1); if stalls { 0 } else { 2 }]);
        assert_eq!(trial.stop_kind().as_deref(), Some("estop"));
        trial.side.told_by_hand(HandTold::Ended(1, status::CANCELED, GripperCommandResult::default()), trial.now_ms);
        trial.run(400);
        assert_eq!((trial.done_of_own(), trial.stop_kind().as_deref()), (Vec::new(), Some("estop")));
        trial.hears_of_nothing_of_others();
        assert!(trial.clears());
    }
}

#[test]
fn what_a_stop_keeps_a_hand_from_letting_go_of_is_in_it_still() {
    let mut trial = gripping();
    trial.fingers_m = 0.03;
    let stalled = GripperCommandResult { position: 0.03, effort: 30.0, stalled: true, reached_goal: false };
    trial.side.told_by_hand(HandTold::Ended(1, status::SUCCEEDED, stalled), trial.now_ms);
    trial.run(8);
    trial.command(|command| command.gripper = Some(GripperCommand { width_m: 0.08, force_n: 30.0 }));
    trial.run(8);
    trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
    trial.run(8);
    trial.side.told_by_hand(HandTold::Ended(2, status::CANCELED, GripperCommandResult::default()), trial.now_ms);
    trial.run(8);
    let state = trial.side.state(trial.now_ms, 0).expect("a state");
    assert!(state.gripper_settled && state.gripper_holding, "{state:?}");
}

#[test]
fn what_the_fingers_have_met_before_a_stop_cancels_them_is_held_until_the_hand_opens() {
    let mut trial = gripping();
    trial.fingers_m = 0.02;
    trial.run(8);
    trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
    trial.run(8);
    assert_eq!(gripper(&mut trial), (false, true), "the controller may have closed it already");
    let canceled = GripperCommandResult { position: 0.02, ..GripperCommandResult::default() };
    trial.side.told_by_hand(HandTold::Ended(1, status::CANCELED, canceled), trial.now_ms);
    trial.run(8);
    assert_eq!(gripper(&mut trial), (true, true));
    trial.hears_of_nothing_of_others();
    assert!(trial.clears());
    assert_eq!(gripper(&mut trial), (true, true), "clearing the stop does not empty it");
    opens(&mut trial);
}

#[test]
fn what_a_goal_of_the_hand_may_have_closed_on_whose_end_nobody_tells_is_held_until_the_hand_opens() {
    for says_it_is_over in [true, false] {
        let mut trial = gripping();
        trial.side.told_by_hand(HandTold::Lost(1, "no answer within 2000 ms".to_owned()), trial.now_ms);
        trial.fingers_m = 0.02;
        trial.run(2400);
        if says_it_is_over {
            trial.side.told_by_hand(HandTold::NotThere(1), trial.now_ms);
        }
        trial.run(400);
        assert_eq!(gripper(&mut trial), (says_it_is_over, true));
        assert!(trial.clears());
        trial.run(400);
        assert_eq!(gripper(&mut trial), (says_it_is_over, true), "clearing the stop does not empty it");
        opens(&mut trial);
    }
}

#[test]
fn a_goal_of_the_hand_that_nobody_knows_to_be_over_is_canceled_on_after_the_stop() {
    let mut trial = gripping();
    trial.done();
    trial.side.told_by_hand(HandTold::Lost(1, "no answer within 2000 ms".to_owned()), trial.now_ms);
    trial.run(8);
    assert_eq!(trial.done(), [Do::CancelGrip(1)]);
    assert!(trial.clears());
    trial.run(500);
    assert_eq!((trial.done(), trial.mode()), (vec![Do::CancelGrip(1); 2], RobotMode::Idle));
    trial.side.told_by_hand(HandTold::Ended(1, status::CANCELED, GripperCommandResult::default()), trial.now_ms);
    trial.run(400);
    assert!(trial.done().is_empty());
}

#[test]
fn a_goal_of_the_hand_that_fails_latches_a_stop_and_one_that_something_stalls_does_not() {
    let short = GripperCommandResult { position: 0.03, ..GripperCommandResult::default() };
    let stalled = GripperCommandResult { stalled: true, ..short };
    for (told, stop) in [
        (HandTold::Refused(1, "it refused the goal".to_owned()), Some("gripper_failed")),
        (HandTold::Lost(1, "it does not answer".to_owned()), Some("gripper_failed")),
        (HandTold::Ended(1, status::ABORTED, short), Some("gripper_failed")),
        (HandTold::Ended(1, status::ABORTED, stalled), None),
        // It was to grasp, and nothing was there.
        (HandTold::Ended(1, status::ABORTED, GripperCommandResult { position: 0.01, ..short }), None),
        (HandTold::Ended(1, status::SUCCEEDED, short), None),
        (HandTold::Refused(7, "another goal".to_owned()), None),
    ] {
        let mut trial = gripping();
        trial.side.told_by_hand(told.clone(), trial.now_ms);
        assert_eq!(trial.stop_kind().as_deref(), stop, "{told:?}");
    }
}

#[test]
fn a_goal_of_the_hand_that_a_stop_has_canceled_is_no_failure_when_it_ends_late() {
    let mut trial = gripping();
    trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
    trial.hears_of_nothing_of_others();
    assert!(trial.clears());
    trial.side.told_by_hand(HandTold::Ended(1, status::CANCELED, GripperCommandResult::default()), trial.now_ms);
    assert_eq!((trial.stop_kind(), trial.mode()), (None, RobotMode::Idle));
}

#[test]
fn a_goal_that_the_hands_controller_may_have_taken_without_a_word_is_canceled_until_it_is_known_to_be_over() {
    let mut trial = gripping();
    trial.done();
    trial.side.told_by_hand(HandTold::Lost(1, "no answer within 2000 ms".to_owned()), trial.now_ms);
    trial.run(400);
    assert_eq!((trial.done(), trial.stop_kind().as_deref()), (vec![Do::CancelGrip(1); 2], Some("gripper_failed")));
    trial.side.told_by_hand(HandTold::NotThere(1), trial.now_ms);
    trial.run(2000);
    assert_eq!(trial.done(), vec![Do::CancelGrip(1); 8], "it may come late");
    trial.side.told_by_hand(HandTold::NotThere(1), trial.now_ms);
    trial.run(400);
    assert!(trial.done().is_empty());
    assert!(trial.side.state(trial.now_ms, 0).expect("a state").gripper_settled);
}

#[test]
fn a_controller_that_has_ended_a_goal_of_the_hand_tells_so_by_its_result_and_not_by_a_cancel() {
    let mut trial = gripping();
    trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
    trial.run(4000);
    trial.side.told_by_hand(HandTold::NotThere(1), trial.now_ms);
    assert!(!trial.side.state(trial.now_ms, 0).expect("a state").gripper_settled, "its result is on the way");
}

#[test]
fn what_is_thinner_than_the_controllers_tolerance_is_held_once_the_fingers_have_closed_on_it() {
    let mut trial = Trial::new(true);
    trial.command(|command| command.gripper = Some(GripperCommand { width_m: 0.0, force_n: 30.0 }));
    trial.run(8);
    // Within 10 mm of its position it takes the finger to have arrived: 20 mm of opening.
    let reached = GripperCommandResult { position: 0.0099, reached_goal: true, ..GripperCommandResult::default() };
    trial.side.told_by_hand(HandTold::Ended(1, status::SUCCEEDED, reached), trial.now_ms);
    for fingers_m in [0.0099, 0.009, 0.008, 0.007, 0.006] {
        trial.fingers_m = fingers_m;
        trial.run(100);
        assert_eq!(gripper(&mut trial), (false, false), "at {fingers_m}: they are still closing");
    }
    trial.run(300);
    assert_eq!(gripper(&mut trial), (true, true));
}

#[test]
fn fingers_that_close_on_nothing_within_the_controllers_tolerance_have_settled_when_they_are_there() {
    let mut trial = gripping();
    let reached = GripperCommandResult { position: 0.0199, reached_goal: true, ..GripperCommandResult::default() };
    trial.side.told_by_hand(HandTold::Ended(1, status::SUCCEEDED, reached), trial.now_ms);
    for (fingers_m, settled) in [(0.0199, false), (0.015, false), (0.0105, true)] {
        trial.fingers_m = fingers_m;
        trial.run(8);
        let state = trial.side.state(trial.now_ms, 0).expect("a state");
        assert_eq!((state.gripper_settled, state.gripper_holding), (settled, false), "at {fingers_m}");
    }
}

#[test]
fn what_is_in_the_hand_when_a_bridge_starts_is_held_until_the_hand_has_opened() {
    let mut trial = Trial::started(config(true));
    trial.fingers_m = 0.025;
    trial.hears_of_nothing_of_others();
    assert!(trial.side.state(trial.now_ms, 0).expect("a state").gripper_holding);
    assert!(trial.clears());
    trial.command(|command| command.gripper = Some(GripperCommand { width_m: 0.08, force_n: 30.0 }));
    trial.run(8);
    trial.fingers_m = 0.04;
    trial.run(8);
    let reached = GripperCommandResult { position: 0.04, reached_goal: true, ..GripperCommandResult::default() };
    trial.side.told_by_hand(HandTold::Ended(1, status::SUCCEEDED, reached), trial.now_ms);
    trial.run(8);
    assert!(!trial.side.state(trial.now_ms, 0).expect("a state").gripper_holding);
    trial.fingers_m = 0.025;
    trial.run(8);
    assert!(!trial.side.state(trial.now_ms, 0).expect("a state").gripper_holding, "nothing was told to close on it");
}
