//! `repose up --cells`: simulated cells that share one pool of planners and inference workers, as processes of the program.

mod common;

use std::net::TcpListener;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use common::{PATIENCE, Process, Refusal, assert_refused_within, copy_their_calls, newest_scene, repose, run};
use repose_proto::place::{Budget, Variant};
use repose_proto::{ErrorCode, GoalTerm, PlaceRequest, Relation, SceneSummary, Service};
use repose_recorder::calls::{Calls, scenes_of};
use repose_recorder::replay::is_repeatable;
use repose_runtime::{CallOptions, RuntimeConfig, Session, SessionMode};
use serde_json::{Value, json};

/// What it may take to say that a pool is not there: a second, and the start of the program on a busy machine.
const SAID_WITHIN: Duration = Duration::from_secs(4);

/// Waits until `up` says that it is.
fn is_up(said: &Path) -> Value {
    let give_up = Instant::now() + PATIENCE;
    loop {
        let text = std::fs::read_to_string(said).expect("what it says");
        match serde_json::from_str(&text) {
            Ok(document) => return document,
            Err(_) if Instant::now() < give_up => std::thread::sleep(Duration::from_millis(100)),
            Err(_) => panic!("it is not up: {text}"),
        }
    }
}

async fn session(endpoint: &str, cell: &str) -> Session {
    let mut config = RuntimeConfig::default();
    config.session.mode = SessionMode::Client;
    config.session.connect = vec![endpoint.to_owned()];
    config.session.cell = cell.to_owned();
    config.caller.pool = Some("rack".to_owned());
    Session::open(config).await.expect("a session")
}

/// The cell's newest scene, and the planner that answered a request on it.
async fn placed(session: &Session) -> (SceneSummary, String) {
    let planner = session.caller(Service::Planner).await.expect("a caller");
    planner.wait_for_workers(1, PATIENCE).await.expect("the pool's planner");
    let scene = newest_scene(session).await;
    let term = GoalTerm { relation: Relation::Near, anchor: scene.objects[1].id, holds: true };
    let request = PlaceRequest {
        variant: Variant::Full,
        budget: Budget { iterations: Some(1), batch: Some(4), ..Budget::default() },
        ..PlaceRequest::new(scene.scene_id.clone(), scene.objects[0].id, vec![term])
    };
    // By its id alone: the pool fetches it from the cell.
    let (result, answer) = planner.place(&request, None, CallOptions::within(PATIENCE)).await.expect("an answer");
    assert!(result.evaluated > 0 && !result.weights_hash.is_empty(), "{result:?}");
    (scene, answer.worker)
}

/// Looks until what is printed is as it should be.
async fn seen(endpoint: &str, arguments: &[&str], is_right: impl Fn(&Value) -> bool) {
    let give_up = Instant::now() + PATIENCE;
    loop {
        let (_, document, _) = run(endpoint, arguments).await;
        if is_right(&document) {
            return;
        }
        assert!(Instant::now() < give_up, "{arguments:?}: {document:#}");
    }
}

/// Records the pool, whose two workers copy their calls from now on.
async fn recording_the_pool(endpoint: &str, session: &Session, file: &Path) -> Process {
    let rack = session.in_cell("rack").expect("a cell");
    let mut loads = rack.subscribe_queue(&rack.cell().all_loads(), 256).await.expect("a subscription");
    let mut command = repose();
    command.args(["--json", "record", "--cell", "rack", "--connect", endpoint, "--out"]).arg(file).stdout(Stdio::null());
    let recorder = Process(command.spawn().expect("the recorder"));
    copy_their_calls(&mut loads, 2).await;
    recorder
}

/// Ends a recording of the pool: it has the scenes, which are the cells', and what was asked about them by their ids alone is answered alike.
async fn is_asked_again(mut recorder: Process, file: &Path, scene_ids: [&String; 2]) {
    recorder.signal(libc::SIGINT);
    assert!(recorder.0.wait().expect("its end").success());
    let files = [file.to_owned()];
    let calls = Calls::read(&files, |service, call| is_repeatable(service, &call.method)).expect("a recording");
    let scenes = scenes_of(&calls.asked, &files).expect("a recording");
    assert!(scene_ids.iter().all(|id| scenes.contains_key(*id)), "{:?} of {scene_ids:?}", scenes.keys());
    let mut command = repose();
    command.args(["--json", "replay"]).arg(file);
    let output = tokio::task::spawn_blocking(move || command.output()).await.expect("no panic").expect("the program runs");
    let replayed: Value = serde_json::from_slice(&output.stdout).expect("a document");
    assert_eq!((&replayed["requests"], &replayed["same"]), (&json!(2), &json!(2)), "{replayed:#}");
}

#[tokio::test(flavor = "multi_thread")]
async fn two_simulated_cells_share_one_pool_and_each_is_answered_for_its_own_scene() {
    let folder = tempfile::tempdir().expect("a folder");
    let said = folder.path().join("up.json");
    let port = TcpListener::bind("127.0.0.1:0").expect("a free port").local_addr().expect("its address").port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let mut command = repose();
    command.args(["--json", "up", "--cells", "2", "--listen", &endpoint]).env("REPOSE_INFERENCE__THREADS", "1");
    command.env("REPOSE_CONSOLE__LISTEN", "127.0.0.1:0").stdout(Stdio::from(std::fs::File::create(&said).expect("a file")));
    let up = Process(command.spawn().expect("it starts"));
    let document = is_up(&said);
    assert_eq!((&document["cells"], &document["pool"]), (&json!(["cell-1", "cell-2"]), &json!("rack")), "{document:#}");

    let (first, second) = (session(&endpoint, "cell-1").await, session(&endpoint, "cell-2").await);
    let file = folder.path().join("rack.mcap");
    let recorder = recording_the_pool(&endpoint, &first, &file).await;
    let ((first_scene, planner), (second_scene, same_planner)) = tokio::join!(placed(&first), placed(&second));
    assert_ne!(first_scene.scene_id, second_scene.scene_id);
    assert_eq!(planner, same_planner);
    is_asked_again(recorder, &file, [&first_scene.scene_id, &second_scene.scene_id]).await;
    // Nobody fetches a scene from where it is not of.
    let elsewhere = PlaceRequest::new("0".repeat(64), 1, vec![GoalTerm { relation: Relation::Near, anchor: 2, holds: true }]);
    let caller = first.caller(Service::Planner).await.expect("a caller");
    let unknown = caller.place(&elsewhere, None, CallOptions::within(PATIENCE)).await.expect_err("no such scene");
    assert_eq!((unknown.code, unknown.field.as_deref()), (ErrorCode::NotFound, Some("scene_id")), "{unknown}");

    let cell = |name: &str| json!({"cell": name, "cameras": ["front"], "robots": ["panda"], "workers": {"perception": 1, "motion": 1, "simulator": 1}});
    let rack = json!({"cell": "rack", "cameras": [], "robots": [], "workers": {"inference": 1, "planner": 1}});
    // Who waits for a core is not heard while it is listened, and is heard the next time.
    let all = json!({"cells": [cell("cell-1"), cell("cell-2"), rack]});
    seen(&endpoint, &["cells"], |named| *named == all).await;
    seen(&endpoint, &["status", "--cell", "cell-2", "--pool", "rack"], |status| {
        let wrong = status["wrong"].as_array().expect("sentences");
        !wrong.iter().any(|sentence| sentence.as_str().is_some_and(|s| s.starts_with("no ")))
    })
    .await;

    let place = ["place", "--cell", "cell-1", "--pool", "rakc", "--move", "1", "--goal", "near:2"];
    assert_refused_within(SAID_WITHIN, &endpoint, &place, &Refusal { code: 1, field: "pool", there: "rack" }).await;

    // Killed before it can tell anybody: what it started ends all the same.
    first.close().await.expect("it closes");
    second.close().await.expect("it closes");
    drop(up);
    let begin = Instant::now();
    while let Err(error) = TcpListener::bind(("127.0.0.1", port)) {
        assert!(begin.elapsed() < PATIENCE, "the router is still there: {error}");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}
