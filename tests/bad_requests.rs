//! Bad requests to running services get the contract's error with the field named.

mod common;

use common::{Deployment, PATIENCE, enclosed, newest_scene, whole_scene};
use repose_proto::place::Variant;
use repose_proto::{
    CallError, ErrorCode, Frame, GoalTerm, Payload, PlaceRequest, Relation, ReplyAttachment, ReplyKind, Scene, Service, Tensor,
};
use repose_runtime::{CallOptions, Session};

async fn refused(session: &Session, service: Service, method: &str, payload: Payload) -> CallError {
    let caller = session.caller(service).await.expect("a caller");
    caller.call(method, payload, CallOptions::within(PATIENCE)).await.expect_err("an error")
}

fn is(error: &CallError, code: ErrorCode, field: &str) {
    assert_eq!((error.code, error.field.as_deref()), (code, Some(field)), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_requests_get_typed_errors_that_name_the_field() {
    use ErrorCode::{InvalidArgument, NotFound};
    let services = [(Service::Simulator, 1), (Service::Perception, 1), (Service::Inference, 1), (Service::Planner, 1)];
    let deployment = Deployment::start(&services).await;
    let session = deployment.session().await;
    let summary = newest_scene(&session).await;
    let scene = whole_scene(&session, &summary).await;
    let (query, anchor) = (summary.objects[0].id, summary.objects[1].id);
    let term = |anchor, holds| GoalTerm { relation: Relation::LeftOf, anchor, holds };
    let request = |query, goal| PlaceRequest { variant: Variant::Geometric, ..PlaceRequest::new(summary.scene_id.clone(), query, goal) };
    let json = |request: &PlaceRequest| Payload::json(request).expect("a payload");
    // The planner then holds the scene, however long the rest takes.
    let planner = session.caller(Service::Planner).await.expect("a caller");
    let whole = enclosed(&request(query, vec![term(anchor, true)]), &scene);
    planner.call("place", whole, CallOptions::within(PATIENCE)).await.expect("an answer to a good request");

    let unknown_scene = PlaceRequest::new("0".repeat(64), query, vec![term(anchor, true)]);
    let error = refused(&session, Service::Planner, "place", json(&unknown_scene)).await;
    assert_eq!((error.code, error.field.as_deref().map(|f| f.trim_start_matches("scene."))), (NotFound, Some("scene_id")), "{error}");
    is(&refused(&session, Service::Planner, "place", json(&request(999, vec![term(anchor, true)]))).await, NotFound, "query");
    is(&refused(&session, Service::Planner, "place", json(&request(query, vec![term(999, true)]))).await, NotFound, "goal[0].anchor");
    is(&refused(&session, Service::Planner, "place", json(&request(query, vec![term(anchor, false)]))).await, InvalidArgument, "goal");
    is(&refused(&session, Service::Planner, "dance", json(&request(query, vec![term(anchor, true)]))).await, InvalidArgument, "method");

    let good = json(&request(query, vec![term(anchor, true)]));
    let text = String::from_utf8(good.bytes.to_vec()).expect("JSON").replace("left_of", "beside");
    let beside = Payload { bytes: text.into(), ..good.clone() };
    is(&refused(&session, Service::Planner, "place", beside).await, InvalidArgument, "goal[0].relation");
    let next_version = Payload { encoding: good.encoding.replace(".v1", ".v2"), ..good.clone() };
    is(&refused(&session, Service::Planner, "place", next_version).await, InvalidArgument, "encoding");
    let oversize = Payload { bytes: vec![b' '; 33 << 20].into(), ..good.clone() };
    is(&refused(&session, Service::Planner, "place", oversize).await, InvalidArgument, "payload");

    let mut with_nan = scene.clone();
    with_nan.points[3][1] = f32::NAN;
    let empty = Scene { points: vec![], labels: vec![], colors: None, ..scene };
    for (scene, field) in [(with_nan, "points[3]"), (empty, "points")] {
        let payload = enclosed(&request(query, vec![term(anchor, true)]), &scene);
        is(&refused(&session, Service::Planner, "place", payload).await, InvalidArgument, field);
    }

    let camera = repose_proto::CameraModel {
        width: 64,
        height: 48,
        fx: 50.0,
        fy: 50.0,
        cx: 32.0,
        cy: 24.0,
        depth_unit_m: 0.001,
        world_from_camera: None,
    };
    let frame = Frame::new("odd".into(), 0, camera, vec![500; 64 * 48]);
    let mut bulk = frame.to_bulk();
    bulk.tensors.insert("labels".into(), Tensor::u16(&[64, 48], &[0; 64 * 48]));
    let payload = Payload::bulk(Frame::SCHEMA, &bulk).expect("a payload");
    is(&refused(&session, Service::Perception, "segment", payload).await, InvalidArgument, "labels");
}

/// What our own caller would never send, sent by a bare client: a wrong contract version, and a payload over the limit.
#[tokio::test(flavor = "multi_thread")]
async fn a_bare_clients_wrong_version_and_oversize_payload_are_answered() {
    let deployment = Deployment::start(&[(Service::Perception, 1)]).await;
    let session = deployment.session().await;
    let perception = session.caller(Service::Perception).await.expect("a caller");
    perception.wait_for_workers(1, PATIENCE).await.expect("a worker");
    let key = session.cell().call(Service::Perception, &perception.workers()[0].name);

    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "\"client\"").expect("a mode");
    config.insert_json5("connect/endpoints", &format!("[\"{}\"]", deployment.endpoint())).expect("an endpoint");
    config.insert_json5("scouting/multicast/enabled", "false").expect("no scouting");
    let bare = zenoh::open(config).await.expect("a bare session");
    let call = |v: u32, payload: Vec<u8>| {
        let attachment = format!(r#"{{"v":{v},"id":"bare-{v}-{}","method":"latest","remaining_ms":60000}}"#, payload.len());
        let get = bare.get(&key).payload(payload).attachment(attachment).consolidation(zenoh::query::ConsolidationMode::None);
        let get = get.encoding("application/json;repose.LatestRequest.v1").timeout(PATIENCE);
        async move {
            let replies = get.await.expect("a query");
            let mut last = None;
            while let Ok(reply) = replies.recv_async().await {
                let sample = reply.into_result().expect("an ordinary reply");
                let about = ReplyAttachment::decode(&sample.attachment().expect("an attachment").to_bytes()).expect("ours");
                assert!(last.is_none(), "more than one reply");
                last = Some((about.kind, serde_json::from_slice::<CallError>(&sample.payload().to_bytes()).expect("an error")));
            }
            last.expect("a reply")
        }
    };
    let (kind, error) = call(2, br#"{"camera":"table"}"#.to_vec()).await;
    assert_eq!(kind, ReplyKind::Error);
    is(&error, ErrorCode::InvalidArgument, "v");
    let (kind, error) = call(1, vec![b' '; 33 << 20]).await;
    assert_eq!(kind, ReplyKind::Error);
    is(&error, ErrorCode::InvalidArgument, "payload");
    bare.close().await.expect("it closes");
}
