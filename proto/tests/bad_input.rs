//! Bad input gets the contract's error, and the error names the field at fault.

mod common;

use bytes::Bytes;
use common::*;
use proptest::prelude::*;
use repose_proto::scoring::ScoreRequest;
use repose_proto::*;

fn field(error: &CallError) -> &str {
    assert_eq!(error.code, ErrorCode::InvalidArgument, "{error}");
    assert!(!error.message.is_empty());
    assert!(!error.retryable);
    error.field.as_deref().unwrap_or_else(|| panic!("no field in {error}"))
}

fn place_json(edit: impl FnOnce(&mut serde_json::Value)) -> Result<PlaceRequest, CallError> {
    let mut value = serde_json::to_value(place_request()).unwrap();
    edit(&mut value);
    let payload = Payload { encoding: "application/json;repose.PlaceRequest.v1".into(), bytes: value.to_string().into() };
    payload.decode_json()
}

#[test]
fn a_place_request_names_the_field_at_fault() {
    type Edit = fn(&mut serde_json::Value);
    let cases: [(&str, Edit); 20] = [
        ("colour", |v| v["colour"] = "red".into()),
        ("goal[0].relation", |v| v["goal"][0]["relation"] = "beside".into()),
        ("goal[0].sure", |v| v["goal"][0]["sure"] = true.into()),
        ("goal[0].anchor", |v| v["goal"][0]["anchor"] = 1.into()),
        ("goal[1].anchor", |v| v["goal"][1]["anchor"] = 0.into()),
        ("goal", |v| v["goal"] = serde_json::json!([])),
        ("goal", |v| v["goal"] = serde_json::json!([{"relation": "near", "anchor": 2, "holds": false}])),
        ("query", |v| v["query"] = 0.into()),
        ("query", |v| drop(v.as_object_mut().unwrap().remove("query"))),
        ("query", |v| v["query"] = 70_000.into()),
        ("scene.scene_id", |v| v["scene"]["scene_id"] = "abc".into()),
        ("count", |v| v["count"] = 0.into()),
        ("budget.batch", |v| v["budget"]["batch"] = 100_000.into()),
        ("thresholds.realism", |v| v["thresholds"]["realism"] = 1.5.into()),
        ("region[0]", |v| v["region"][0]["min_m"] = serde_json::json!([2.0, 0.0, 0.0])),
        ("region", |v| v["region"] = vec![v["region"][0].clone(); limits::MAX_REGIONS + 1].into()),
        ("variant", |v| v["variant"] = "better".into()),
        ("min_success", |v| v["min_success"] = 1.25.into()),
        ("robot.name", |v| v["robot"] = serde_json::json!({"name": "Arm 1"})),
        ("robot.world_from_base", |v| v["robot"] = serde_json::json!({"name": "arm", "world_from_base": vec![0.0; 16]})),
    ];
    assert!(place_json(|_| ()).is_ok());
    for (expected, edit) in cases {
        let error = place_json(edit).unwrap_err();
        assert_eq!(field(&error), expected, "{error}");
    }
}

#[test]
fn an_arrange_request_names_what_is_wrong_with_its_robot_as_a_place_request_does() {
    let with = |name: &str, pose: Option<RigidTransform>| {
        let robot = Some(place::ReachingRobot { name: name.to_owned(), world_from_base: pose });
        ArrangeRequest { robot, ..arrange_request() }.validate()
    };
    assert_eq!(with("arm", Some(RigidTransform::IDENTITY)), Ok(()));
    assert_eq!(field(&with("Arm 1", None).unwrap_err()), "robot.name");
    assert_eq!(field(&with("arm", Some(RigidTransform([0.0; 16]))).unwrap_err()), "robot.world_from_base");
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    let not_json = Payload { encoding: "application/json;repose.PlaceRequest.v1".into(), bytes: Bytes::from_static(b"{\"query\": NaN}") };
    assert_eq!(field(&not_json.decode_json::<PlaceRequest>().unwrap_err()), "query");
    assert_eq!(field(&PlaceRequest { view_yaw_rad: Some(f64::NAN), ..place_request() }.validate().unwrap_err()), "view_yaw_rad");
    let mut bulk = scene().to_bulk();
    bulk.tensors.insert("points".into(), Tensor::f32(&[3, 3], &[0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0, 0.0, 0.0, 0.0]));
    assert_eq!(field(&Scene::from_bulk(&bulk).unwrap_err()), "points[1]");
    let mut bulk = score_request().to_bulk(None);
    bulk.tensors.insert("candidates".into(), Tensor::f32(&[1, 4], &[0.0, f32::INFINITY, 0.0, 0.0]));
    assert_eq!(field(&ScoreRequest::from_bulk(&bulk).unwrap_err()), "candidates[0]");
    let mut plan = motion_plan();
    plan.phases[0].set_points[1].q_rad[3] = f64::NAN;
    assert_eq!(field(&plan.validate().unwrap_err()), "phases[0].set_points[1].q_rad[3]");
    let mut command = robot_command();
    command.set_points[0].dq_rad_s[0] = f64::NEG_INFINITY;
    assert_eq!(field(&command.validate().unwrap_err()), "set_points[0].dq_rad_s[0]");
}

#[test]
fn poses_to_score_are_read_and_those_that_tip_the_object_are_refused() {
    let asked = |row: [f32; 7]| {
        let mut bulk = score_request().to_bulk(None);
        bulk.tensors.insert("candidates".into(), Tensor::f32(&[1, 7], &row));
        ScoreRequest::from_bulk(&bulk).map(|(request, _)| request.candidates[0])
    };
    let (sine, cosine) = 0.25f32.sin_cos();
    for sign in [1.0, -1.0] {
        let [x, y, z, yaw_rad] = asked([0.5, -0.25, 1.0, 0.0, 0.0, sign * sine, sign * cosine]).unwrap();
        assert!([x, y, z] == [0.5, -0.25, 1.0] && (yaw_rad - 0.5).abs() < 1e-6, "{yaw_rad}");
    }
    for wrong in [[0.0, 0.0, 0.0, sine, 0.0, 0.0, cosine], [0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5], [0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0, 1.0]] {
        assert_eq!(field(&asked(wrong).unwrap_err()), "candidates[0]");
    }
}

#[test]
fn scores_that_are_not_finite_are_refused() {
    let reply = |p: f32, f: f32| scoring::ScoreReply {
        weights_hash: "w".into(),
        kernel: "k".into(),
        realism: vec![0.5, f],
        relations: vec![[0.5; RELATION_COUNT], [p; RELATION_COUNT]],
        anchors: 1,
    };
    let read = |reply: scoring::ScoreReply| scoring::ScoreReply::from_bulk(&reply.to_bulk());
    assert_eq!(read(reply(0.1, 0.2)).unwrap(), reply(0.1, 0.2));
    assert_eq!(field(&read(reply(f32::NAN, 0.2)).unwrap_err()), "relations[1]");
    assert_eq!(field(&read(reply(0.1, f32::INFINITY)).unwrap_err()), "realism[1]");
}

#[test]
fn candidates_that_are_too_far_away_to_be_scored_are_refused() {
    let asked = |x: f32| {
        let request = ScoreRequest { candidates: vec![[0.0; 4], [0.0, x, 0.0, 1e30]], ..score_request() };
        ScoreRequest::from_bulk(&request.to_bulk(None)).map(drop)
    };
    assert_eq!(asked(-limits::MAX_CANDIDATE_COORDINATE_M), Ok(()));
    assert_eq!(field(&asked(1e20).unwrap_err()), "candidates[1]");
}

#[test]
fn a_prior_without_a_density_is_refused() {
    type Edit = fn(&mut scoring::MixtureComponent);
    let cases: [(&str, Edit); 3] = [
        ("mixture[0].sigma_m[1]", |c| c.sigma_m[1] = 0.0),
        ("mixture[0].weight", |c| c.weight = -0.5),
        ("mixture[0].yaw_concentration", |c| c.yaw_concentration = -1.0),
    ];
    for (expected, edit) in cases {
        let mut reply = prior_reply();
        edit(&mut reply.mixture[0]);
        assert_eq!(field(&scoring::PriorReply::from_bulk(&reply.to_bulk()).unwrap_err()), expected);
    }
}

#[test]
fn a_cloud_in_other_units_than_metres_is_refused() {
    let mut scene = scene();
    scene.points[2][1] = 1000.0;
    assert!(Scene::from_bulk(&scene.to_bulk()).is_ok());
    scene.points[2][1] = -1000.5;
    assert_eq!(field(&Scene::from_bulk(&scene.to_bulk()).unwrap_err()), "points[2]");
}

#[test]
fn an_empty_cloud_is_refused() {
    let empty = Scene { points: vec![], labels: vec![], colors: None, ..scene() };
    assert_eq!(field(&Scene::from_bulk(&empty.to_bulk()).unwrap_err()), "points");
}

#[test]
fn what_a_scene_says_of_objects_and_unseen_space_agrees_with_itself() {
    type Edit = fn(&mut SceneMeta);
    let cases: [(&str, Edit); 7] = [
        ("scene.unseen.space.hidden", |m| m.unseen.space.iter_mut().for_each(|s| s.hidden.push(0))),
        ("scene.unseen.space.columns", |m| m.unseen.space.iter_mut().for_each(|s| s.columns = 100_000)),
        ("scene.unseen.space.cell_m", |m| m.unseen.space.iter_mut().for_each(|s| s.cell_m = 0.0)),
        ("scene.objects[0].id", |m| m.objects[0].id = 0),
        ("scene.objects[1].id", |m| m.objects[1].id = 1),
        ("scene.objects", |m| m.objects[0].id = 9),
        ("scene.camera.world_from_camera", |m| m.camera.world_from_camera = None),
    ];
    for (expected, edit) in cases {
        let mut wrong = scene();
        edit(&mut wrong.meta);
        assert_eq!(field(&Scene::from_bulk(&wrong.to_bulk()).unwrap_err()), expected);
    }
}

#[test]
fn surfaces_and_objects_are_of_a_size_that_can_be_planned_on() {
    type Edit = fn(&mut SceneMeta);
    let good: [Edit; 3] = [
        |m| m.surfaces[0].outline_m[1][0] = -1000.0,
        |m| m.surfaces[0].outline_m = vec![[0.0, 1.0]; limits::MAX_CORNERS],
        |m| m.surfaces = vec![m.surfaces[0].clone(); limits::MAX_SURFACES],
    ];
    let wrong: [(&str, Edit); 5] = [
        ("scene.surfaces[0].height_m", |m| m.surfaces[0].height_m = 1200.0),
        ("scene.surfaces[0].outline_m[1]", |m| m.surfaces[0].outline_m[1] = [1200.0, 0.0]),
        ("scene.surfaces[1].outline_m[2]", |m| {
            m.surfaces.push(m.surfaces[0].clone());
            m.surfaces[1].outline_m[2] = [0.0, -1e300];
        }),
        ("scene.surfaces[0].outline_m", |m| m.surfaces[0].outline_m = vec![[0.0, 1.0]; limits::MAX_CORNERS + 1]),
        ("scene.surfaces", |m| m.surfaces = vec![m.surfaces[0].clone(); limits::MAX_SURFACES + 1]),
    ];
    let read = |edit: Edit| {
        let mut scene = scene();
        edit(&mut scene.meta);
        Scene::from_bulk(&scene.to_bulk())
    };
    assert!(good.into_iter().all(|edit| read(edit).is_ok()));
    for (expected, edit) in wrong {
        assert_eq!(field(&read(edit).unwrap_err()), expected);
    }
    let of_objects = |count: usize| {
        let labels: Vec<u16> = (0..=count as u16).collect();
        Scene {
            points: vec![[0.0; 3]; labels.len()],
            labels,
            colors: None,
            meta: SceneMeta { objects: Vec::new(), ..scene().meta },
            ..scene()
        }
    };
    assert!(Scene::from_bulk(&of_objects(limits::MAX_OBJECTS).to_bulk()).is_ok());
    assert_eq!(field(&Scene::from_bulk(&of_objects(limits::MAX_OBJECTS + 1).to_bulk()).unwrap_err()), "labels");
}

#[test]
fn metadata_that_is_missing_or_garbled_is_named() {
    for entry in ["camera", "stamp_ns", "scene"] {
        let mut bulk = scene().to_bulk();
        bulk.metadata.remove(entry);
        assert_eq!(field(&Scene::from_bulk(&bulk).unwrap_err()), entry);
    }
    let mut bulk = frame().to_bulk();
    bulk.metadata.insert("stamp_ns".into(), "yesterday".into());
    assert_eq!(field(&Frame::from_bulk(&bulk).unwrap_err()), "stamp_ns");
    let mut bulk = frame().to_bulk();
    bulk.metadata.insert("camera".into(), "Front Camera".into());
    assert_eq!(field(&Frame::from_bulk(&bulk).unwrap_err()), "camera");
    bulk.tensors.remove("depth");
    assert_eq!(field(&Frame::from_bulk(&bulk).unwrap_err()), "depth");
}

#[test]
fn what_is_wrong_in_an_entry_is_named_below_it() {
    let mut wrong = scene();
    wrong.meta.camera.fx = 0.0;
    assert_eq!(field(&Scene::from_bulk(&wrong.to_bulk()).unwrap_err()), "scene.camera.fx");
    let wrong = Frame { camera: CameraModel { depth_unit_m: -1.0, ..camera() }, ..frame() };
    assert_eq!(field(&Frame::from_bulk(&wrong.to_bulk()).unwrap_err()), "camera_json.depth_unit_m");
    let with = |entry: &str, text: &str| {
        let (mut scene, mut frame) = (scene().to_bulk(), frame().to_bulk());
        [&mut scene, &mut frame].into_iter().for_each(|bulk| drop(bulk.metadata.insert(entry.to_owned(), text.to_owned())));
        let read = if entry == "scene" { Scene::from_bulk(&scene).map(drop) } else { Frame::from_bulk(&frame).map(drop) };
        read.unwrap_err()
    };
    for (entry, text, expected) in [
        ("scene", "{\"objects\": [7]}", "scene.objects[0]"),
        ("scene", "seen", "scene"),
        ("camera_json", "{\"width\": -1}", "camera_json.width"),
        ("hints", "hm", "hints"),
        ("robots", "[7]", "robots[0]"),
    ] {
        assert_eq!(field(&with(entry, text)), expected);
    }
}

#[test]
fn tensors_and_pictures_whose_sizes_disagree_are_refused() {
    let mut bulk = scene().to_bulk();
    bulk.tensors.insert("labels".into(), Tensor::u16(&[2], &[1, 2]));
    assert_eq!(field(&Scene::from_bulk(&bulk).unwrap_err()), "labels");
    let mut bulk = frame().to_bulk();
    bulk.tensors.insert("depth".into(), Tensor::u16(&[3, 2], &[0; 6]));
    assert_eq!(field(&Frame::from_bulk(&bulk).unwrap_err()), "depth");
    let mut bulk = frame().to_bulk();
    bulk.tensors.insert("color".into(), Tensor::u8(&[2, 3], &[0; 6]));
    assert_eq!(field(&Frame::from_bulk(&bulk).unwrap_err()), "color");
    let wrong = Frame { labels: Some(vec![0; 5]), ..frame() };
    assert_eq!(field(&wrong.validate().unwrap_err()), "labels");
    let mut bulk = frame().to_bulk();
    bulk.tensors.insert("depth".into(), Tensor::f32(&[2, 3], &[0.5; 6]));
    assert_eq!(field(&Frame::from_bulk(&bulk).unwrap_err()), "depth");
}

#[test]
fn wrong_versions_and_schemas_are_told() {
    let call = br#"{"v":2,"id":"a","method":"place","remaining_ms":1,"from_the_future":true}"#;
    assert_eq!(field(&CallAttachment::decode(call).unwrap_err()), "v");
    let call = br#"{"id":"a","method":"place","remaining_ms":1}"#;
    assert_eq!(field(&CallAttachment::decode(call).unwrap_err()), "v");
    assert_eq!(field(&CallAttachment::decode(b"\xff\xfe").unwrap_err()), "attachment");
    assert_eq!(field(&ReplyAttachment::decode(b"").unwrap_err()), "attachment");
    let payload = Payload { encoding: "application/json;repose.PlaceRequest.v2".into(), ..Payload::json(&place_request()).unwrap() };
    assert_eq!(field(&payload.decode_json::<PlaceRequest>().unwrap_err()), "encoding");
    let payload = Payload::bulk(Scene::SCHEMA, &scene().to_bulk()).unwrap();
    assert_eq!(field(&payload.decode_bulk(Frame::SCHEMA).unwrap_err()), "encoding");
    assert_eq!(field(&RobotCommandV2::command().validate().unwrap_err()), "v");
}

struct RobotCommandV2;

impl RobotCommandV2 {
    fn command() -> robot::RobotCommand {
        robot::RobotCommand { v: 2, ..robot_command() }
    }
}

#[test]
fn deadlines_and_ids_have_limits() {
    let attachment = |id: &str, remaining_ms: u64| {
        let text = serde_json::json!({"v": 1, "id": id, "method": "place", "remaining_ms": remaining_ms}).to_string();
        CallAttachment::decode(text.as_bytes())
    };
    assert!(attachment("a", 600_000).is_ok());
    assert_eq!(field(&attachment("a", 0).unwrap_err()), "remaining_ms");
    assert_eq!(field(&attachment("a", 600_001).unwrap_err()), "remaining_ms");
    assert_eq!(field(&attachment("a/**", 1).unwrap_err()), "id");
}

#[test]
fn oversize_messages_are_refused_before_they_are_sent_and_before_they_are_read() {
    let pixels = 2100 * 2048;
    let camera = CameraModel { width: 2100, height: 2048, ..camera() };
    let frame = Frame { camera, depth: vec![1; pixels], color: Some(vec![[0; 3]; pixels]), labels: Some(vec![0; pixels]), ..frame() };
    frame.validate().unwrap();
    // 4.3 million pixels of 7 bytes stay below the limit; one more image of that size does not.
    let mut bulk = frame.to_bulk();
    assert!(Payload::bulk(Frame::SCHEMA, &bulk).is_ok());
    bulk.tensors.insert("more".into(), Tensor::u8(&[pixels], &vec![0; pixels]));
    assert_eq!(field(&Payload::bulk(Frame::SCHEMA, &bulk).unwrap_err()), "payload");
    let bytes = Bytes::from(vec![b' '; 33 * 1024 * 1024]);
    let payload = Payload { encoding: "application/json;repose.PlaceRequest.v1".into(), bytes };
    assert_eq!(field(&payload.decode_json::<PlaceRequest>().unwrap_err()), "payload");
}

#[test]
fn transforms_that_are_not_rigid_are_refused() {
    let mut request = motion_plan_request();
    request.placements[0].0[0] = 2.0;
    assert_eq!(field(&request.validate().unwrap_err()), "placements[0]");
    request.placements[0] = RigidTransform::IDENTITY;
    request.placements[0].0[0] = -1.0;
    assert_eq!(field(&request.validate().unwrap_err()), "placements[0]");
    request.placements[0].0 = [f64::NAN; 16];
    assert_eq!(field(&request.validate().unwrap_err()), "placements[0]");
}

#[test]
fn key_chunks_are_checked() {
    for good in ["a", "0", "cell-1", "a_b", &"x".repeat(64)] {
        assert!(Cell::new(good).is_ok(), "{good}");
    }
    for bad in ["", "A", "-a", "a/b", "*", "a b", "ä", "@a", &"x".repeat(65)] {
        assert_eq!(field(&Cell::new(bad).unwrap_err()), "cell", "{bad}");
    }
    let cell = Cell::new("lab").unwrap();
    assert_eq!(cell.call(Service::Planner, "planner-1"), "repose/v1/lab/service/planner/planner-1/call");
    assert_eq!(cell.cancel(Service::Planner, "p", "r"), "repose/v1/lab/service/planner/p/@cancel/r");
    assert_eq!(cell.live(Service::Motion, "m"), "repose/v1/lab/live/motion/m");
    assert_eq!(cell.robot_estop("panda"), "repose/v1/lab/robot/panda/@estop");
    assert_eq!(keys::worker_of(&cell.load(Service::Inference, "w7")), Some("w7"));
    assert_eq!(keys::last_chunk(&cell.live(Service::Motion, "m")), "m");
}

proptest! {
    #[test]
    fn truncated_bulk_is_an_error_and_never_a_panic(cut in 0usize..2000) {
        let bytes = scene().to_bulk().encode();
        let cut = cut.min(bytes.len() - 1);
        let error = Bulk::decode(&bytes[..cut]).unwrap_err();
        prop_assert_eq!(field(&error), "payload");
    }

    #[test]
    fn flipped_bytes_never_panic(at in 0usize..4000, value: u8) {
        let mut bytes = scene().to_bulk().encode();
        let at = at % bytes.len();
        bytes[at] = value;
        if let Ok(bulk) = Bulk::decode(&bytes) {
            let _ = Scene::from_bulk(&bulk);
            let _ = Frame::from_bulk(&bulk);
            let _ = ScoreRequest::from_bulk(&bulk);
        }
    }

    #[test]
    fn truncated_json_is_an_error_that_names_a_field(cut in 0usize..2000) {
        let payload = Payload::json(&place_request()).unwrap();
        let cut = cut.min(payload.bytes.len() - 1);
        let truncated = Payload { bytes: payload.bytes.slice(..cut), ..payload };
        let error = truncated.decode_json::<PlaceRequest>().unwrap_err();
        prop_assert!(!field(&error).is_empty());
    }

    #[test]
    fn goal_terms_round_trip_through_text(relation in 0usize..10, anchor: u16, holds: bool) {
        let term = GoalTerm { relation: Relation::ALL[relation], anchor, holds };
        prop_assert_eq!(term.to_string().parse::<GoalTerm>().unwrap(), term);
    }
}
