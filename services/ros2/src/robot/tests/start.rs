//! How a bridge starts, and how it ends.

use repose_panda::READY;
use repose_proto::RigidTransform;
use repose_proto::robot::EmergencyStop;
use repose_ros_messages::status;

use super::trial::{Trial, config, ended, swing};
use crate::config::RobotConfig;
use crate::robot::events::{Do, Told};
use crate::robot::unended::OTHERS;

#[test]
fn a_bridge_that_starts_is_stopped_until_somebody_clears_that() {
    let mut trial = Trial::started(config(false));
    assert_eq!(trial.stop_kind().as_deref(), Some("driver_started"));
    assert!(trial.side.state(trial.now_ms, 0).is_some_and(|state| state.since_handling_ms.is_some()), "plans of before are old");
    trial.hears_of_nothing_of_others();
    assert_eq!(trial.stop_kind().as_deref(), Some("driver_started"));
    assert!(trial.clears());
}

#[test]
fn joints_that_nobody_tells_of_by_their_configured_names_are_named() {
    let joints = std::array::from_fn(|i| format!("fr3_joint{}", i + 1));
    let mut of_another = Trial::started(RobotConfig { joints, ..config(true) });
    assert!(of_another.side.state(of_another.now_ms, 0).is_none());
    let said = of_another.side.untold(of_another.now_ms).expect("words");
    assert!(said.contains("fr3_joint1, ") && said.contains("fr3_joint7:") && said.contains("/joint_states"), "{said}");
    for (hand, named) in [(true, true), (false, false)] {
        let trial = Trial::started(RobotConfig { finger_joints: vec!["fr3_finger_joint1".to_owned()], ..config(hand) });
        assert_eq!(trial.side.untold(trial.now_ms).is_some_and(|said| said.contains("fr3_finger_joint1")), named);
    }
    let trial = Trial::started(config(true));
    assert_eq!(trial.side.untold(trial.now_ms), None);
    assert!(trial.side.untold(trial.now_ms + 600).is_some_and(|said| said.contains("no state")));
}

#[test]
fn what_an_earlier_process_left_is_canceled_until_the_controller_has_said_that_nothing_is_left() {
    let mut trial = Trial::started(config(false));
    trial.side.emergency_stop(&EmergencyStop::read(b"e1"));
    trial.run(1000);
    assert_eq!(trial.done(), vec![Do::Cancel(OTHERS); 5]);
    assert!(!trial.clears(), "the arm may be on its way");
    trial.side.told(Told::Ending(OTHERS), trial.now_ms);
    trial.run(1600);
    assert!(trial.side.overdue_cancels(trial.now_ms).is_some());
    trial.side.told(Told::NotThere(OTHERS), trial.now_ms);
    assert!(!trial.clears(), "the controller may still be ending it");
    trial.run(500);
    trial.side.told(Told::NotThere(OTHERS), trial.now_ms);
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
    trial.hears_of_nothing_of_others();
    assert!(!trial.clears());
    assert!(trial.side.unknown_base().is_some_and(|told| told.contains("panda_link0")));
    trial.side.stands(RigidTransform::IDENTITY);
    assert_eq!(trial.side.unknown_base(), None);
    assert!(trial.clears());
}
