//! What asks robots to move and to stop: bounds by field, and a stop that is read from anything.

mod common;

use common::*;
use repose_proto::motion::{MotionPlan, MotionPlanRequest};
use repose_proto::robot::{EmergencyStop, RobotState};
use repose_proto::{CallError, ErrorCode, Message, Payload, RigidTransform, limits};

fn field(error: &CallError) -> &str {
    assert_eq!(error.code, ErrorCode::InvalidArgument, "{error}");
    error.field.as_deref().unwrap_or_else(|| panic!("no field in {error}"))
}

#[test]
fn a_motion_plan_names_the_field_at_fault() {
    type Edit = fn(&mut MotionPlan);
    let cases: [(&str, Edit); 6] = [
        ("grasp.world_from_tcp", |p| p.grasp.world_from_tcp.0[0] = 2.0),
        ("grasp.width_m", |p| p.grasp.width_m = 0.2),
        ("grasp.score", |p| p.grasp.score = f64::NAN),
        ("duration_ms", |p| p.duration_ms = -1.0),
        ("phases[0].gripper.force_n", |p| p.phases[0].gripper.iter_mut().for_each(|g| g.force_n = 500.0)),
        ("phases[0].set_points[1].t_ms", |p| p.phases[0].set_points[1].t_ms = 0.0),
    ];
    assert!(motion_plan().validate().is_ok());
    for (expected, edit) in cases {
        let mut plan = motion_plan();
        edit(&mut plan);
        assert_eq!(field(&plan.validate().unwrap_err()), expected);
    }
}

#[test]
fn a_phase_that_nobody_knows_is_refused_by_its_field() {
    let text = serde_json::to_string(&motion_plan()).unwrap().replace("\"standoff\"", "\"sprint\"");
    let sent = Payload { encoding: "application/json;repose.MotionPlan.v1".to_owned(), bytes: text.into_bytes().into() };
    let error = sent.decode_json::<MotionPlan>().unwrap_err();
    assert_eq!(field(&error), "phases[0].name");
    assert!(error.message.contains("sprint"), "{error}");
}

/// What a robot's side says that says all it can.
fn whole_state() -> RobotState {
    RobotState { stream_ms: Some(3.0), held: Some(held()), world_from_base: Some(RigidTransform::IDENTITY), ..robot_state() }
}

#[test]
fn a_state_that_no_robot_can_be_in_names_the_field_at_fault() {
    type Edit = fn(&mut RobotState);
    let cases: [(&str, Edit); 11] = [
        ("robot_ms", |s| s.robot_ms = f64::NAN),
        ("q_rad[2]", |s| s.q_rad[2] = f64::INFINITY),
        ("q_rad[6]", |s| s.q_rad[6] = -1e6),
        ("dq_rad_s[0]", |s| s.dq_rad_s[0] = f64::NAN),
        ("gripper_width_m", |s| s.gripper_width_m = f64::NAN),
        ("gripper_width_m", |s| s.gripper_width_m = 80.0),
        ("gripper_width_m", |s| s.gripper_width_m = -0.5),
        ("stream_ms", |s| s.stream_ms = Some(f64::NEG_INFINITY)),
        ("held.low_m[1]", |s| s.held.iter_mut().for_each(|held| held.low_m[1] = f64::NAN)),
        ("world_from_base", |s| s.world_from_base = Some(RigidTransform([0.0; 16]))),
        ("world_from_base", |s| s.world_from_base.iter_mut().for_each(|pose| pose.0[3] = f64::NAN)),
    ];
    for (expected, edit) in cases {
        let mut state = whole_state();
        edit(&mut state);
        assert_eq!(field(&state.validate().unwrap_err()), expected);
    }
}

#[test]
fn a_state_that_a_robot_may_well_be_in_is_taken() {
    type Edit = fn(&mut RobotState);
    let cases: [Edit; 5] = [
        |_| (),
        // Guided by hand beyond its limits, faster than it may move by itself; and a joint that turns on and on.
        |s| (s.q_rad, s.dq_rad_s) = ([3.2, -2.1, 2.95, 0.1, 2.95, 4.7, -31.4], [9.0; 7]),
        // Fingers that press against each other, and those of a wide hand.
        |s| s.gripper_width_m = -0.0004,
        |s| s.gripper_width_m = 0.14,
        |s| (s.stream_ms, s.held, s.world_from_base) = (None, None, None),
    ];
    for edit in cases {
        let mut state = whole_state();
        edit(&mut state);
        let text = serde_json::to_string(&state).unwrap().replacen('{', "{\"field_of_a_later_release\":[1e300],", 1);
        let sent = Payload { encoding: "application/json;repose.RobotState.v1".to_owned(), bytes: text.into_bytes().into() };
        assert_eq!(sent.decode_json::<RobotState>().unwrap(), state);
    }
}

#[test]
fn the_number_of_grasps_and_the_epoch_are_bounded() {
    let with = |count: usize| MotionPlanRequest { grasps: Some(vec![motion_plan().grasp; count]), ..motion_plan_request() };
    assert!(with(limits::MAX_GRASPS).validate().is_ok());
    for count in [0, limits::MAX_GRASPS + 1] {
        assert_eq!(field(&with(count).validate().unwrap_err()), "grasps");
    }
    let mut command = robot_command();
    command.owner.epoch = limits::MAX_EPOCH;
    assert!(command.validate().is_ok());
    command.owner.epoch += 1;
    assert_eq!(field(&command.validate().unwrap_err()), "owner.epoch");
}

#[test]
fn an_emergency_stop_is_read_from_anything() {
    let said = emergency_stop();
    assert_eq!(EmergencyStop::read(&serde_json::to_vec(&said).unwrap()), said);
    let part = EmergencyStop::read(br#"{"id": "e2", "stamp_ns": -4, "more": [1]}"#);
    assert_eq!((part.id.as_str(), part.source.as_str(), part.stamp_ns), ("e2", "unknown", 0));
    assert!(part.reason.starts_with("unreadable stop: "), "{}", part.reason);
    let large = vec![b'x'; limits::MAX_STOP_BYTES + 1];
    for bytes in [&b""[..], b"\xff\x00", b"STOP", b"[1, 2]", b"{\"id\": 7", &large] {
        let stop = EmergencyStop::read(bytes);
        assert!(stop.reason.starts_with("unreadable stop: ") && stop.reason.len() < 200, "{}", stop.reason);
        assert_eq!(stop, EmergencyStop::read(bytes), "a repeat is the same stop");
    }
    assert_ne!(EmergencyStop::read(b"").id, EmergencyStop::read(b"STOP").id);
    let long = format!(r#"{{"reason": "{}"}}"#, "é".repeat(5000));
    assert_eq!(EmergencyStop::read(long.as_bytes()).reason.chars().count(), 256);
    let forged = EmergencyStop::read(br#"{"source": "a\u001b]0;b", "reason": "now\u001b[2K\rpanda is idle\n"}"#);
    assert_eq!((forged.source.as_str(), forged.reason.as_str()), ("a ]0;b", "now [2K panda is idle "), "a terminal is told nothing");
}
