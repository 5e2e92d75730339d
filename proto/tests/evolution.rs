//! Releases side by side: what release 1 sent stays readable, receivers ignore fields of newer senders, requests refuse them.

use std::path::Path;

use repose_proto::load::WorkerLoad;
use repose_proto::message::from_json;
use repose_proto::motion::{ExecuteProgress, ExecuteReply, MotionPlan, MotionPlanRequest, RobotResetReply, RobotResetRequest};
use repose_proto::perception::{LatestRequest, SceneRequest};
use repose_proto::place::PlaceProgress;
use repose_proto::robot::{EmergencyStop, RobotCommand, RobotState};
use repose_proto::scoring::{ModelsReply, ModelsRequest, PriorRequest};
use repose_proto::simulator::{Truth, TruthRequest, WorldResetRequest};
use repose_proto::*;
use serde::de::DeserializeOwned;
use serde_json::Value;

fn golden(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(format!("{name}.v1.json"));
    serde_json::from_slice(&std::fs::read(path).expect("a golden message")).expect("JSON")
}

/// The message with a field of a later release at the top.
fn newer(name: &str) -> Vec<u8> {
    let mut message = golden(name);
    message.as_object_mut().expect("an object").insert("of_a_later_release".to_owned(), Value::Bool(true));
    message.to_string().into_bytes()
}

fn ignores<T: DeserializeOwned + PartialEq + std::fmt::Debug>(name: &str) {
    let as_sent: T = from_json(golden(name).to_string().as_bytes()).unwrap_or_else(|e| panic!("{name}: {e}"));
    let from_newer: T = from_json(&newer(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    assert_eq!(from_newer, as_sent, "{name}");
}

fn refuses<T: DeserializeOwned + std::fmt::Debug>(name: &str) {
    from_json::<T>(golden(name).to_string().as_bytes()).unwrap_or_else(|e| panic!("{name}: {e}"));
    let error = from_json::<T>(&newer(name)).expect_err(name);
    assert_eq!(error.field.as_deref(), Some("of_a_later_release"), "{name}: {error}");
}

#[test]
fn receivers_ignore_what_a_newer_sender_adds_to_states_summaries_attachments_and_answers() {
    ignores::<RobotState>("RobotState");
    ignores::<WorkerLoad>("WorkerLoad");
    ignores::<SceneSummary>("SceneSummary");
    ignores::<CallAttachment>("CallAttachment");
    ignores::<ReplyAttachment>("ReplyAttachment");
    ignores::<CallError>("CallError");
    ignores::<PlaceResult>("PlaceResult");
    ignores::<ArrangeResult>("ArrangeResult");
    ignores::<PlaceProgress>("PlaceProgress");
    ignores::<ExecuteReply>("ExecuteReply");
    ignores::<ExecuteProgress>("ExecuteProgress");
    ignores::<RobotResetReply>("RobotResetReply");
    ignores::<ModelsReply>("ModelsReply");
    ignores::<Truth>("Truth");
}

/// The golden scene, and the same with what a later release may say beside.
fn scene_and_newer() -> (Bulk, Bulk) {
    let bytes = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/Scene.v1.safetensors")).expect("a golden scene");
    let bulk = Bulk::decode(&bytes).expect("bulk form");
    let mut newer = bulk.clone();
    newer.metadata.insert("of_a_later_release".to_owned(), "anything".to_owned());
    let mut changed = 0;
    for text in newer.metadata.values_mut() {
        if let Ok(Value::Object(mut object)) = serde_json::from_str::<Value>(text) {
            object.insert("of_a_later_release".to_owned(), Value::Bool(true));
            *text = Value::Object(object).to_string();
            changed += 1;
        }
    }
    assert!(changed > 0, "a scene has metadata in JSON");
    (bulk, newer)
}

#[test]
fn receivers_ignore_what_a_newer_sender_adds_to_a_scenes_metadata() {
    let (bulk, newer) = scene_and_newer();
    let came = Scene::from_bulk(&newer).expect("a scene");
    assert_eq!(Scene { as_sent: None, ..came }, Scene::from_bulk(&bulk).expect("a scene"));
}

#[test]
fn a_scene_of_a_newer_perception_has_its_id_at_receivers_that_know_less_of_it_and_is_handed_on_whole() {
    let (bulk, newer) = scene_and_newer();
    let id_of = |bulk: &Bulk| {
        let mut content = bulk.clone();
        content.metadata.retain(|name, _| name == "scene");
        blake3::hash(&content.encode()).to_hex().to_string()
    };
    let came = Scene::from_bulk(&newer).expect("a scene");
    assert_eq!(came.id(), id_of(&newer));
    let payload = Payload::with_scene(&PlaceRequest::new(came.id(), 1, vec!["near:2".parse().expect("a term")]), Some(&came));
    let enclosed = payload.and_then(|payload| payload.decode_bulk(PlaceRequest::SCHEMA)).expect("bulk form");
    assert_eq!(enclosed.metadata["scene"], newer.metadata["scene"]);
    let (request, handed_on) = enclosed::disclose::<PlaceRequest>(&enclosed).expect("a request");
    assert_eq!(handed_on.map(|scene| scene.id()), Some(request.scene.scene_id));

    // A client may have written it anew in its own way, and goes on calling it as perception does.
    let mut spelt_anew = bulk.clone();
    spelt_anew.metadata.insert("scene".to_owned(), format!(" {}", bulk.metadata["scene"]));
    let spelt_anew = Scene::from_bulk(&spelt_anew).expect("a scene");
    assert!(spelt_anew.goes_by(&id_of(&bulk)) && spelt_anew.goes_by(&spelt_anew.id()) && spelt_anew.id() != id_of(&bulk));
    assert!(!spelt_anew.goes_by(&came.id()) && !came.goes_by(&id_of(&bulk).replace('0', "1")));

    // What is made of it says for itself.
    let mut turned = came;
    turned.meta.view_yaw_rad += 0.5;
    let own = Scene { as_sent: None, ..turned.clone() };
    assert_eq!((turned.id(), turned.to_bulk()), (own.id(), own.to_bulk()));
    let known = Scene::from_bulk(&bulk).expect("a scene");
    assert_eq!((known.as_sent.as_deref(), known.id()), (None, id_of(&bulk)));
}

#[test]
fn requests_and_commands_refuse_fields_that_they_do_not_know() {
    refuses::<PlaceRequest>("PlaceRequest");
    refuses::<ArrangeRequest>("ArrangeRequest");
    refuses::<MotionPlanRequest>("MotionPlanRequest");
    refuses::<MotionPlan>("MotionPlan");
    refuses::<RobotResetRequest>("RobotResetRequest");
    refuses::<LatestRequest>("LatestRequest");
    refuses::<SceneRequest>("SceneRequest");
    refuses::<PriorRequest>("PriorRequest");
    refuses::<ModelsRequest>("ModelsRequest");
    refuses::<WorldResetRequest>("WorldResetRequest");
    refuses::<TruthRequest>("TruthRequest");
    refuses::<RobotCommand>("RobotCommand");
    refuses::<EmergencyStop>("EmergencyStop");
}

#[test]
fn a_misspelt_field_in_a_file_is_an_error_although_the_wire_ignores_it() {
    let camera =
        br#"{"width": 2, "height": 2, "fx": 1.0, "fy": 1.0, "cx": 1.0, "cy": 1.0, "depth_unit_m": 0.001, "world_from_camra": null}"#;
    assert!(from_json::<CameraModel>(camera).is_ok());
    assert!(message::from_file_json::<CameraModel>(camera).is_ok(), "null says nothing");
    let camera = String::from_utf8_lossy(camera).replace("null", "[]");
    let error = message::from_file_json::<CameraModel>(camera.as_bytes()).expect_err("no such field");
    assert_eq!(error.field.as_deref(), Some("world_from_camra"));
}
