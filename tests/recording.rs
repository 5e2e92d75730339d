//! `repose record`, `replay` and `play` with real processes: what was answered by many under load is answered again by one, byte for byte.

mod common;

use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use common::{Deployment, PATIENCE, Process, copy_their_calls, newest_scene, repose, whole_scene};
use repose_proto::arrange::ObjectGoal;
use repose_proto::place::Variant;
use repose_proto::{ArrangeRequest, GoalTerm, Payload, PlaceRequest, PlaceResult, Relation, Scene, Service, keys};
use repose_recorder::RecordingError;
use repose_recorder::calls::Calls;
use repose_recorder::file::reading::RecordingReader;
use repose_recorder::replay::is_repeatable;
use repose_runtime::{CallOptions, Session};
use serde_json::Value;

async fn output(mut command: Command) -> (Output, Value) {
    let output = tokio::task::spawn_blocking(move || command.output()).await.expect("no panic").expect("the program runs");
    let document = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output, document)
}

/// Starts recording, and waits until every one of `workers` copies its calls.
async fn recording(deployment: &Deployment, session: &Session, out: &Path, workers: usize) -> Process {
    let mut loads = session.subscribe_queue(&session.cell().all_loads(), 256).await.expect("a subscription");
    let mut command = repose();
    command.args(["--json", "record", "--connect", deployment.endpoint(), "--frame-period-ms", "1000", "--out"]).arg(out);
    let process = Process(command.stdout(Stdio::piped()).spawn().expect("the recorder"));
    copy_their_calls(&mut loads, workers).await;
    process
}

/// Asks for placements on one scene, all at once.
async fn ask(session: &Session, scene_id: &str, scene: &Scene, seeds: std::ops::Range<u64>) -> Vec<(PlaceResult, String)> {
    let planner = session.caller(Service::Planner).await.expect("a caller");
    let terms = [Relation::LeftOf, Relation::RightOf, Relation::InFrontOf, Relation::Behind];
    let one = |seed: u64| {
        let planner = planner.clone();
        let goal = GoalTerm { relation: terms[seed as usize % terms.len()], anchor: 2, holds: true };
        let request = PlaceRequest { seed, count: 2, ..PlaceRequest::new(scene_id.to_owned(), 1, vec![goal]) };
        async move {
            let (result, answer) = planner.place(&request, Some(scene), CallOptions::within(PATIENCE)).await.expect("an answer");
            (result, answer.worker)
        }
    };
    futures::future::join_all(seeds.map(one)).await
}

/// Asks for an arrangement on the same scene.
async fn ask_to_arrange(session: &Session, scene_id: &str, scene: &Scene) {
    let planner = session.caller(Service::Planner).await.expect("a caller");
    let goal = |object, relation| ObjectGoal { object, terms: vec![GoalTerm { relation, anchor: 2, holds: true }] };
    let goals = vec![goal(1, Relation::LeftOf), goal(3, Relation::RightOf)];
    let request = ArrangeRequest { variant: Variant::Geometric, max_searches: 6, ..ArrangeRequest::new(scene_id.to_owned(), goals) };
    let encode = |scene: Option<&Scene>| Payload::with_scene(&request, scene);
    planner.call_with_scene("arrange", Some(scene), encode, CallOptions::within(PATIENCE)).await.expect("an answer");
}

/// What a recording holds to ask again.
fn calls_in(file: &Path) -> Result<Calls, RecordingError> {
    Calls::read(&[file.to_owned()], |service, call| is_repeatable(service, &call.method))
}

/// Waits until a recording that is being made has so many answers on the disk.
async fn on_disk(file: &Path, count: usize) {
    let give_up = tokio::time::Instant::now() + PATIENCE;
    loop {
        let answers = calls_in(file).map_or(0, |calls| calls.asked.len());
        if answers >= count {
            return;
        }
        assert!(tokio::time::Instant::now() < give_up, "{answers} of {count} answers were written out");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn twenty_places_and_an_arrangement_of_four_planners_are_the_same_from_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let (run, killed) = (folder.path().join("run.mcap"), folder.path().join("killed.mcap"));
    let services = [(Service::Simulator, 1), (Service::Perception, 1), (Service::Inference, 2), (Service::Planner, 4)];
    let deployment = Deployment::start(&services).await;
    let session = deployment.session().await;
    let summary = newest_scene(&session).await;
    let (scene, scene_id) = (whole_scene(&session, &summary).await, summary.scene_id);

    let recorder = recording(&deployment, &session, &run, 8).await;
    let answers = ask(&session, &scene_id, &scene, 0..20).await;
    ask_to_arrange(&session, &scene_id, &scene).await;
    let workers: BTreeSet<&String> = answers.iter().map(|(_, worker)| worker).collect();
    assert!(workers.len() > 1, "several planners answered: {workers:?}");
    on_disk(&run, 21).await;
    recorder.signal(libc::SIGINT);
    let summary = finished(recorder);
    assert_eq!(summary["lost"], 0, "{summary}");
    assert!(summary["messages"]["calls"].as_u64() >= Some(42) && summary["messages"]["scenes"].as_u64() >= Some(1), "{summary}");

    // A recorder that is killed leaves what it had written out. Of a scene that perception has forgotten it could have none: a fresh one.
    let recorder = recording(&deployment, &session, &killed, 8).await;
    let summary = newest_scene(&session).await;
    let (scene, scene_id) = (whole_scene(&session, &summary).await, summary.scene_id);
    ask(&session, &scene_id, &scene, 20..23).await;
    on_disk(&killed, 3).await;
    recorder.signal(libc::SIGKILL);
    drop(recorder);

    for (file, count) in [(&run, 21), (&killed, 3)] {
        let mut command = repose();
        command.args(["--json", "replay"]).arg(file);
        let (output, replayed) = output(command).await;
        let said = || format!("{replayed:#}\n{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!((replayed["requests"].as_u64(), replayed["same"].as_u64()), (Some(count), Some(count)), "{}", said());
        assert!(output.status.success() && replayed["differ"] == serde_json::json!([]), "{}", said());
    }
    of_one_request_and_of_none(&run).await;
    plays(&deployment, &session, &run).await;
}

/// What a recorder that was asked to end says.
fn finished(mut recorder: Process) -> Value {
    let mut said = recorder.0.stdout.take().expect("its output");
    let mut text = String::new();
    std::io::Read::read_to_string(&mut said, &mut text).expect("text");
    assert!(recorder.0.wait().expect("its end").success(), "{text}");
    serde_json::from_str(&text).expect("a document")
}

async fn of_one_request_and_of_none(run: &Path) {
    let calls = calls_in(run).expect("a recording");
    let mut command = repose();
    command.args(["--json", "replay", "--request", &calls.asked[7].id]).arg(run);
    let (_, replayed) = output(command).await;
    assert_eq!((replayed["requests"].as_u64(), replayed["same"].as_u64()), (Some(1), Some(1)), "{replayed:#}");
    let mut command = repose();
    command.args(["--json", "replay", "--request", "no-such-request"]).arg(run);
    let (refused, error) = output(command).await;
    assert_eq!((refused.status.code(), error["error"]["field"].as_str()), (Some(2), Some("request")), "{error}");
}

/// The recording in a cell of its own, as it was; and not into one that lives.
async fn plays(deployment: &Deployment, session: &Session, run: &Path) {
    let command = |cell: &str| {
        let mut command = repose();
        command.args(["--json", "play", "--speed", "5", "--connect", deployment.endpoint(), "--cell", cell]).arg(run);
        command
    };
    let (refused, error) = output(command("cell")).await;
    assert_eq!((refused.status.code(), error["error"]["field"].as_str()), (Some(2), Some("cell")), "{error}");

    let played = session.in_cell("played").expect("a cell");
    let mut states = played.subscribe_queue(&played.cell().robot_states(), 4096).await.expect("a subscription");
    let mut scenes = played.subscribe_queue(&played.cell().scenes(), 256).await.expect("a subscription");
    let perception = played.caller(Service::Perception).await.expect("a caller");
    let playing = tokio::spawn(output(command("played")));
    // What is announced can be fetched, and is what it says it is.
    let sample = tokio::time::timeout(PATIENCE, scenes.recv()).await.expect("in time").expect("a scene");
    let summary: repose_proto::SceneSummary = sample.payload.decode_json().expect("a summary");
    perception.wait_for_workers(1, PATIENCE).await.expect("a worker that answers from the recording");
    let whole = repose_runtime::fetch_scene(&perception, &summary.scene_id, &CallOptions::within(PATIENCE)).await;
    assert_eq!(whole.map(|scene: Scene| scene.id()), Ok(summary.scene_id));
    let (finished, document) = playing.await.expect("no panic");
    assert!(finished.status.success(), "{document}");

    let mut recorded = Vec::new();
    let mut reading = RecordingReader::open(run).expect("a recording");
    while let Some(message) = reading.next_message().expect("readable") {
        if keys::last_chunk(&message.topic) == "state" {
            recorded.push(message.payload);
        }
    }
    let mut heard = Vec::new();
    while let Some(state) = states.try_recv() {
        heard.push(state.payload);
    }
    assert_eq!(document["messages"]["states"].as_u64(), Some(recorded.len() as u64));
    // States may be dropped on the way; none may be another, or out of order.
    let mut rest = recorded.iter();
    assert!(heard.iter().all(|state| rest.any(|recorded| recorded == state)), "states are what they were, in order");
    assert!(heard.len() * 2 > recorded.len(), "{} of {} states", heard.len(), recorded.len());
}
