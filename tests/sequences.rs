//! `repose place … --then …` on a live system: wishes carried out by the simulated robot one after another, each on a fresh view.

mod common;

use std::process::Output;

use common::{Deployment, newest_scene, repose};
use repose_proto::Service;
use serde_json::Value;

async fn place(deployment: &Deployment, arguments: &[&str]) -> (Output, Value) {
    let mut command = repose();
    command.args(["--json", "place", "--connect", deployment.endpoint()]).args(arguments);
    let output = tokio::task::spawn_blocking(move || command.output()).await.expect("no panic").expect("the program runs");
    let document = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output, document)
}

#[tokio::test(flavor = "multi_thread")]
async fn each_wish_is_planned_on_what_the_one_before_has_left() {
    let services = [Service::Simulator, Service::Perception, Service::Inference, Service::Planner, Service::Motion].map(|s| (s, 1));
    let deployment = Deployment::start(&services).await;
    let session = deployment.session().await;
    let before = newest_scene(&session).await;

    let (refused, error) = place(&deployment, &["--move", "1", "--goal", "right_of:2", "--then", "99=left_of:2"]).await;
    assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
    assert_eq!(error["error"]["field"], "step[1].query");
    let after = newest_scene(&session).await;
    let moved_m = before.objects.iter().zip(&after.objects).map(|(a, b)| (a.centroid_m[0] - b.centroid_m[0]).abs()).fold(0.0, f64::max);
    assert!(moved_m < 0.005, "a wish for an unknown object is refused before anything moves, and something moved {moved_m} m");

    let (output, document) = place(&deployment, &["--move", "1", "--goal", "behind:2", "--then", "1=left_of:2"]).await;
    let said = || format!("{document:#}\n{}", String::from_utf8_lossy(&output.stderr));
    let steps = document["steps"].as_array().unwrap_or_else(|| panic!("no steps: {}", said()));
    assert_eq!(document["wanted"], 2);
    assert_eq!(output.status.success(), document["achieved"] == 2, "{}", said());
    // Physics decides whether both can be done; the first is an easy one.
    assert_eq!(steps[0]["execution"], "done", "{}", said());
    if steps[0]["holds"] == serde_json::json!([true]) {
        assert_eq!(steps.len(), 2, "{}", said());
        assert_ne!(steps[0]["result"]["scene_id"], steps[1]["result"]["scene_id"], "the second is planned on a fresh view");
    } else {
        assert_eq!(steps.len(), 1, "nothing is built on a wish that was not achieved: {}", said());
    }
}
