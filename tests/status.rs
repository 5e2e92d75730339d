//! `repose status` and `repose scene` on a live system, and what is said of a cell, camera or robot that is not there.

mod common;

use std::time::{Duration, Instant};

use common::{Deployment, PATIENCE, Refusal, assert_refused_within, newest_scene, run};
use repose_proto::Service;
use serde_json::Value;

/// What it may take to say so: a second, and the start of the program on a busy machine.
const SAID_WITHIN: Duration = Duration::from_secs(3);
/// What is wrong with the system of this test.
const WRONG: [&str; 2] = ["no inference worker is alive", "no planner worker is alive"];

/// What is said to be wrong.
fn wrong(status: &Value) -> Vec<&str> {
    status["wrong"].as_array().into_iter().flatten().filter_map(Value::as_str).collect()
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
        let (output, status, _) = run(deployment.endpoint(), &["status"]).await;
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
    let (output, summary, _) = run(deployment.endpoint(), &["scene", "--out", picture.to_str().expect("a plain path")]).await;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(summary["objects"].as_array().map(Vec::len), Some(scene.objects.len()));
    assert!(picture.exists());

    for (arguments, code, field, there) in [
        (["scene", "--camera", "frnt"], 2, "camera", "front"),
        (["scene", "--cell", "lab"], 1, "cell", "cell"),
        (["robot", "state", "--robot=arm"], 1, "robot", "panda"),
    ] {
        assert_refused_within(SAID_WITHIN, deployment.endpoint(), &arguments, &Refusal { code, field, there }).await;
    }
}
