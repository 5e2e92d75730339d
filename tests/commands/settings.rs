//! Settings in the environment: which commands read them, which are refused, and that a file's count with them.

use repose_proto::RigidTransform;

use super::{ended, folder_with, frame, path, repose_in};

#[test]
fn commands_on_a_frame_read_the_environment_as_the_services_do() {
    let folder = folder_with(&frame());
    let transforms = folder.path().join("transforms.json");
    std::fs::write(&transforms, serde_json::json!([RigidTransform::IDENTITY]).to_string()).expect("written");
    let (frame, transforms) = (path(&folder), transforms.to_str().expect("a plain path"));
    let plan = ["plan", frame, "--move", "1", "--goal", "right_of:2", "--variant", "geometric"];
    let commands: [&[&str]; 6] = [
        &["segment", frame],
        &plan,
        &["arrange", frame, "--goal", "1=right_of:2", "--variant", "geometric"],
        &["relations", frame],
        &["score", frame, "--move", "1", "--anchor", "2", "--transforms", transforms],
        &["bench", "perception", frame, "--runs", "1"],
    ];
    let says = |variable: (&str, &str), arguments: &[&str]| ended(&repose_in(&[variable], arguments));
    for arguments in commands {
        let (code, message) = says(("REPOSE_PERCEPTION__SEGMENTATION__MAX_DEPTH_M", "0.5"), arguments);
        assert!(code == Some(2) && message.contains("between 0 and 0.5 m"), "{arguments:?}: {message}");
    }
    for (field, value) in [("MAX_DEPTH_M", "-4"), ("MAX_DEPTH_M", "nan"), ("MAX_POINTS", "0")] {
        let variable = format!("REPOSE_PERCEPTION__SEGMENTATION__{field}");
        let (code, message) = says((variable.as_str(), value), commands[0]);
        let named = format!("perception.segmentation.{}", field.to_lowercase());
        assert!(code == Some(2) && message.contains(&named), "{field}={value}: {message}");
    }
    let (code, message) = says(("REPOSE_PLANNER__ROBOT", "nobody"), &plan);
    assert!(code == Some(2) && message.contains("nobody is not among robots"), "{message}");
    let (code, message) = says(("REPOSE_PERCEPTION__SEGMENTATION__LEARNED__ENABELD", "false"), commands[0]);
    assert!(code == Some(2) && message.contains("enabeld"), "{message}");
}

#[test]
fn a_misspelt_section_of_the_environment_is_an_error_and_so_is_a_misspelt_field() {
    let folder = folder_with(&frame());
    let says = |name: &str| ended(&repose_in(&[(name, "3")], &["--json", "segment", path(&folder)]));
    let (code, message) = says("REPOSE_PLANER__THREADS");
    assert!(code == Some(2) && message.contains("REPOSE_PLANER__THREADS") && message.contains("REPOSE_PLANNER__"), "{message}");
    let (code, message) = says("REPOSE_PLANNER__THREDS");
    assert!(code == Some(2) && message.contains("threds"), "{message}");
    let (code, message) = says("REPOSE_PORT");
    assert!(code == Some(0) && message.contains("REPOSE_PORT"), "an orchestrator may have set it: {message}");
}

#[test]
fn settings_are_judged_together_with_those_of_the_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("repose.toml");
    let config = file.to_str().expect("a plain path");
    // Where there is no router, what could begin ends soon.
    let nowhere = ["--connect", "tcp/127.0.0.1:9", "--config", config];
    let says = |text: &str, variable: (&str, &str), arguments: &[&str]| {
        std::fs::write(&file, text).expect("written");
        ended(&repose_in(&[variable, ("REPOSE_SESSION__CONNECT_TIMEOUT_MS", "200")], &[arguments, &nowhere].concat()))
    };
    let robots = "[planner]\nrobots = { panda = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0] }\n";
    let robot = ("REPOSE_PLANNER__ROBOT", "panda");
    let (code, message) = says(robots, robot, &["serve", "planner"]);
    assert!(code == Some(1) && !message.contains("among robots"), "{message}");
    let (code, message) = says("", robot, &["serve", "planner"]);
    assert!(code == Some(2) && message.contains("panda is not among robots"), "{message}");
    // The default of one is more than this most.
    let force = ("REPOSE_MOTION__GRIP_FORCE_MAX_N", "25");
    let (code, message) = says("[motion]\ngrip_force_n = 20.0\n", force, &["serve", "motion"]);
    assert!(code == Some(1) && !message.contains("grip_force"), "{message}");
    let (code, message) = says("", force, &["serve", "motion"]);
    assert!(code == Some(2) && message.contains("grip_force_max_n"), "{message}");
    let (code, message) = says("", force, &["robot", "stop"]);
    assert!(code == Some(1) && !message.contains("grip_force"), "whoever stops a robot reads no such section: {message}");
}
