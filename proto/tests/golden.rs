//! The bytes of messages, as checked in: whoever changes them breaks every client. `REPOSE_BLESS=1` rewrites them, knowingly.

mod common;

use std::collections::BTreeMap;
use std::path::Path;

use common::*;
use repose_proto::motion::{ExecuteProgress, Heeded, MotionPlan, Phase, RobotResetReply, RobotResetRequest};
use repose_proto::perception::{ByteRange, LatestRequest, ScenePart, SceneRequest};
use repose_proto::place::PlaceProgress;
use repose_proto::robot::{RobotCommand, RobotState, TaskState};
use repose_proto::scoring::{ForecastsReply, ForecastsRequest, ModelsRequest, PriorReply, ScoreReply, ScoreRequest};
use repose_proto::simulator::{TruthRequest, WorldResetRequest};
use repose_proto::*;

fn check(name: &str, bytes: &[u8]) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name);
    if std::env::var_os("REPOSE_BLESS").is_some() {
        std::fs::write(&path, bytes).unwrap();
    }
    let golden = std::fs::read(&path).unwrap_or_default();
    assert!(golden == bytes, "the bytes of {name} have changed:\n{}", String::from_utf8_lossy(bytes));
}

fn json<T: Message + serde::Serialize>(message: &T) -> Vec<u8> {
    Payload::json(message).unwrap().bytes.to_vec()
}

#[test]
fn json_messages_keep_their_bytes() {
    check("PlaceRequest.v1.json", &json(&place_request()));
    check("PlaceResult.v1.json", &json(&place_result()));
    check("ArrangeRequest.v1.json", &json(&arrange_request()));
    check("ArrangeResult.v1.json", &json(&arrange_result()));
    check("PlaceResult.v1.second.json", &json(&place_result_2()));
    check("PlaceRequest.v1.third.json", &json(&place_request_3()));
    check("PlaceResult.v1.third.json", &json(&place_result_3()));
    check("PlaceRequest.v1.fourth.json", &json(&place_request_4()));
    check("PlaceResult.v1.fourth.json", &json(&place_result_4()));
    check("MotionPlanRequest.v1.json", &json(&motion_plan_request()));
    check("MotionPlan.v1.json", &json(&motion_plan()));
    check("MotionPlan.v1.second.json", &json(&MotionPlan { heeded: Some(Heeded::Held), ..motion_plan() }));
    check("ExecuteReply.v1.json", &json(&execute_reply()));
    check("RobotCommand.v1.json", &json(&robot_command()));
    check("SceneSummary.v1.json", &json(&scene().summary(SCENE_ID.into())));
    check("SceneSummary.v1.left_out.json", &json(&scene_with_left_out().summary(SCENE_ID.into())));
    check("CallError.v1.json", &json(&CallError::invalid("goal[0].anchor", "no such object")));
    check("PlaceProgress.v1.json", &json(&PlaceProgress { iterations: 1, evaluated: 100, best: place_result().placements.pop() }));
    check("LatestRequest.v1.json", &json(&LatestRequest { camera: "table".into() }));
    check("SceneRequest.v1.json", &json(&SceneRequest::new(SCENE_ID)));
    let part = Some(ByteRange { offset: 262_144, length: 65_536 });
    check("SceneRequest.v1.part.json", &json(&SceneRequest { packed: true, part, ..SceneRequest::new(SCENE_ID) }));
    check("PriorRequest.v1.json", &json(&prior_request()));
    check("ModelsRequest.v1.json", &json(&ModelsRequest {}));
    check("ModelsReply.v1.json", &json(&models_reply()));
    check("ForecastsRequest.v1.json", &json(&ForecastsRequest {}));
    let forecasts = BTreeMap::from([("success".to_owned(), serde_json::json!({"measures": ["a"]}))]);
    check("ForecastsReply.v1.json", &json(&ForecastsReply { weights_hash: "w".into(), forecasts }));
    check("ExecuteProgress.v1.json", &json(&ExecuteProgress { phase: Phase::Lift, done: 3, of: 8 }));
    check("RobotResetRequest.v1.json", &json(&RobotResetRequest::new("panda".into())));
    check("RobotResetReply.v1.json", &json(&RobotResetReply { was_stopped: true }));
    check("RecoverRequest.v1.json", &json(&recover_request()));
    check("RecoverReply.v1.json", &json(&recover_reply()));
    check("RobotState.v1.json", &json(&robot_state()));
    check(
        "RobotState.v1.task.json",
        &json(&RobotState { task: Some(TaskState { id: Some("t1".into()) }), held: Some(held()), ..robot_state() }),
    );
    check("RobotCommand.v1.task.json", &json(&RobotCommand { task: Some(task()), ..robot_command() }));
    check("EmergencyStop.v1.json", &json(&emergency_stop()));
    check("WorldResetRequest.v1.json", &json(&WorldResetRequest { seed: 7 }));
    check("TruthRequest.v1.json", &json(&TruthRequest { view_yaw_rad: Some(0.5) }));
    check("Truth.v1.json", &json(&truth()));
    check("WorkerLoad.v1.json", &json(&worker_load()));
}

#[test]
fn every_message_with_a_schema_has_its_bytes_checked_in() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    // Parts of other messages, and of a frame folder on disk.
    let parts = ["CameraModel.v1", "SceneMeta.v1"];
    for (name, _) in schemas::all().iter().filter(|(name, _)| !parts.contains(&name.as_str())) {
        let found = ["json", "safetensors"].iter().any(|form| folder.join(format!("{name}.{form}")).exists());
        assert!(found, "tests/golden has no {name}");
    }
}

#[test]
fn bulk_messages_keep_their_bytes_and_a_scene_its_id() {
    check("Frame.v1.safetensors", &frame().to_bulk().encode());
    check("Scene.v1.safetensors", &scene().to_bulk().encode());
    let range = ByteRange { offset: 2, length: 3 };
    let payload = Payload { encoding: "application/octet-stream;repose.Scene.v1".into(), bytes: vec![0, 1, 2, 3, 4, 5].into() };
    check("ScenePart.v1.safetensors", &ScenePart::of(&payload, range).to_payload().unwrap().bytes);
    check("ScoreRequest.v1.safetensors", &score_request().to_bulk(Some(&scene())).encode());
    check("ScoreReply.v1.safetensors", &score_reply().to_bulk().encode());
    check("PriorReply.v1.safetensors", &prior_reply().to_bulk().encode());
    check("Scene.v1.id", scene().id().as_bytes());
}

#[test]
fn attachments_keep_their_bytes() {
    let call = CallAttachment {
        v: 1,
        id: "6fa459ea-ee8a-3ca4-894e-db77e160355e".into(),
        method: "place".into(),
        remaining_ms: 2000,
        priority: Priority::Batch,
        attempt: 1,
        traceparent: None,
        caller: None,
    };
    check("CallAttachment.v1.json", &call.encode());
    assert_eq!(CallAttachment::decode(&call.encode()).unwrap(), call);
    let reply = ReplyAttachment {
        v: 1,
        id: call.id.clone(),
        kind: ReplyKind::Result,
        n: None,
        worker: Some("planner-1".into()),
        attempt: Some(1),
        timing_ms: [("search".to_owned(), 12.5)].into(),
    };
    check("ReplyAttachment.v1.json", &reply.encode());
    assert_eq!(ReplyAttachment::decode(&reply.encode()).unwrap(), reply);
}

#[test]
fn what_is_written_is_read_back() {
    assert_eq!(Payload::json(&place_request()).unwrap().decode_json::<PlaceRequest>().unwrap(), place_request());
    assert_eq!(Payload::json(&place_result()).unwrap().decode_json::<PlaceResult>().unwrap(), place_result());
    assert_eq!(Payload::json(&place_result_2()).unwrap().decode_json::<PlaceResult>().unwrap(), place_result_2());
    assert_eq!(Frame::from_bulk(&Bulk::decode(&frame().to_bulk().encode()).unwrap()).unwrap(), frame());
    assert_eq!(Scene::from_bulk(&Bulk::decode(&scene().to_bulk().encode()).unwrap()).unwrap(), scene());
    let (frame, with_left_out) = (frame_with_robot_and_hints(), scene_with_left_out());
    assert_eq!(Frame::from_bulk(&Bulk::decode(&frame.to_bulk().encode()).unwrap()).unwrap(), frame);
    assert_eq!(Scene::from_bulk(&Bulk::decode(&with_left_out.to_bulk().encode()).unwrap()).unwrap(), with_left_out);
    let (request, enclosed) = ScoreRequest::from_bulk(&Bulk::decode(&score_request().to_bulk(Some(&scene())).encode()).unwrap()).unwrap();
    assert_eq!((request, enclosed), (score_request(), Some(scene())));
    assert_eq!(ScoreReply::from_bulk(&Bulk::decode(&score_reply().to_bulk().encode()).unwrap()).unwrap(), score_reply());
    assert_eq!(PriorReply::from_bulk(&Bulk::decode(&prior_reply().to_bulk().encode()).unwrap()).unwrap(), prior_reply());
}

#[test]
fn a_scenes_id_leaves_out_stamp_and_camera_name_and_nothing_else() {
    let original = scene();
    let renamed = Scene { camera_name: "other".into(), stamp_ns: 8, ..original.clone() };
    assert_eq!(original.id(), renamed.id());
    let mut moved = original.clone();
    moved.points[2][0] += 1e-6;
    assert_ne!(original.id(), moved.id());
    let mut relabelled = original.clone();
    relabelled.labels[0] = 2;
    assert_ne!(original.id(), relabelled.id());
    let mut elsewhere = original.clone();
    elsewhere.meta.view_yaw_rad = 0.5;
    assert_ne!(original.id(), elsewhere.id());
}

#[test]
fn other_writers_bulk_is_read_whatever_its_order() {
    let data: Vec<u8> = (0..6u16).flat_map(|i| (800 + i).to_le_bytes()).collect();
    let view = safetensors::tensor::TensorView::new(safetensors::Dtype::U16, vec![2, 3], &data).unwrap();
    let metadata = std::collections::HashMap::from([
        ("stamp_ns".to_owned(), "5".to_owned()),
        ("camera".to_owned(), "table".to_owned()),
        ("camera_json".to_owned(), serde_json::to_string(&camera()).unwrap()),
    ]);
    let bytes = safetensors::serialize([("depth", view)], Some(metadata)).unwrap();
    let frame = Frame::from_bulk(&Bulk::decode(&bytes).unwrap()).unwrap();
    assert_eq!((frame.stamp_ns, frame.depth[5], frame.color), (5, 805, None));
}
