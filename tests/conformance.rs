//! Every client makes the same calls alike: one table of cases (`tests/conformance/calls.json`), made by the Rust caller, and by the Python package
//! where `REPOSE_PYTHON` names an interpreter that has it, against the same services, before and after a planner is killed.

mod common;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use common::{Deployment, newest_scene, whole_scene};
use repose_proto::motion::MotionPlanRequest;
use repose_proto::{CallError, Message, Payload, PlaceRequest, Priority, Scene, Service, message};
use repose_runtime::{CallOptions, Session};
use serde::Deserialize;
use serde_json::{Value, json};

#[derive(Deserialize)]
struct Table {
    cases: Vec<Case>,
}

/// One call and what must come of it.
#[derive(Deserialize)]
struct Case {
    name: String,
    service: String,
    method: String,
    schema: String,
    request: Value,
    #[serde(default)]
    deadline_ms: Option<u64>,
    #[serde(default)]
    priority: Option<Priority>,
    #[serde(default)]
    everyone: bool,
    #[serde(default)]
    enclose: bool,
    #[serde(default)]
    answer: Option<Value>,
    #[serde(default)]
    same: bool,
    #[serde(default)]
    error: Option<Value>,
}

/// The result of a call: the result's bytes, or the error's code and field.
type Ended = Result<Vec<u8>, Value>;

/// What the table's names mean.
struct Meant {
    scene: Scene,
    scene_id: String,
    query: u16,
    anchor: u16,
}

impl Meant {
    fn filled(&self, value: &Value) -> Value {
        match value {
            Value::String(name) if name == "$scene" => json!(self.scene_id),
            Value::String(name) if name == "$move" => json!(self.query),
            Value::String(name) if name == "$anchor" => json!(self.anchor),
            Value::Array(inner) => inner.iter().map(|value| self.filled(value)).collect(),
            Value::Object(inner) => {
                inner.iter().map(|(key, value)| (key.clone(), self.filled(value))).collect::<serde_json::Map<_, _>>().into()
            }
            other => other.clone(),
        }
    }
}

fn table() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/conformance/calls.json")
}

fn error_of(error: &CallError) -> Value {
    json!({"code": error.code, "field": error.field})
}

/// A case as the Rust caller makes it.
async fn by_rust(session: &Session, case: &Case, meant: &Meant) -> Ended {
    let service = Service::parse(&case.service).expect("a service");
    let caller = session.caller(service).await.expect("a caller");
    let body = serde_json::to_vec(&meant.filled(&case.request)).expect("JSON");
    let encoding = format!("application/json;repose.{}", case.schema);
    let by_id = Payload { encoding, bytes: body.clone().into() };
    let options = CallOptions {
        priority: case.priority.unwrap_or(Priority::Interactive),
        ..CallOptions::within(Duration::from_millis(case.deadline_ms.unwrap_or(60_000)))
    };
    if case.everyone {
        let ended = caller.call_any(&case.method, &by_id, &options).await;
        return ended.map(|answer| answer.payload.bytes.to_vec()).map_err(|e| error_of(&e));
    }
    let encode = |scene: Option<&Scene>| match scene {
        None => Ok(by_id.clone()),
        Some(scene) if case.schema == PlaceRequest::SCHEMA => Payload::with_scene(&message::from_json::<PlaceRequest>(&body)?, Some(scene)),
        Some(scene) => Payload::with_scene(&message::from_json::<MotionPlanRequest>(&body)?, Some(scene)),
    };
    let scene = case.enclose.then_some(&meant.scene);
    let ended = caller.call_with_scene(&case.method, scene, encode, options).await;
    ended.map(|answer| answer.payload.bytes.to_vec()).map_err(|e| error_of(&e))
}

/// All cases as the Python package makes them; none where no interpreter is named.
fn by_python(endpoint: &str, meant: &Meant, cases: usize) -> Option<Vec<Ended>> {
    let python = std::env::var_os("REPOSE_PYTHON")?;
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("scene"), meant.scene.to_bulk().encode()).expect("the scene");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../python/tests/conformance_client.py");
    let mut command = Command::new(python);
    command.arg(script).arg(endpoint).arg(table()).arg(folder.path());
    command.args([meant.query.to_string(), meant.anchor.to_string()]);
    assert!(command.status().expect("the interpreter starts").success());
    let ended = (0..cases).map(|k| match std::fs::read(folder.path().join(k.to_string())) {
        Ok(bytes) => Ok(bytes),
        Err(_) => {
            let text = std::fs::read(folder.path().join(format!("{k}.error"))).expect("a result or an error");
            Err(serde_json::from_slice(&text).expect("an error"))
        }
    });
    Some(ended.collect())
}

fn check(case: &Case, ended: &Ended, by: &str) {
    match (&case.error, ended) {
        (Some(expected), Err(error)) => {
            for (key, value) in expected.as_object().expect("an object") {
                let fits = value.as_array().map_or(&error[key] == value, |several| several.contains(&error[key]));
                assert!(fits, "{}: {key} by {by} is not {value}: {error}", case.name);
            }
        }
        (None, Ok(bytes)) => {
            let data: Value = serde_json::from_slice(bytes).unwrap_or(Value::Null);
            for (key, value) in case.answer.iter().filter_map(Value::as_object).flatten() {
                assert_eq!(&data[key], value, "{}: {key} by {by}", case.name);
            }
        }
        (Some(expected), Ok(_)) => panic!("{}: {by} got a result, {expected} was expected", case.name),
        (None, Err(error)) => panic!("{}: {by} got {error}", case.name),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_client_gets_the_same_answers_before_and_after_a_planner_is_killed() {
    let services =
        [(Service::Simulator, 1), (Service::Perception, 1), (Service::Inference, 1), (Service::Planner, 2), (Service::Motion, 1)];
    let mut deployment = Deployment::start(&services).await;
    let session = deployment.session().await;
    let summary = newest_scene(&session).await;
    let scene = whole_scene(&session, &summary).await;
    let ids: Vec<u16> = summary.objects.iter().map(|o| o.id).collect();
    let meant = Meant { scene, scene_id: summary.scene_id, query: ids[0], anchor: ids[1] };
    let Table { cases } = serde_json::from_slice(&std::fs::read(table()).expect("the table")).expect("its cases");
    let mut before: Vec<Ended> = Vec::new();
    for round in ["two planners", "one planner was killed"] {
        let mut ended = Vec::new();
        for case in &cases {
            ended.push(by_rust(&session, case, &meant).await);
            check(case, &ended[ended.len() - 1], "the Rust caller");
        }
        if let Some(python) = by_python(deployment.endpoint(), &meant, cases.len()) {
            for ((case, rust), python) in cases.iter().zip(&ended).zip(&python) {
                check(case, python, "the Python package");
                assert!(!case.same || rust == python, "{}: other bytes from the Python package, {round}", case.name);
            }
        }
        for ((case, first), now) in cases.iter().zip(&before).zip(&ended) {
            assert!(!case.same || first == now, "{}: other bytes when {round}", case.name);
        }
        before = ended;
        deployment.kill_one(Service::Planner);
    }
}
