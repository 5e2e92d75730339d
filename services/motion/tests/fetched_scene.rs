//! A plan that another worker made is executed with its scene, which perception has.

mod common;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use common::{NOW_NS, plan};
use repose_motion::{MotionConfig, run, synthetic};
use repose_panda::READY;
use repose_proto::motion::{MotionPlan, MotionPlanRequest, RecoverRequest, RecoveryMove};
use repose_proto::perception::SceneRequest;
use repose_proto::{CallError, ErrorCode, Payload, RigidTransform, Scene, SceneRef, Service};
use repose_runtime::{Call, CallOptions, Handler, Session, Shutdown};

/// A perception that has one scene, and has seen it at one time or another.
struct OneScene {
    scene: Scene,
    seen_ns: AtomicU64,
    asked: AtomicUsize,
}

impl OneScene {
    fn new() -> Arc<Self> {
        Arc::new(Self { scene: synthetic::wire_scene(NOW_NS), seen_ns: AtomicU64::new(NOW_NS), asked: AtomicUsize::new(0) })
    }
}

#[async_trait]
impl Handler for OneScene {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        self.asked.fetch_add(1, Ordering::AcqRel);
        let request: SceneRequest = call.payload.decode_json()?;
        if request.scene_id != self.scene.id() {
            return Err(CallError::not_found("scene_id", "it is not here"));
        }
        request.answer_as_of(&Payload::bulk(Scene::SCHEMA, &self.scene.to_bulk())?, self.seen_ns.load(Ordering::Acquire))
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_scene_of_a_plan_that_another_worker_made_is_asked_of_perception() {
    let (session, shutdown) = (Session::embedded().await.unwrap(), Shutdown::new());
    let perception = OneScene::new();
    let perceiving = session.start(Service::Perception, perception.clone()).await.unwrap();
    let moving = tokio::spawn(run(session.clone(), MotionConfig::default(), shutdown.clone()));
    let caller = session.caller(Service::Motion).await.unwrap();
    caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    let call = async |method: &str, payload: Payload| {
        let answer = caller.call(method, payload, CallOptions::at_most_once(Duration::from_secs(10))).await;
        answer.map(|_| ()).unwrap_err()
    };
    // Once it asks perception for the scene of a request, it has seen that there is one.
    let unknown = MotionPlanRequest::new("0".repeat(64), "panda".to_owned(), 1, vec![RigidTransform::IDENTITY], plan().start_joints_rad);
    while perception.asked.load(Ordering::Acquire) == 0 {
        assert_eq!(call("plan", Payload::json(&unknown).unwrap()).await.code, ErrorCode::NotFound);
    }
    // What the plan moves is not in its scene, as only who has that can tell.
    let plan = MotionPlan { scene_id: perception.scene.id(), query: 77, ..plan() };
    let refused = call("execute", Payload::json(&plan).unwrap()).await;
    assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::NotFound, Some("query")), "{refused}");
    // And so is the scene that an arm's way back is checked against, or when it was seen.
    let asked = perception.asked.load(Ordering::Acquire);
    let scene = Some(SceneRef { scene_id: perception.scene.id() });
    let back = RecoverRequest { robot: "panda".to_owned(), motion: RecoveryMove::Home, scene };
    let refused = call("recover", Payload::json(&back).unwrap()).await;
    assert!(perception.asked.load(Ordering::Acquire) > asked, "no robot tells its state here: {refused}");
    perceiving.drain().await;
    shutdown.trigger();
    moving.await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_on_a_scene_that_was_held_for_long_is_as_young_as_perception_has_seen_it_since() {
    let (session, shutdown) = (Session::embedded().await.unwrap(), Shutdown::new());
    let perception = OneScene::new();
    let perceiving = session.start(Service::Perception, perception.clone()).await.unwrap();
    // Whatever is held at all has been for long.
    let config = MotionConfig { max_scene_age_ms: 1, ..MotionConfig::default() };
    let moving = tokio::spawn(run(session.clone(), config, shutdown.clone()));
    let caller = session.caller(Service::Motion).await.unwrap();
    caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    let mut moved = RigidTransform::IDENTITY;
    moved.0[7] = 0.45;
    let request = MotionPlanRequest { seed: 1, ..MotionPlanRequest::new(perception.scene.id(), "panda".to_owned(), 1, vec![moved], READY) };
    // By its id: nobody sends the scene.
    let planned = async || {
        let answer = caller.call("plan", Payload::json(&request).unwrap(), CallOptions::within(Duration::from_secs(30))).await?;
        Ok::<_, CallError>(answer.payload.decode_json::<MotionPlan>()?.scene_stamp_ns)
    };
    let first_ns = loop {
        match planned().await {
            // It has not seen yet that there is a perception.
            Err(error) if error.code == ErrorCode::NotFound => {}
            ended => break ended.unwrap(),
        }
    };
    assert_eq!(first_ns, NOW_NS);
    let again_ns = NOW_NS + 60_000_000_000;
    perception.seen_ns.store(again_ns, Ordering::Release);
    assert_eq!(planned().await.unwrap(), again_ns);
    // What perception cannot say is no reason not to plan.
    perceiving.drain().await;
    assert_eq!(planned().await.unwrap(), again_ns);
    shutdown.trigger();
    moving.await.unwrap().unwrap();
}
