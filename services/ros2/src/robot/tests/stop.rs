//! Goals of the arm's controller that end, or do not, because they are canceled.

use repose_panda::READY;
use repose_proto::robot::{EmergencyStop, RobotMode};
use repose_ros_messages::status;

use super::trial::{Trial, ended, halted, swing};
use crate::robot::events::{Do, Told};
use crate::robot::unended::OTHERS;

#[test]
fn a_stop_cancels_the_goal_and_the_arm_stands_where_its_joints_are() {
    let mut trial = Trial::new(false);
    trial.start(swing(READY[0], 0.3));
    trial.side.told(Told::Accepted(1), trial.now_ms);
    trial.run(300);
    trial.done();
    trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
    trial.run(4);
    assert_eq!(trial.done(), [Do::Cancel(1), Do::Cancel(OTHERS)]);
    trial.joints_rad[0] = READY[0] + 0.07;
    trial.side.told(ended(1, status::CANCELED), trial.now_ms);
    trial.run(800);
    let state = trial.side.state(trial.now_ms, 0).expect("a state");
    assert_eq!((state.mode, state.q_rad[0]), (RobotMode::Stopped, READY[0] + 0.07));
    let stop = state.stop.expect("latched");
    assert_eq!(stop.kind, "estop", "the canceled goal is no fault of its own");
    trial.hears_of_nothing_of_others();
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
    assert_eq!(trial.done_of_own(), vec![Do::Cancel(1); 4]);
    assert!(!trial.clears(), "the controller may still move the arm");
    trial.side.told(Told::NotThere(1), trial.now_ms);
    assert!(!trial.clears(), "the cancel may have come before the goal");
    trial.run(1100);
    assert!(trial.side.overdue_cancels(trial.now_ms).is_some());
    trial.side.told(Told::NotThere(1), trial.now_ms);
    trial.side.told(Told::NotThere(OTHERS), trial.now_ms);
    trial.done();
    trial.run(1000);
    assert_eq!((trial.done(), trial.side.overdue_cancels(trial.now_ms)), (Vec::new(), None));
    assert!(trial.clears());
}

#[test]
fn a_goal_that_is_accepted_after_its_cancel_is_canceled_at_once() {
    let mut trial = stopped_on_its_way(None);
    trial.run(4);
    assert_eq!(trial.done_of_own(), [Do::Cancel(1)]);
    trial.side.told(Told::Accepted(1), trial.now_ms);
    trial.run(4);
    assert_eq!(trial.done_of_own(), [Do::Cancel(1)]);
    trial.side.told(ended(1, status::CANCELED), trial.now_ms);
    trial.run(1000);
    assert_eq!(trial.done_of_own(), []);
    trial.hears_of_nothing_of_others();
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
    trial.command(|command| (command.set_points, command.ends_stream) = (halted(400.0, READY[0], 0.3), true));
    trial.done();
    trial.side.told(Told::Refused(2, "busy".to_owned()), trial.now_ms);
    trial.run(4);
    assert_eq!((trial.done(), trial.stop_kind().as_deref()), (vec![Do::Cancel(1)], Some("controller_refused")));
}

#[test]
fn an_emergency_stop_cancels_what_others_have_sent_until_the_controller_has_said_that_nothing_is_left() {
    let mut trial = Trial::new(false);
    trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
    trial.run(4);
    assert_eq!(trial.done(), [Do::Cancel(OTHERS)]);
    assert!(!trial.clears(), "another client may move the arm");
    trial.side.told(Told::Ending(OTHERS), trial.now_ms);
    trial.side.emergency_stop(&EmergencyStop::read(b"e2"));
    trial.run(1000);
    assert_eq!(trial.done(), vec![Do::Cancel(OTHERS); 3]);
    trial.side.told(Told::NotThere(OTHERS), trial.now_ms);
    assert!(!trial.clears(), "it may still be ending that, or have more on its way");
    trial.run(1100);
    trial.side.told(Told::NotThere(OTHERS), trial.now_ms);
    trial.done();
    trial.run(1000);
    assert_eq!((trial.done(), trial.side.overdue_cancels(trial.now_ms)), (Vec::new(), None));
    assert!(trial.clears());
    trial.side.emergency_stop(&EmergencyStop::read(b"e3"));
    trial.run(4);
    assert_eq!((trial.done(), trial.clears()), (vec![Do::Cancel(OTHERS)], false));
}

#[test]
fn an_arrival_that_is_told_after_an_emergency_stop_does_not_tell_that_others_have_sent_nothing() {
    let mut trial = stopped_on_its_way(Some(Told::Accepted(1)));
    trial.side.told(ended(1, status::SUCCEEDED), trial.now_ms);
    trial.run(4);
    assert_eq!((trial.done(), trial.clears()), (vec![Do::Cancel(OTHERS)], false));
}
