//! `repose status` and `repose scene` on a live system, and what is said of a cell, camera or robot that is not there.

mod common;

use std::process::Output;
use std::time::{Duration, Instant};

use common::{Deployment, PATIENCE, newest_scene, repose};
use repose_proto::Service;
use serde_json::Value;

/// What it may take to say so: a second, and the start of the program on a busy machine.
const SAID_WITHIN: Duration = Duration::from_secs(3);
/// How often it may be tried: a machine that stands still for a second is slow once, and a program that is slow always.
const TRIES: usize = 5;
/// What is wrong with the system of this test.
const WRONG: [&str; 2] = ["no inference worker is alive", "no planner worker is alive"];

/// What is said to be wrong.
fn wrong(status: &Value) -> Vec<&str> {
    status["wrong"].as_array().into_iter().flatten().filter_map(Value::as_str).collect()
}

async fn run(deployment: &Deployment, arguments: &[&str]) -> (Output, Value, Duration) {
    let mut command = repose();
    command.arg("--json").args(arguments).args(["--connect", deployment.endpoint()]);
    let begin = Instant::now();
    let output = tokio::task::spawn_blocking(move || command.output()).await.expect("no panic").expect("the program runs");
    let took = begin.elapsed();
    let document = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output, document, took)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_there_is_told_and_so_is_what_is_not() {
    let services = [Service::Simulator, Service::Perception, Service::Motion].map(|service| (service, 1));
    let deployment = Deployment::start(&services).await;
    let session = deployment.session().await;
    let scene = newest_scene(&session).await;

    // Somebody who waited for a core for a second is said to be silent, as he was: it is looked again until everybody was heard.
    let give_up = Instant::now() + PATIENCE;
    let (output, status) = loop {
        let (output, status, _) = run(&deployment, &["status"]).await;
        let is_seen = status["cameras"][0]["scenes_per_s"].as_f64().is_some_and(|rate| rate > 0.0);
        if (is_seen && wrong(&status) == WRONG) || Instant::now() > give_up {
            break (output, status);
        }
        newest_scene(&session).await;
    };
    let said = || format!("{status:#}\n{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{}", said());
    let alive: Vec<&str> = status["workers"].as_array().expect("workers").iter().filter_map(|w| w["service"].as_str()).collect();
    assert_eq!(alive, ["perception", "motion", "simulator"], "{}", said());
    let perception = &status["workers"][0];
    assert_eq!(perception["load"]["version"], env!("CARGO_PKG_VERSION"), "{}", said());
    assert_eq!((perception["errors_per_s"].as_f64(), perception["calls_per_s"].is_number()), (Some(0.0), true), "{}", said());
    assert_eq!(status["cameras"][0]["camera"], "front", "{}", said());
    assert!(status["cameras"][0]["scenes_per_s"].as_f64().is_some_and(|rate| rate > 0.0), "{}", said());
    assert_eq!(status["robots"][0]["robot"], "panda", "{}", said());
    assert_eq!(wrong(&status), WRONG, "{}", said());

    let folder = tempfile::tempdir().expect("a folder");
    let picture = folder.path().join("scene.png");
    let (output, summary, _) = run(&deployment, &["scene", "--out", picture.to_str().expect("a plain path")]).await;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(summary["objects"].as_array().map(Vec::len), Some(scene.objects.len()));
    assert!(picture.exists());

    for (arguments, code, field, there) in [
        (["scene", "--camera", "frnt"], 2, "camera", "front"),
        (["scene", "--cell", "lab"], 1, "cell", "cell"),
        (["robot", "state", "--robot=arm"], 1, "robot", "panda"),
    ] {
        for tries in 1.. {
            let (output, document, took) = run(&deployment, &arguments).await;
            let error = &document["error"];
            assert_eq!((output.status.code(), error["field"].as_str()), (Some(code), Some(field)), "{arguments:?}: {document}");
            if took < SAID_WITHIN && error["message"].as_str().is_some_and(|message| message.contains(there)) {
                break;
            }
            assert!(tries < TRIES, "{arguments:?} took {took:?}: {document}");
        }
    }
}
