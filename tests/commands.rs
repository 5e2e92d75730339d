//! The command line on a small frame made here: results, exit codes, and errors that name the field or file.

#[path = "commands/settings.rs"]
mod settings;

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use repose_perception::frame_folder;
use repose_proto::arrange::Proof;
use repose_proto::motion::MotionPlan;
use repose_proto::{ArrangeResult, CameraModel, Frame, PlaceResult, RigidTransform, RobotInView};

const WIDTH: usize = 160;
const HEIGHT: usize = 120;

fn repose(arguments: &[&str]) -> Output {
    repose_in(&[], arguments)
}

/// The command with these variables in its environment.
fn repose_in(environment: &[(&str, &str)], arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_repose"));
    command.envs(environment.iter().copied()).args(arguments).output().expect("the program runs")
}

/// How a command ended, and what it wrote to standard error.
fn ended(output: &Output) -> (Option<i32>, String) {
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// A table seen from 80 cm straight above, with two blocks of 10 cm height on it: object 1 left of object 2 in the picture.
fn frame() -> Frame {
    let world_from_camera = RigidTransform([1., 0., 0., 0., 0., -1., 0., 0., 0., 0., -1., 0.8, 0., 0., 0., 1.]);
    let camera = CameraModel {
        width: WIDTH,
        height: HEIGHT,
        fx: 130.0,
        fy: 130.0,
        cx: 79.5,
        cy: 59.5,
        depth_unit_m: 0.001,
        world_from_camera: Some(world_from_camera),
    };
    let label = |i: usize| match (i % WIDTH, i / WIDTH) {
        (45..=60, 50..=68) => 1,
        (95..=112, 52..=70) => 2,
        _ => 0,
    };
    let labels: Vec<u16> = (0..WIDTH * HEIGHT).map(label).collect();
    let depth = labels.iter().map(|l| if *l == 0 { 800 } else { 700 }).collect();
    Frame { labels: Some(labels), ..Frame::new("above".into(), 0, camera, depth) }
}

fn folder_with(frame: &Frame) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    frame_folder::write(folder.path(), frame).expect("the frame is written");
    folder
}

fn path(folder: &tempfile::TempDir) -> &str {
    folder.path().to_str().expect("a plain path")
}

#[test]
fn plan_finds_a_placement_and_says_the_same_twice() {
    let folder = folder_with(&frame());
    let picture = folder.path().join("picture.png");
    let arguments = ["--json", "plan", path(&folder), "--move", "1", "--goal", "right_of:2", "--variant", "geometric", "--seed", "5"];
    let first = repose(&[&arguments[..], &["--out", picture.to_str().expect("a plain path")]].concat());
    assert_eq!(first.status.code(), Some(0), "{}", String::from_utf8_lossy(&first.stderr));
    assert_eq!(first.stdout, repose(&arguments).stdout);
    assert!(picture.exists());
    let result: PlaceResult = serde_json::from_slice(&first.stdout).expect("a PlaceResult");
    let best = &result.placements[0];
    let anchor_x_m = 0.1;
    assert!(best.placed_from_observed.0[3] > anchor_x_m, "it goes to the right: {:?}", best.placed_from_observed);
    assert!(best.geometric[0].holds && best.support_m > Some(0.0));
}

/// The frame with object 1 narrow enough for a gripper, and a robot whose base is at `x_m`, turned as the world is.
fn frame_with_robot(x_m: f64) -> Frame {
    let mut frame = frame();
    let narrow = |i: usize| (48..=57).contains(&(i % WIDTH)) && (54..=64).contains(&(i / WIDTH));
    for (i, label) in frame.labels.iter_mut().flatten().enumerate().filter(|(i, label)| **label == 1 && !narrow(*i)) {
        (*label, frame.depth[i]) = (0, 800);
    }
    let mut world_from_base = RigidTransform::IDENTITY;
    world_from_base.0[3] = x_m;
    let joints_rad = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785];
    let (name, model) = ("panda".to_owned(), "panda".to_owned());
    frame.robots = vec![RobotInView { name, model, joints_rad, gripper_width_m: 0.08, holding: None, world_from_base }];
    frame
}

#[test]
fn a_motion_is_planned_for_the_base_that_the_frame_tells() {
    let planned = |x_m: f64| {
        let folder = folder_with(&frame_with_robot(x_m));
        let motion = folder.path().join("motion.json");
        let wish = ["--move", "1", "--goal", "left_of:2", "--variant", "geometric", "--count", "4"];
        let out = ["--motion", motion.to_str().expect("a plain path")];
        let output = repose(&[&["plan", path(&folder)], &wish[..], &out[..]].concat());
        let plan = std::fs::read(&motion).ok().map(|bytes| serde_json::from_slice::<MotionPlan>(&bytes).expect("a MotionPlan"));
        (output.status.code(), plan, String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, near, message) = planned(-0.75);
    assert!(code == Some(0) && near.is_some(), "{message}");
    let (_, nearer, _) = planned(-0.7);
    assert!(nearer.is_some_and(|plan| Some(plan) != near), "another base, another motion");
    let (code, far, message) = planned(50.0);
    assert!(code == Some(1) && far.is_none(), "nothing there is within reach: {message}");
}

#[test]
fn of_several_robots_that_one_moves_within_whose_reach_the_placement_is() {
    let mut frame = frame_with_robot(-0.75);
    let far = RobotInView { name: "far".to_owned(), ..frame_with_robot(50.0).robots.remove(0) };
    frame.robots.insert(0, far);
    let folder = folder_with(&frame);
    let motion = folder.path().join("motion.json");
    let plan = |robot: &[&str]| {
        let wish = ["--move", "1", "--goal", "left_of:2", "--variant", "geometric", "--count", "4"];
        let out = ["--motion", motion.to_str().expect("a plain path")];
        let output = repose(&[&["plan", path(&folder)], &wish[..], &out[..], robot].concat());
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, message) = plan(&["--reach-of", "panda"]);
    assert_eq!(code, Some(0), "{message}");
    let planned: MotionPlan = serde_json::from_slice(&std::fs::read(&motion).expect("a motion")).expect("a MotionPlan");
    assert_eq!(planned.robot, "panda");
    let (code, message) = plan(&[]);
    assert_eq!(code, Some(1), "the first is meant, and is far off: {message}");
}

#[test]
fn arrange_says_which_moves_make_all_goals_hold_or_which_goals_cannot() {
    let folder = folder_with(&frame());
    let arrange = |goals: &[&str]| {
        let goals: Vec<&str> = goals.iter().flat_map(|goal| ["--goal", goal]).collect();
        repose(&[&["--json", "arrange", path(&folder), "--variant", "geometric", "--max-parkings", "0"], &goals[..]].concat())
    };
    let holds_already = arrange(&["1=left_of:2"]);
    assert_eq!(holds_already.status.code(), Some(0), "{}", String::from_utf8_lossy(&holds_already.stderr));
    let result: ArrangeResult = serde_json::from_slice(&holds_already.stdout).expect("an ArrangeResult");
    assert_eq!((result.moves.len(), result.satisfied, result.searches), (0, vec![1], 0));

    let changed = arrange(&["1=behind:2"]);
    let result: ArrangeResult = serde_json::from_slice(&changed.stdout).expect("an ArrangeResult");
    assert_eq!(result.moves.iter().map(|m| m.object).collect::<Vec<_>>(), [1], "{result:?}");
    assert_eq!(changed.stdout, arrange(&["1=behind:2"]).stdout, "the same request, the same bytes");

    let impossible = arrange(&["1=left_of:2", "2=left_of:1"]);
    assert_eq!(impossible.status.code(), Some(3), "{}", String::from_utf8_lossy(&impossible.stderr));
    let result: ArrangeResult = serde_json::from_slice(&impossible.stdout).expect("an ArrangeResult");
    assert_eq!(result.conflict.map(|c| (c.proof, c.goals.len())), Some((Proof::Contradiction, 2)));

    let unknown = arrange(&["1=left_of:9"]);
    let text = String::from_utf8_lossy(&unknown.stderr);
    assert!(unknown.status.code() == Some(2) && text.contains("goals[0].terms[0].anchor"), "{text}");
}

#[test]
fn no_placement_is_an_outcome_with_reasons_and_an_exit_code_of_its_own() {
    let folder = folder_with(&frame());
    let goals = ["--goal", "right_of:2", "--goal", "left_of:2"];
    let arguments = [&["--json", "plan", path(&folder), "--move", "1", "--variant", "geometric"], &goals[..]].concat();
    let none = repose(&arguments);
    assert_eq!(none.status.code(), Some(3), "{}", String::from_utf8_lossy(&none.stderr));
    let result: PlaceResult = serde_json::from_slice(&none.stdout).expect("a PlaceResult");
    assert!(result.placements.is_empty());
    assert!(result.rejections.values().sum::<u64>() > 0, "reasons are given");
}

#[test]
fn bad_input_exits_with_2_and_names_what_is_wrong() {
    let good = folder_with(&frame());
    let no_depth = folder_with(&frame());
    std::fs::remove_file(no_depth.path().join("depth.png")).expect("there was a depth picture");
    let odd_camera = folder_with(&frame());
    edit(odd_camera.path(), "\"fx\"", "\"focal\"");
    let other_size = folder_with(&frame());
    edit(other_size.path(), "\"width\": 160", "\"width\": 161");
    let empty_camera = folder_with(&frame());
    std::fs::write(empty_camera.path().join("camera.json"), "").expect("written");
    let plan = |folder: &str, query: &str, goal: &[&str]| {
        let goals: Vec<&str> = goal.iter().flat_map(|g| ["--goal", g]).collect();
        repose(&[&["plan", folder, "--move", query, "--variant", "geometric"], &goals[..]].concat())
    };
    let cases = [
        (plan(path(&good), "1", &["beside:2"]), "beside"),
        (plan(path(&good), "1", &["not:near:2"]), "goal"),
        (plan(path(&good), "1", &["left_of:1"]), "goal[0].anchor"),
        (plan(path(&good), "1", &["left_of:9"]), "goal[0].anchor"),
        (plan(path(&good), "9", &["left_of:2"]), "query"),
        (plan(path(&no_depth), "1", &["left_of:2"]), "depth.png"),
        (plan(path(&odd_camera), "1", &["left_of:2"]), "camera.json"),
        (plan(path(&empty_camera), "1", &["left_of:2"]), "camera.json: EOF"),
        (plan(path(&other_size), "1", &["left_of:2"]), "depth.png"),
        (
            repose(&["plan", path(&good), "--move", "1", "--goal", "left_of:2", "--reach-of", "panda"]),
            "reach-of: the frame has no robot.json",
        ),
        (plan("no/such/folder", "1", &["left_of:2"]), "no/such/folder"),
        (repose(&["score", path(&good), "--move", "1", "--anchor", "2", "--transforms", "no/such.json"]), "no/such.json"),
    ];
    for (output, named) in cases {
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.contains(named), "{named} is not in {text}");
    }
    let json = repose(&["--json", "plan", path(&no_depth), "--move", "1", "--goal", "left_of:2"]);
    let document: serde_json::Value = serde_json::from_slice(&json.stdout).expect("one JSON document");
    assert_eq!(document["error"]["code"], "invalid_argument");
}

#[test]
fn a_command_line_that_cannot_be_read_is_refused_in_the_document_too() {
    let cases: [(&[&str], &str); 4] = [
        (&["--json", "place", "--move", "x", "--goal", "near:2"], "move"),
        (&["place", "--move", "1", "--json"], "goal"),
        (&["segment", "frame", "--json", "--no-such"], "no-such"),
        (&["--json", "plaice"], "command"),
    ];
    for (arguments, field) in cases {
        let output = repose(arguments);
        let (code, message) = ended(&output);
        assert!(code == Some(2) && message.contains("--help"), "{arguments:?}: {message}");
        let document: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
        let error = &document["error"];
        assert_eq!((error["code"].as_str(), error["field"].as_str()), (Some("invalid_argument"), Some(field)), "{document}");
        assert!(error["message"].as_str().is_some_and(|words| !words.is_empty() && !words.contains('\n')), "{document}");
    }
    let without = repose(&["place", "--move", "x", "--goal", "near:2"]);
    assert!(without.status.code() == Some(2) && without.stdout.is_empty());
    let help = repose(&["place", "--json", "--help"]);
    assert!(help.status.success() && String::from_utf8_lossy(&help.stdout).contains("Usage:"), "help is no error");
}

#[test]
fn an_error_that_nobody_reads_has_its_exit_code_all_the_same() {
    // As in `repose … | true`: the reader has gone before anything is written.
    let unread = || {
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        writer
    };
    let mut command = Command::new(env!("CARGO_BIN_EXE_repose"));
    command.args(["--json", "plan", "no/such/folder", "--move", "1", "--goal", "left_of:2"]);
    let output = command.stdout(unread()).stderr(Stdio::piped()).spawn().and_then(Child::wait_with_output).expect("the program runs");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && !message.contains("panicked"), "{message}");
    let status = command.stdout(Stdio::null()).stderr(unread()).status().expect("the program runs");
    assert_eq!(status.code(), Some(2));
}

fn edit(folder: &Path, from: &str, to: &str) {
    let path = folder.join("camera.json");
    let text = std::fs::read_to_string(&path).expect("a camera");
    assert!(text.contains(from), "{from} is in {text}");
    std::fs::write(&path, text.replace(from, to)).expect("it is written");
}

#[test]
fn relations_and_scores_are_given_for_every_pair_and_transform() {
    let folder = folder_with(&frame());
    let relations = repose(&["--json", "relations", path(&folder)]);
    let document: serde_json::Value = serde_json::from_slice(&relations.stdout).expect("one JSON document");
    let pairs = document["pairs"].as_array().expect("pairs");
    assert_eq!(pairs.len(), 2);
    let pair = pairs.iter().find(|p| p["query"] == 1).expect("the pair of 1 and 2");
    assert_eq!((pair["learned"].as_array().map(Vec::len), pair["rule"].as_array().map(Vec::len)), (Some(10), Some(10)));
    assert_eq!(pair["rule"][0], true, "object 1 is left of object 2");
    let transforms = folder.path().join("transforms.json");
    std::fs::write(&transforms, serde_json::json!([RigidTransform::IDENTITY, RigidTransform::IDENTITY]).to_string()).expect("written");
    let file = transforms.to_str().expect("a plain path");
    let scores = repose(&["--json", "score", path(&folder), "--move", "1", "--anchor", "2", "--transforms", file]);
    let document: serde_json::Value = serde_json::from_slice(&scores.stdout).expect("one JSON document");
    let realism = document["realism"].as_array().expect("realism");
    assert_eq!(realism.len(), 2);
    assert_eq!(realism[0], realism[1], "the same candidate has the same score");
}

#[test]
fn segment_lists_objects_and_surfaces_and_writes_labels() {
    let folder = folder_with(&frame());
    let labels = folder.path().join("found.png");
    let segmented = repose(&["--json", "segment", path(&folder), "--labels-out", labels.to_str().expect("a plain path")]);
    let document: serde_json::Value = serde_json::from_slice(&segmented.stdout).expect("one JSON document");
    assert_eq!(document["objects"].as_array().map(Vec::len), Some(2));
    assert!(!document["surfaces"].as_array().expect("surfaces").is_empty());
    assert!(labels.exists());
}

#[test]
fn a_frame_that_is_smaller_than_a_number_is_drawn_too() {
    const SIDES: [usize; 2] = [50, 40];
    let label = |i: usize| match (i % SIDES[0], i / SIDES[0]) {
        (10..=18, 12..=22) => 1,
        (30..=38, 12..=22) => 2,
        _ => 0,
    };
    let labels: Vec<u16> = (0..SIDES[0] * SIDES[1]).map(label).collect();
    let depth = labels.iter().map(|l| if *l == 0 { 800 } else { 700 }).collect();
    let camera = CameraModel { width: SIDES[0], height: SIDES[1], fx: 40.0, fy: 40.0, cx: 24.5, cy: 19.5, ..frame().camera };
    let folder = folder_with(&Frame { labels: Some(labels), ..Frame::new("above".into(), 0, camera, depth) });
    let picture = folder.path().join("found.png");
    let segmented = repose(&["--json", "segment", path(&folder), "--out", picture.to_str().expect("a plain path")]);
    assert_eq!(segmented.status.code(), Some(0), "{}", String::from_utf8_lossy(&segmented.stderr));
    let document: serde_json::Value = serde_json::from_slice(&segmented.stdout).expect("one JSON document");
    assert!(document["surfaces"].as_array().is_some_and(|surfaces| !surfaces.is_empty()), "their heights are drawn: {document}");
    assert!(picture.exists());
}

#[test]
fn the_networks_are_those_of_the_command_line_or_of_the_environment() {
    let folder = folder_with(&frame());
    let says = |environment: &[(&str, &str)], arguments: &[&str]| ended(&repose_in(environment, arguments));
    let plan = ["plan", path(&folder), "--move", "1", "--goal", "right_of:2"];
    let weights = [("REPOSE_INFERENCE__WEIGHTS", "/no/weights")];
    let (code, message) = says(&weights, &["relations", path(&folder)]);
    assert!(code == Some(2) && message.contains("/no/weights"), "{message}");
    let (code, message) = says(&weights, &[&plan[..], &["--weights", "/none/either"]].concat());
    assert!(code == Some(2) && message.contains("/none/either"), "{message}");
}

#[test]
fn the_outcome_network_answers_for_realism_where_it_is_asked() {
    let folder = folder_with(&frame());
    let transforms = folder.path().join("transforms.json");
    std::fs::write(&transforms, "[[1,0,0,0.3, 0,1,0,0, 0,0,1,0.05, 0,0,0,1]]").expect("written");
    let score = |by: &[&str]| {
        let transforms = transforms.to_str().expect("a plain path");
        let arguments = ["--json", "score", path(&folder), "--move", "1", "--anchor", "2", "--transforms", transforms];
        let output = repose(&[&arguments[..], by].concat());
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    };
    assert_eq!(score(&[]), score(&["--realism-by", "discriminator"]));
    assert_ne!(score(&[]), score(&["--realism-by", "outcome"]));
}

#[test]
fn without_a_router_a_client_says_what_to_start() {
    let environment = [("REPOSE_SESSION__CONNECT_TIMEOUT_MS", "200")];
    let arguments = ["--json", "place", "--connect", "tcp/127.0.0.1:9", "--move", "1", "--goal", "left_of:2"];
    let output = repose_in(&environment, &arguments);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(document["error"]["code"], "unavailable");
    assert!(message.contains("`repose up`") && !message.contains(".rs:") && !message.contains('\u{1b}'), "{message}");
}

#[test]
fn a_bridge_without_a_ros_router_names_its_own_session() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port").local_addr().expect("its address").port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let mut router =
        Command::new(env!("CARGO_BIN_EXE_repose")).args(["serve", "router", "--connect", &endpoint]).spawn().expect("it starts");
    let session = "REPOSE_ROS2__SESSION__";
    let [connect, mode, timeout] = ["CONNECT", "MODE", "CONNECT_TIMEOUT_MS"].map(|field| format!("{session}{field}"));
    let settings = [(connect.as_str(), "tcp/127.0.0.1:9"), (mode.as_str(), "client"), (timeout.as_str(), "200")];
    let output = repose_in(&settings, &["serve", "ros2", "--connect", &endpoint]);
    router.kill().and_then(|()| router.wait()).expect("it ends");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && message.contains("[ros2.session]") && message.contains("rmw_zenohd"), "{message}");
}

#[test]
fn a_picture_is_a_png_and_what_cannot_be_written_is_said_before_the_work() {
    let folder = folder_with(&frame());
    let plan =
        |out: &str| ended(&repose(&["plan", path(&folder), "--move", "1", "--goal", "right_of:2", "--variant", "geometric", "--out", out]));
    let (code, message) = plan("plan.jpg");
    assert!(code == Some(2) && message.contains(".png"), "{message}");
    let below_a_file = folder.path().join("camera.json/plan.png");
    let (code, message) = plan(below_a_file.to_str().expect("a plain path"));
    assert!(code == Some(2) && message.contains("camera.json"), "{message}");
    let demo = repose(&["demo", "--out", below_a_file.to_str().expect("a plain path")]);
    assert_eq!(demo.status.code(), Some(2), "{}", String::from_utf8_lossy(&demo.stderr));
}

#[test]
fn fewer_placements_than_asked_for_are_said_to_be_fewer() {
    let folder = folder_with(&frame());
    let arguments = ["plan", path(&folder), "--move", "1", "--goal", "right_of:2", "--variant", "geometric", "--count", "64"];
    let output = repose(&arguments);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.contains("64 were asked for"), "{text}");
    assert!(!text.contains("realism"), "nobody was asked for realism: {text}");
}

#[test]
fn what_only_a_system_of_its_own_can_do_is_refused_for_another() {
    let refused = |environment: &[(&str, &str)], arguments: &[&str]| {
        let (code, message) = ended(&repose_in(environment, &[&["load"], arguments].concat()));
        assert_eq!(code, Some(2), "{arguments:?}: {message}");
        message
    };
    let (endpoint, variable) = ("tcp/127.0.0.1:9", [("REPOSE_CONNECT", "tcp/127.0.0.1:9")]);
    let options: [&[&str]; 5] =
        [&["--fault", "kill:inference:2s"], &["--planners", "2"], &["--inference", "2"], &["--routers", "2"], &["--secured"]];
    for option in options {
        assert!(refused(&[], &[&["--connect", endpoint], option].concat()).contains("--up"));
        assert!(refused(&variable, option).contains("--up"));
    }
    assert!(refused(&[], &["--up", "--connect", endpoint]).contains("--connect"));
    assert!(refused(&variable, &["--up"]).contains("REPOSE_CONNECT"));
}

#[test]
fn what_cannot_be_read_or_written_is_said_before_long_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("file");
    std::fs::write(&file, "").expect("written");
    let (out, below_a_file) = (folder.path().join("out"), file.join("weights.safetensors"));
    let [out_text, below_text] = [&out, &below_a_file].map(|path| path.to_str().expect("a plain path"));
    let generate = repose(&["generate", "--scenes", "1", "--proposals", "4", "--weights", "no/such.st", "--out", out_text]);
    let message = String::from_utf8_lossy(&generate.stderr);
    assert!(generate.status.code() == Some(2) && message.contains("no/such.st"), "{message}");
    assert!(!out.exists(), "no scene was made");
    // Whether there is anything to learn from is looked at later.
    for network in ["joint", "back"] {
        let train = repose(&["train", "--data", path(&folder), "--network", network, "--steps", "1", "--out", below_text]);
        let message = String::from_utf8_lossy(&train.stderr);
        assert!(train.status.code() == Some(2) && message.contains("file"), "{network}: {message}");
    }
}

#[test]
fn an_endpoint_that_is_none_is_refused_in_our_words() {
    /// Variables, arguments, and what is named.
    type Case<'a> = (&'a [(&'a str, &'a str)], &'a [&'a str], &'a str);
    let cases: [Case<'_>; 5] = [
        (&[], &["scene", "--connect", "127.0.0.1:17447"], "connect: expected tcp/HOST:PORT"),
        (&[("REPOSE_CONNECT", "foo")], &["scene"], "connect: expected tcp/HOST:PORT"),
        (&[("REPOSE_SESSION__CONNECT", "foo")], &["scene"], "connect: expected tcp/HOST:PORT"),
        (&[], &["up", "--listen", "foo"], "listen: expected tcp/HOST:PORT"),
        (&[("REPOSE_TELEMETRY__LISTEN", "foo")], &["serve", "planner"], "telemetry.listen: expected HOST:PORT"),
    ];
    for (environment, arguments, named) in cases {
        let (code, message) = ended(&repose_in(environment, arguments));
        assert_eq!(code, Some(2), "{arguments:?}: {message}");
        assert!(message.contains(named) && !message.contains(".rs"), "{message}");
    }
}

#[test]
fn what_would_go_unheeded_is_refused() {
    let folder = folder_with(&frame());
    let frame = path(&folder);
    let goal = ["--goal", "1=right_of:2"];
    let cases: [(&[&str], &str); 11] = [
        (&["segment", frame, "--depth-topic", "/depth"], "depth-topic"),
        (&["play", frame, "--speed", "2"], "speed: is for a recording"),
        (&["load", "--slo", "p99<200ms"], "--find-capacity"),
        (&["load", "--find-capacity", "--rate", "5"], "--rate"),
        (&["segment", "run.mcap", "--depth-topic", "/depth", "--clouds"], "--clouds"),
        (&["place", "--move", "1", "--goal", "near:2", "--robot", "nope"], "--execute"),
        (&["place", "--move", "1", "--goal", "near:2", "--attempts", "5"], "--execute"),
        (&["place", "--move", "1", "--goal", "near:2", "--scene", "00", "--robot", "nope"], "--scene"),
        (&["arrange", frame, goal[0], goal[1], "--connect", "tcp/127.0.0.1:9"], "connect: is of a running system"),
        (&["arrange", frame, goal[0], goal[1], "--camera", "front"], "--camera"),
        (&["arrange", goal[0], goal[1], "--weights", "w.safetensors"], "weights: is for a frame"),
    ];
    for (arguments, named) in cases {
        let (code, message) = ended(&repose(arguments));
        assert!(code == Some(2) && message.contains(named), "{arguments:?}: {message}");
    }
    let arrange = ["arrange", frame, goal[0], goal[1], "--variant", "geometric"];
    let set_for_others = repose_in(&[("REPOSE_CONNECT", "tcp/127.0.0.1:9"), ("REPOSE_CELL", "lab")], &arrange);
    assert_eq!(set_for_others.status.code(), Some(0), "{}", String::from_utf8_lossy(&set_for_others.stderr));
}
