//! `repose place … --execute --then …` on a live system: wishes carried out by the simulated robot one after another, each on a fresh view.

mod common;

use std::process::Output;
use std::time::Duration;

use common::{Deployment, newest_scene};
use repose_proto::robot::RobotState;
use repose_proto::{Payload, Service};
use repose_runtime::Traffic;
use serde_json::{Value, json};

async fn place(deployment: &Deployment, arguments: &[&str]) -> (Output, Value) {
    run(deployment, &["place"], arguments).await
}

async fn run(deployment: &Deployment, command_name: &[&str], arguments: &[&str]) -> (Output, Value) {
    let mut command = deployment.command();
    command.arg("--json").args(command_name).args(["--connect", deployment.endpoint()]).args(arguments);
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

    let (refused, _) = place(&deployment, &["--move", "1", "--goal", "right_of:2", "--then", "1=left_of:2"]).await;
    let message = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && message.contains("--execute"), "only --execute moves the robot: {message}");
    let (refused, error) = place(&deployment, &["--move", "1", "--goal", "right_of:2", "--execute", "--then", "99=left_of:2"]).await;
    assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
    assert_eq!(error["error"]["field"], "step[1].query");
    let (refused, error) = place(&deployment, &["--move", "1", "--goal", "right_of:2", "--execute", "--then", "1=near:1"]).await;
    assert_eq!((refused.status.code(), error["error"]["code"].as_str()), (Some(2), Some("invalid_argument")), "{error}");
    let after = newest_scene(&session).await;
    let moved_m = before.objects.iter().zip(&after.objects).map(|(a, b)| (a.centroid_m[0] - b.centroid_m[0]).abs()).fold(0.0, f64::max);
    assert!(moved_m < 0.005, "a wish that cannot be is refused before anything moves, and something moved {moved_m} m");

    // The planner's configuration names no robots: where the base stands, this one alone tells.
    let wishes = ["--move", "1", "--goal", "behind:2", "--execute", "--then", "1=left_of:2", "--reach-of", "panda"];
    let (output, document) = place(&deployment, &wishes).await;
    let said = || format!("{document:#}\n{}", String::from_utf8_lossy(&output.stderr));
    let steps = document["steps"].as_array().unwrap_or_else(|| panic!("no steps: {}", said()));
    assert_eq!(document["wanted"], 2);
    assert_eq!(output.status.success(), document["achieved"] == 2, "{}", said());
    // Physics decides whether both can be done; the first is an easy one.
    assert_eq!(steps[0]["execution"], "done", "{}", said());
    assert!(steps.iter().all(|step| step["result"]["robot"]["world_from_base"].is_array()), "{}", said());
    for step in steps.iter().filter(|step| step["execution"] == "done") {
        let fates = step["fates"].as_object().unwrap_or_else(|| panic!("what became of the others is not said: {}", said()));
        assert!(fates.values().all(|fate| fate["fate"] != "stands"), "{}", said());
    }
    if steps[0]["holds"] == serde_json::json!([true]) {
        assert_eq!(steps.len(), 2, "{}", said());
        assert_ne!(steps[0]["result"]["scene_id"], steps[1]["result"]["scene_id"], "the second is planned on a fresh view");
    } else {
        assert_eq!(steps.len(), 1, "nothing is built on a wish that was not achieved: {}", said());
    }

    // An operator's stop holds against everyone until an operator's reset.
    let (stopped, state) = run(&deployment, &["robot", "stop"], &["--reason", "a hand"]).await;
    assert!(stopped.status.success() && state["stop"]["estop_id"].is_string(), "{state}");
    let (refused, document) = place(&deployment, &["--move", "1", "--goal", "right_of:2", "--execute"]).await;
    assert_eq!(refused.status.code(), Some(1), "{document}");
    assert!(document["error"]["message"].as_str().is_some_and(|m| m.contains("a hand")), "{document}");
    assert_eq!(document["steps"].as_array().map(Vec::len), Some(1), "what was planned is said: {document}");
    let (reset, reply) = run(&deployment, &["robot", "reset"], &[]).await;
    assert!(reset.status.success() && reply["was_stopped"] == true, "{reply}");
    let (_, state) = run(&deployment, &["robot", "state"], &[]).await;
    assert!(state["stop"].is_null() && state["q_rad"].as_array().is_some_and(|q| q.len() == 7), "{state}");

    // A stop that does not clear is no fault of what was asked: somebody presses the button still.
    let mut pressed = state;
    (pressed["mode"], pressed["world_from_base"]) = (json!("stopped"), Value::Null);
    pressed["stop"] = json!({"kind": "user_stop", "reason": "the user stop is pressed", "estop_id": null});
    let pressed: RobotState = serde_json::from_value(pressed).expect("a state");
    let told = session.cell().robot_state("pressed");
    let telling = tokio::spawn(async move {
        loop {
            session.put(&told, Payload::json(&pressed).expect("a payload"), Traffic::RobotState).await.expect("it is put");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    });
    let (unready, document) = run(&deployment, &["robot", "reset"], &["--robot", "pressed"]).await;
    assert_eq!(unready.status.code(), Some(1), "{document}");
    telling.abort();
}
