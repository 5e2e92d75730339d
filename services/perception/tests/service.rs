//! The service as its callers and cameras see it, on one embedded session.

mod common;

use std::time::Duration;

use common::{config, encoded, frame};
use repose_perception::run;
use repose_proto::perception::{ByteRange, LatestRequest, ScenePart, SceneRequest};
use repose_proto::{CallError, ErrorCode, Frame, Payload, Scene, SceneSummary, Service};
use repose_runtime::{Answer, CallOptions, Caller, Session, Shutdown, Traffic};

/// A running service with a caller of it.
struct Running {
    session: Session,
    caller: Caller,
    shutdown: Shutdown,
    service: tokio::task::JoinHandle<Result<(), repose_runtime::RuntimeError>>,
}

impl Running {
    async fn start() -> Self {
        let session = Session::embedded().await.unwrap();
        let shutdown = Shutdown::new();
        let service = tokio::spawn(run(session.clone(), config(), shutdown.clone()));
        let caller = session.caller(Service::Perception).await.unwrap();
        caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
        Self { session, caller, shutdown, service }
    }

    async fn call(&self, method: &str, payload: Payload) -> Result<Answer, CallError> {
        self.caller.call(method, payload, CallOptions::within(Duration::from_secs(20))).await
    }

    async fn error(&self, method: &str, payload: Payload) -> (ErrorCode, String) {
        let error = self.call(method, payload).await.unwrap_err();
        (error.code, error.field.unwrap_or_default())
    }

    async fn stop(self) {
        self.shutdown.trigger();
        self.service.await.unwrap().unwrap();
        self.session.close().await.unwrap();
    }
}

fn scene_in(payload: &Payload) -> Scene {
    Scene::from_bulk(&payload.decode_bulk(Scene::SCHEMA).unwrap()).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_segmented_frame_can_be_asked_for_by_its_id() {
    let running = Running::start().await;
    let answer = running.call("segment", encoded(&frame("front", 7))).await.unwrap();
    let scene = scene_in(&answer.payload);
    assert_eq!(scene.meta.objects.len(), 1);
    assert!((scene.meta.objects[0].centroid_m[2] - 0.1).abs() < 0.01);
    assert!(answer.timing_ms.contains_key("segment"));
    let request = Payload::json(&SceneRequest::new(scene.id())).unwrap();
    assert_eq!(running.call("scene", request).await.unwrap().payload, answer.payload);
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_packed_scene_that_is_seen_again_says_when_and_keeps_the_bytes_of_its_parts() {
    let running = Running::start().await;
    let mut parts = Vec::new();
    for stamp_ns in [7, 8] {
        let scene_id = scene_in(&running.call("segment", encoded(&frame("front", stamp_ns))).await.unwrap().payload).id();
        let request = SceneRequest { packed: true, ..SceneRequest::new(scene_id) };
        let of_part = SceneRequest { part: Some(ByteRange { offset: 0, length: 1 << 20 }), ..request.clone() };
        let part = running.call("scene", Payload::json(&of_part).unwrap()).await.unwrap();
        let part = ScenePart::from_payload(&part.payload).unwrap();
        assert_eq!(part.stamp_ns, Some(stamp_ns));
        parts.push(part.bytes);
        let whole = running.call("scene", Payload::json(&request).unwrap()).await.unwrap();
        assert!(whole.payload.is_packed());
        assert_eq!(scene_in(&whole.payload).stamp_ns, stamp_ns);
    }
    assert_eq!(parts[0], parts[1], "others may be under way");
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cameras_frame_becomes_its_newest_scene() {
    let running = Running::start().await;
    let cell = running.session.cell().clone();
    let mut scenes = running.session.subscribe_queue(&cell.scene("front"), 8).await.unwrap();
    // Put until one arrives: the service's subscription may still be on its way.
    let published: SceneSummary = loop {
        running.session.put(&cell.camera_frame("front"), encoded(&frame("front", 42)), Traffic::Frame).await.unwrap();
        if let Ok(Some(sample)) = tokio::time::timeout(Duration::from_millis(500), scenes.recv()).await {
            break sample.payload.decode_json().unwrap();
        }
    };
    assert_eq!((published.camera.as_str(), published.stamp_ns, published.objects.len()), ("front", 42, 1));
    let latest = running.call("latest", Payload::json(&LatestRequest { camera: "front".to_owned() }).unwrap()).await.unwrap();
    assert_eq!(latest.payload.decode_json::<SceneSummary>().unwrap(), published);
    let scene = running.call("scene", Payload::json(&SceneRequest::new(published.scene_id.clone())).unwrap()).await.unwrap();
    assert_eq!(scene_in(&scene.payload).id(), published.scene_id);
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_answered_is_said_with_its_field() {
    let running = Running::start().await;
    let empty = Frame { depth: vec![0; 160 * 120], ..frame("front", 1) };
    assert_eq!(running.error("segment", encoded(&empty)).await, (ErrorCode::InvalidArgument, "depth".to_owned()));
    let mut disagreeing = frame("front", 1).to_bulk();
    disagreeing.tensors.insert("labels".to_owned(), repose_proto::Tensor::u16(&[3, 4], &[0; 12]));
    let disagreeing = Payload::bulk(Frame::SCHEMA, &disagreeing).unwrap();
    assert_eq!(running.error("segment", disagreeing).await, (ErrorCode::InvalidArgument, "labels".to_owned()));
    let unknown = Payload::json(&SceneRequest::new("0".repeat(64))).unwrap();
    assert_eq!(running.error("scene", unknown).await, (ErrorCode::NotFound, "scene_id".to_owned()));
    let nobody = Payload::json(&LatestRequest { camera: "nobody".to_owned() }).unwrap();
    assert_eq!(running.error("latest", nobody).await, (ErrorCode::NotFound, "camera".to_owned()));
    assert_eq!(running.error("dance", encoded(&frame("front", 1))).await.1, "method");
    running.stop().await;
}
