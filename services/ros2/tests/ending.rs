//! The end of a bridge that has a robot carry something out for a client of ROS, in a cell of a few lines.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlan, Phase};
use repose_proto::{Bulk, CallError, ErrorCode, Payload, PlaceRequest, PlaceResult, Scene, Service};
use repose_ros_messages::{JointState, PlanRequest, PlanResponse};
use repose_ros2::node::{Node, RosClient, RosPublisher};
use repose_ros2::wire::names::Qos;
use repose_ros2::{BridgeError, Ros2Config};
use repose_runtime::raw::RawSession;
use repose_runtime::{Call, Handler, Server, Session, SessionConfig, SessionMode, Shutdown};
use serde_json::json;
use tokio::sync::Notify;

/// How long anything may take.
const WITHIN: Duration = Duration::from_secs(20);
/// Between two tries of a service that may not be there yet, and between two joint states.
const EVERY: Duration = Duration::from_millis(20);

/// What the cell's motion is asked for.
#[derive(Default)]
struct World {
    executions: AtomicU64,
    /// Tells that an execution has begun, which waits for [`World::may_end`].
    has_begun: Notify,
    may_end: Notify,
    /// Tells that one was given up.
    was_cancelled: Notify,
}

struct Worker(Arc<World>);

#[async_trait::async_trait]
impl Handler for Worker {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        let scene = include_bytes!("../../../proto/tests/golden/Scene.v1.safetensors");
        let scene = Scene::from_bulk(&Bulk::decode(scene)?)?;
        match call.method.as_str() {
            "latest" => Payload::json(&scene.summary(scene.id())),
            "scene" => Payload::bulk(Scene::SCHEMA, &scene.to_bulk()),
            "place" => {
                let request: PlaceRequest = call.payload.decode_json()?;
                let result: PlaceResult =
                    serde_json::from_str(include_str!("../../../proto/tests/golden/PlaceResult.v1.third.json")).expect("a result");
                Payload::json(&PlaceResult { scene_id: request.scene.scene_id, query: request.query, goal: request.goal, ..result })
            }
            "plan" => {
                let plan: MotionPlan =
                    serde_json::from_str(include_str!("../../../proto/tests/golden/MotionPlan.v1.json")).expect("a plan");
                Payload::json(&plan)
            }
            "execute" => {
                self.0.executions.fetch_add(1, Ordering::SeqCst);
                self.0.has_begun.notify_one();
                tokio::select! {
                    () = self.0.may_end.notified() => {}
                    () = call.cancelled.cancelled() => {
                        self.0.was_cancelled.notify_one();
                        return Err(CallError::new(ErrorCode::Cancelled, "the arm has come to rest"));
                    }
                }
                let (outcome, phase, joints_rad) = (ExecutionOutcome::Done, Phase::Home, [0.0; 7]);
                Payload::json(&ExecuteReply { outcome, phase, reason: None, joints_rad })
            }
            _ => Err(call.unknown_method()),
        }
    }
}

/// A cell, a ROS system with an arm that stands still, and a client in it.
struct System {
    world: Arc<World>,
    session: Session,
    config: Ros2Config,
    shutdown: Shutdown,
    plans: RosClient<PlanRequest, PlanResponse>,
    _servers: Vec<Server>,
    _router: RawSession,
}

impl System {
    async fn start() -> Self {
        let (world, session, mut servers) = (Arc::new(World::default()), Session::embedded().await.expect("a session"), Vec::new());
        for service in [Service::Perception, Service::Planner, Service::Motion] {
            servers.push(session.start(service, Arc::new(Worker(world.clone()))).await.expect("a worker"));
        }
        let listens = SessionConfig { mode: SessionMode::Router, listen: vec!["tcp/127.0.0.1:0".to_owned()], ..SessionConfig::default() };
        let router = RawSession::open(&listens).await.expect("a router");
        let ros = SessionConfig { mode: SessionMode::Client, connect: router.locators().await, ..SessionConfig::default() };
        let node = Node::join(&ros, 0, "/", "tests").await.expect("a node");
        let joints = node.publisher("/joint_states", "sensor_msgs/msg/JointState", Qos::DEFAULT).await.expect("a publisher");
        tokio::spawn(stand_still(joints));
        let robot = json!({"name": "panda", "trajectory_action": "/arm/follow_joint_trajectory"});
        let robots = vec![serde_json::from_value(robot).expect("a robot")];
        let config = Ros2Config { session: ros, robots, publish_scenes: false, allow_execute: true, ..Ros2Config::default() };
        let plans = node.client("/repose/plan", "repose_msgs/srv/Plan").await.expect("a client");
        Self { world, session, config, shutdown: Shutdown::new(), plans, _servers: servers, _router: router }
    }

    /// What a client finds of a bridge that waits so long for what it has begun, when it is to end; both end.
    async fn with_a_bridge<T>(&self, drain: Duration, client: impl Future<Output = T>) -> T {
        let bridge = repose_ros2::run(self.session.clone(), self.config.clone(), drain, self.shutdown.clone());
        let there = async {
            // Others hear of a service a moment after it has come, and of a robot when its joints are told of.
            let mut tries = tokio::time::interval(EVERY);
            while !self.plan(false).await.is_ok_and(|planned| planned.success) {
                tries.tick().await;
            }
            client.await
        };
        let both = async { tokio::join!(bridge, there) };
        let (ended, found) = tokio::time::timeout(3 * WITHIN, both).await.expect("both end in time");
        ended.expect("the bridge ran");
        found
    }

    async fn plan(&self, execute: bool) -> Result<PlanResponse, BridgeError> {
        let asked = PlanRequest { camera: "front".to_owned(), object: 1, goal: vec!["left_of:2".to_owned()], seed: 1, execute };
        self.plans.call(&asked, WITHIN).await
    }
}

/// Tells of an arm's joints, until the session closes.
async fn stand_still(joints: RosPublisher<JointState>) {
    let named = [("1", 0.0), ("2", -0.8), ("3", 0.0), ("4", -2.4), ("5", 0.0), ("6", 1.6), ("7", 0.8)];
    let name = named.iter().map(|(number, _)| format!("panda_joint{number}")).collect();
    let state = JointState { name, position: named.iter().map(|(_, q_rad)| *q_rad).collect(), ..JointState::default() };
    let mut due = tokio::time::interval(EVERY);
    while joints.publish(&state).await.is_ok() {
        due.tick().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bridge_that_is_to_end_brings_the_execution_under_way_to_its_end_and_begins_no_other() {
    let system = System::start().await;
    let client = async {
        let meanwhile = async {
            system.world.has_begun.notified().await;
            system.shutdown.trigger();
            let refused = system.plan(true).await.expect("it still answers");
            assert_eq!((refused.success, refused.code.as_str()), (false, "unavailable"), "{}", refused.message);
            system.world.may_end.notify_one();
        };
        tokio::join!(system.plan(true), meanwhile).0
    };
    let done = system.with_a_bridge(WITHIN, client).await.expect("an answer");
    assert!(done.success && done.executed, "{}: {}", done.code, done.message);
    assert_eq!(system.world.executions.load(Ordering::SeqCst), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bridge_that_may_not_wait_has_the_arm_come_to_rest_and_tells_whoever_moves_it() {
    let system = System::start().await;
    let client = async {
        let meanwhile = async {
            system.world.has_begun.notified().await;
            system.shutdown.trigger();
            system.world.was_cancelled.notified().await;
        };
        tokio::join!(system.plan(true), meanwhile).0
    };
    let left = system.with_a_bridge(Duration::ZERO, client).await.expect("an answer");
    assert_eq!((left.success, left.executed, left.code.as_str()), (false, false, "unavailable"), "{}", left.message);
    assert!(left.message.contains("look at the robot") && !left.phases.is_empty(), "{}", left.message);
}
