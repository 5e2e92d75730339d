//! What a worker says to a plan before it is carried out.

mod common;

use common::{NOW_NS, plan};
use repose_motion::worker::Worker;
use repose_motion::{MotionConfig, synthetic};
use repose_proto::motion::{KeepOutZone, MotionPlan, Phase};
use repose_proto::{CallError, ErrorCode};

/// A worker whose cell has one zone, far away.
fn zoned() -> Worker {
    let zone = KeepOutZone { name: "far".to_owned(), min_m: [50.0, 0.0, 0.0], max_m: [51.0, 1.0, 1.0] };
    Worker::start(&MotionConfig { keep_out: vec![zone], ..MotionConfig::default() }).unwrap()
}

#[test]
fn a_plan_that_carries_nobody_knows_what_is_not_carried_out_where_there_are_zones() {
    let worker = zoned();
    let refused = worker.executable(plan(), None, &|| Ok(())).unwrap_err();
    assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::FailedPrecondition, Some("scene_id")), "{refused}");
    let mut empty_handed = plan();
    empty_handed.phases.retain(|phase| phase.name != Phase::Grasp);
    assert!(worker.executable(empty_handed, None, &|| Ok(())).is_ok());
    let anywhere = Worker::start(&MotionConfig::default()).unwrap();
    assert!(anywhere.executable(plan(), None, &|| Ok(())).is_ok());

    let scene = synthetic::wire_scene(NOW_NS);
    let known = MotionPlan { scene_id: scene.id(), ..plan() };
    let other = worker.executable(plan(), Some(scene.clone()), &|| Ok(())).unwrap_err();
    assert_eq!((other.code, other.field.as_deref()), (ErrorCode::InvalidArgument, Some("scene.scene_id")), "{other}");
    let (_, held) = worker.executable(known.clone(), Some(scene), &|| Ok(())).unwrap();
    assert!(held.is_some());
    let (_, held) = worker.executable(known, None, &|| Ok(())).unwrap();
    assert!(held.is_some(), "it is kept");
}

#[test]
fn the_check_of_a_plan_is_given_up_when_nobody_waits_for_it() {
    let gone = || -> Result<(), CallError> { Err(CallError::new(ErrorCode::Cancelled, "the caller cancelled")) };
    let mut empty_handed = plan();
    empty_handed.phases.retain(|phase| phase.name != Phase::Grasp);
    assert_eq!(zoned().executable(empty_handed, None, &gone).unwrap_err().code, ErrorCode::Cancelled);
}
