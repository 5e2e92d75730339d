//! `repose arrange … --execute` on a live system: several goals brought about by the simulated robot, with a look after every move.

mod common;

use std::process::Output;

use common::{Deployment, newest_scene};
use repose_proto::{ObjectSummary, Service};
use serde_json::Value;

async fn arrange(deployment: &Deployment, goals: &[&str]) -> (Output, Value) {
    let mut command = deployment.command();
    command.args(["--json", "arrange", "--execute", "--connect", deployment.endpoint()]);
    command.args(goals.iter().flat_map(|goal| ["--goal", goal]));
    let output = tokio::task::spawn_blocking(move || command.output()).await.expect("no panic").expect("the program runs");
    let document = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output, document)
}

#[tokio::test(flavor = "multi_thread")]
async fn goals_are_brought_about_move_by_move_and_the_end_is_said() {
    let services = [Service::Simulator, Service::Perception, Service::Inference, Service::Planner, Service::Motion].map(|s| (s, 1));
    let deployment = Deployment::start(&services).await;
    let session = deployment.session().await;
    let before = newest_scene(&session).await;

    let (refused, error) = arrange(&deployment, &["1=right_of:2", "99=left_of:2"]).await;
    assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
    assert_eq!(error["error"]["field"], "goals[1].object", "{error}");
    let (none, document) = arrange(&deployment, &["1=right_of:2", "2=right_of:1"]).await;
    assert_eq!((none.status.code(), document["ended"].as_str()), (Some(3), Some("no_arrangement")), "{document}");
    assert_eq!(document["conflict"]["proof"], "contradiction", "{document}");
    let after = newest_scene(&session).await;
    let moved_m = before.objects.iter().zip(&after.objects).map(|(a, b)| (a.centroid_m[0] - b.centroid_m[0]).abs()).fold(0.0, f64::max);
    assert!(moved_m < 0.005, "what cannot be is refused before anything moves, and something moved {moved_m} m");

    let (output, document) = arrange(&deployment, &["1=behind:2", "3=in_front_of:2"]).await;
    let said = || format!("{document:#}\n{}", String::from_utf8_lossy(&output.stderr));
    let steps = document["steps"].as_array().unwrap_or_else(|| panic!("no steps: {}", said()));
    assert_eq!(document["wanted"], 2, "{}", said());
    // Physics decides whether both can be done; whatever it decides is said.
    assert_eq!(output.status.success(), document["ended"] == "achieved", "{}", said());
    assert_eq!(document["ended"] == "achieved", document["achieved"] == 2, "{}", said());
    assert!(!steps.is_empty() && steps.len() <= 2 * 2 + 2 + 3, "tries are bounded: {}", said());
    assert!(steps.iter().any(|step| step["execution"] == "done"), "an easy one is carried out: {}", said());
    assert!(document["robot"].as_str().is_some_and(|robot| robot.starts_with("panda")), "how the robot stands is said: {}", said());
    for step in steps.iter().filter(|step| step["execution"] == "done") {
        let [object, goal] = [&step["object"], &step["planned"]["goal"]];
        assert!(step["fates"].is_object(), "what became of the others is said: {}", said());
        assert!(object.is_u64() && goal.as_array().is_some_and(|terms| !terms.is_empty()), "{}", said());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_moves_where_the_hand_is_too_small_for_an_object_of_the_plan() {
    // Something flat and wide lies in this scene, and smaller things stand beside it.
    const SEED: u64 = 2200;
    const WIDER_THAN_THE_HAND_M: f64 = 0.09;
    let services = [Service::Simulator, Service::Perception, Service::Inference, Service::Planner, Service::Motion].map(|s| (s, 1));
    let deployment = Deployment::start_on(Some(SEED), &services).await;
    let session = deployment.session().await;
    let before = newest_scene(&session).await;
    let is_wide = |o: &&ObjectSummary| o.extent_m[..2].iter().all(|edge| *edge > WIDER_THAN_THE_HAND_M);
    let wide = before.objects.iter().find(is_wide).unwrap_or_else(|| panic!("no object is too wide: {:?}", before.objects)).id;
    let mut others = before.objects.iter().map(|o| o.id).filter(|id| *id != wide);
    let (other, anchor) = (others.next().expect("one that moves"), others.next().expect("an anchor"));
    let goals = [format!("{other}=in_front_of:{anchor}"), format!("{wide}=left_of:{anchor}")];

    let (output, document) = arrange(&deployment, &goals.each_ref().map(String::as_str)).await;
    let said = || format!("{document:#}\n{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!((output.status.code(), document["ended"].as_str()), (Some(3), Some("no_arrangement")), "{}", said());
    assert!(document["why"].as_str().is_some_and(|why| why.starts_with(&format!("object {wide} must move: no_grasp"))), "{}", said());
    assert_eq!(document["steps"].as_array().map(Vec::len), Some(0), "{}", said());
}
