//! Fetching scenes: in parts from whoever gives parts, whole from whoever does not.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use repose_proto::bulk::Bulk;
use repose_proto::enclosed::disclose;
use repose_proto::load::WorkerLoad;
use repose_proto::motion::{MotionPlan, MotionPlanRequest};
use repose_proto::perception::SceneRequest;
use repose_proto::{CallError, ErrorCode, Message, Payload, Scene, Service};
use repose_runtime::{Call, CallOptions, CallerConfig, Handler, RuntimeConfig, fetch_scene};

use crate::common::Network;

/// What a worker does with a request for a part.
#[derive(Clone, Copy, PartialEq)]
enum Parts {
    Given,
    /// It answers with the whole.
    Ignored,
    /// It does not know the field: release 1.
    Refused,
}

struct OneScene {
    scene: Payload,
    parts: Parts,
    largest: AtomicUsize,
}

#[async_trait]
impl Handler for OneScene {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        let request: SceneRequest = call.payload.decode_json()?;
        let answer = match self.parts {
            Parts::Refused if request.part.is_some() || request.packed => return Err(CallError::invalid("part", "unknown field")),
            Parts::Ignored => self.scene.clone(),
            _ => request.answer(&self.scene)?,
        };
        self.largest.fetch_max(answer.bytes.len(), Ordering::SeqCst);
        Ok(answer)
    }

    fn load(&self) -> WorkerLoad {
        WorkerLoad::default()
    }
}

/// A scene of many points, five megabytes of them.
fn large_scene() -> Scene {
    let golden = include_bytes!("../../../../../proto/tests/golden/Scene.v1.safetensors");
    let mut scene = Scene::from_bulk(&Bulk::decode(golden).unwrap()).unwrap();
    let points = 330_000;
    scene.points = (0..points).map(|i| [i as f32 * 1e-6, 0.25, 0.5]).collect();
    // One point of each of its objects, and many of none.
    scene.labels = (0..points).map(|i| if i < 3 { i as u16 } else { 0 }).collect();
    scene.colors = Some(vec![[1, 2, 3]; points]);
    scene
}

async fn fetched(parts: Parts) -> (Scene, Scene, usize) {
    let network = Network::embedded(RuntimeConfig::default()).await;
    let session = network.session().await;
    let scene = large_scene();
    let payload = Payload::bulk(Scene::SCHEMA, &scene.to_bulk()).unwrap();
    let worker = Arc::new(OneScene { scene: payload, parts, largest: AtomicUsize::default() });
    let server = session.start(Service::Perception, worker.clone()).await.unwrap();
    let perception = session.caller(Service::Perception).await.unwrap();
    let came = fetch_scene(&perception, &"0".repeat(64), &CallOptions::within(Duration::from_secs(20))).await.unwrap();
    server.drain().await;
    (came, scene, worker.largest.load(Ordering::SeqCst))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scene_comes_in_parts_none_of_which_holds_a_link_for_long() {
    let (came, sent, largest) = fetched(Parts::Given).await;
    assert_eq!(came, sent);
    assert!(largest < 300_000, "{largest} bytes in one message");
}

/// A worker that is full at first.
struct Full {
    scene: OneScene,
    refused: AtomicUsize,
    /// When it says to come back.
    retry_after_ms: u64,
}

/// Calls that it refuses.
const REFUSED: usize = 40;

#[async_trait]
impl Handler for Full {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        if self.refused.fetch_add(1, Ordering::SeqCst) < REFUSED {
            return Err(CallError::new(ErrorCode::ResourceExhausted, "full").retry_after(self.retry_after_ms));
        }
        self.scene.call(call).await
    }

    fn load(&self) -> WorkerLoad {
        WorkerLoad::default()
    }
}

/// A worker whose answers are long on their way.
struct Distant {
    scene: OneScene,
    asked: AtomicUsize,
}

#[async_trait]
impl Handler for Distant {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        self.asked.fetch_add(1, Ordering::SeqCst);
        let part = self.scene.call(call).await;
        tokio::time::sleep(Duration::from_millis(1500)).await;
        part
    }

    fn load(&self) -> WorkerLoad {
        WorkerLoad::default()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_part_that_is_long_on_its_way_is_not_asked_for_a_second_time() {
    // Half a second of ten, after which an attempt counts as slow.
    let caller = CallerConfig { attempt_share: 0.05, ..CallerConfig::default() };
    let network = Network::embedded(RuntimeConfig { caller, ..RuntimeConfig::default() }).await;
    let session = network.session().await;
    let sent = large_scene();
    let payload = Payload::bulk(Scene::SCHEMA, &sent.to_bulk()).unwrap();
    let parts = payload.bytes.len().div_ceil(256 << 10);
    let scene = OneScene { scene: payload, parts: Parts::Given, largest: AtomicUsize::default() };
    let distant = Arc::new(Distant { scene, asked: AtomicUsize::default() });
    let _server = session.start(Service::Perception, distant.clone()).await.unwrap();
    let perception = session.caller(Service::Perception).await.unwrap();
    perception.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    let came = fetch_scene(&perception, &"0".repeat(64), &CallOptions::within(Duration::from_secs(10))).await.unwrap();
    assert_eq!(came, sent);
    assert_eq!(distant.asked.load(Ordering::SeqCst), parts);
}

/// A worker that has no scene.
struct Without;

#[async_trait]
impl Handler for Without {
    async fn call(&self, _call: Call) -> Result<Payload, CallError> {
        Err(CallError::new(ErrorCode::NotFound, "no such scene").at("scene_id"))
    }

    fn load(&self) -> WorkerLoad {
        WorkerLoad::default()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn parts_that_a_full_worker_refuses_are_asked_for_again_though_another_has_none() {
    let network = Network::embedded(RuntimeConfig::default()).await;
    let [session, other] = [network.session().await, network.session().await];
    let sent = large_scene();
    let payload = Payload::bulk(Scene::SCHEMA, &sent.to_bulk()).unwrap();
    let scene = OneScene { scene: payload, parts: Parts::Given, largest: AtomicUsize::default() };
    let full = Arc::new(Full { scene, refused: AtomicUsize::default(), retry_after_ms: 5 });
    let _servers = [
        session.start(Service::Perception, full.clone()).await.unwrap(),
        other.start(Service::Perception, Arc::new(Without)).await.unwrap(),
    ];
    let perception = session.caller(Service::Perception).await.unwrap();
    perception.wait_for_workers(2, Duration::from_secs(10)).await.unwrap();
    let came = fetch_scene(&perception, &"0".repeat(64), &CallOptions::within(Duration::from_secs(20))).await.unwrap();
    assert_eq!(came, sent);
    assert!(full.refused.load(Ordering::SeqCst) > REFUSED);
}

#[tokio::test(flavor = "multi_thread")]
async fn parts_are_asked_for_again_before_a_full_worker_has_done_what_it_reckons_with() {
    let network = Network::embedded(RuntimeConfig::default()).await;
    let session = network.session().await;
    let sent = large_scene();
    let payload = Payload::bulk(Scene::SCHEMA, &sent.to_bulk()).unwrap();
    let scene = OneScene { scene: payload, parts: Parts::Given, largest: AtomicUsize::default() };
    // By half of what wait, at what a segmentation takes, it would be as long as the caller has.
    let full = Arc::new(Full { scene, refused: AtomicUsize::default(), retry_after_ms: 10_000 });
    let _server = session.start(Service::Perception, full.clone()).await.unwrap();
    let perception = session.caller(Service::Perception).await.unwrap();
    let came = fetch_scene(&perception, &"0".repeat(64), &CallOptions::within(Duration::from_secs(10))).await.unwrap();
    assert_eq!(came, sent);
    assert!(full.refused.load(Ordering::SeqCst) > REFUSED);
}

#[tokio::test(flavor = "multi_thread")]
async fn workers_that_give_no_parts_give_the_whole() {
    for parts in [Parts::Ignored, Parts::Refused] {
        let (came, sent, largest) = fetched(parts).await;
        assert_eq!(came, sent);
        assert!(largest > 4 << 20);
    }
}

/// A worker that has seen its scene again, at [`SEEN_AGAIN_NS`].
struct SeenAgain(Payload);

const SEEN_AGAIN_NS: u64 = 1_800_000_000_000_000_000;

#[async_trait]
impl Handler for SeenAgain {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        call.payload.decode_json::<SceneRequest>()?.answer_as_of(&self.0, SEEN_AGAIN_NS)
    }

    fn load(&self) -> WorkerLoad {
        WorkerLoad::default()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scene_that_was_seen_again_has_the_stamp_of_then() {
    let network = Network::embedded(RuntimeConfig::default()).await;
    let session = network.session().await;
    let sent = large_scene();
    let worker = Arc::new(SeenAgain(Payload::bulk(Scene::SCHEMA, &sent.to_bulk()).unwrap()));
    let _server = session.start(Service::Perception, worker).await.unwrap();
    let perception = session.caller(Service::Perception).await.unwrap();
    let came = fetch_scene(&perception, &"0".repeat(64), &CallOptions::within(Duration::from_secs(20))).await.unwrap();
    assert_eq!(came, Scene { stamp_ns: SEEN_AGAIN_NS, ..sent });
}

/// A motion worker that holds a scene as it was seen at `held_ns`, until it is sent a younger one.
struct Planner {
    held_ns: AtomicU64,
    calls: AtomicUsize,
}

fn golden<T: serde::de::DeserializeOwned>(json: &str) -> T {
    serde_json::from_str(json).unwrap()
}

#[async_trait]
impl Handler for Planner {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        self.calls.fetch_add(1, Ordering::SeqCst);
        if call.payload.is_bulk() {
            let (_, scene) = disclose::<MotionPlanRequest>(&call.payload.decode_bulk(MotionPlanRequest::SCHEMA)?)?;
            self.held_ns.fetch_max(scene.map_or(0, |scene| scene.stamp_ns), Ordering::SeqCst);
        }
        let plan: MotionPlan = golden(include_str!("../../../../../proto/tests/golden/MotionPlan.v1.json"));
        Payload::json(&MotionPlan { scene_stamp_ns: self.held_ns.load(Ordering::SeqCst), ..plan })
    }

    fn load(&self) -> WorkerLoad {
        WorkerLoad::default()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_on_what_was_seen_long_before_is_made_again_on_the_younger_sighting() {
    const S: u64 = 1_000_000_000;
    let network = Network::embedded(RuntimeConfig::default()).await;
    let session = network.session().await;
    let worker = Arc::new(Planner { held_ns: AtomicU64::new(1000 * S), calls: AtomicUsize::default() });
    let _server = session.start(Service::Motion, worker.clone()).await.unwrap();
    let motion = session.caller(Service::Motion).await.unwrap();
    motion.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    let request: MotionPlanRequest = golden(include_str!("../../../../../proto/tests/golden/MotionPlanRequest.v1.json"));
    // Its plans are good for a minute.
    for (seen_ns, planned_ns, calls) in [(1020 * S, 1000 * S, 1), (1100 * S, 1100 * S, 3), (1100 * S, 1100 * S, 4)] {
        let scene = Scene { stamp_ns: seen_ns, ..large_scene() };
        let plan = motion.plan_motion(&request, Some(&scene), CallOptions::within(Duration::from_secs(20))).await.unwrap();
        assert_eq!((plan.scene_stamp_ns, worker.calls.load(Ordering::SeqCst)), (planned_ns, calls));
    }
}
