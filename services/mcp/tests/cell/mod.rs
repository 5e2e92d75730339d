//! A cell of a few lines: a camera that sees blocks, a planner that always answers the same, an arm that moves what it is told to.

pub mod agent;
pub mod http;

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use repose_mcp::asker::Asker;
use repose_mcp::{Desk, McpSettings};
use repose_proto::load::WorkerLoad;
use repose_proto::motion::{MotionPlan, MotionPlanRequest};
use repose_proto::perception::SceneRequest;
use repose_proto::robot::{EmergencyStop, RobotMode, RobotState, StopState};
use repose_proto::{CallError, CameraModel, ErrorCode, Payload, PlaceRequest, PlaceResult, RigidTransform, Scene, Service};
use repose_runtime::{Call, Handler, LoadGauge, Server, Session, Traffic, load_of, now_ns};
use serde_json::json;
use tokio::sync::Notify;

/// How long anything may take.
pub const WITHIN: Duration = Duration::from_secs(20);

/// A block: its id in the newest view, its centre on the floor, its color.
pub type Block = (u16, [f64; 2], [u8; 3]);

/// Where the planner says that things go.
pub const GOES: [f64; 3] = [-0.4, 0.0, 0.0];

/// What is in the cell.
#[derive(Default)]
pub struct World {
    blocks: Mutex<Vec<Block>>,
    /// Whether the planner finds a place.
    pub has_place: Mutex<bool>,
    stop: Mutex<Option<StopState>>,
    /// Executions wait for this.
    pub may_move: Notify,
    /// Tells that one was given up.
    pub was_cancelled: Notify,
    /// Tells that one has begun.
    pub has_begun: Notify,
    executions: AtomicU64,
    /// How long the camera and motion take to answer, milliseconds.
    pub takes_ms: AtomicU64,
    /// Whether perception holds no scene that it has told of.
    pub holds_none: AtomicBool,
    /// Whether the robot tells no state.
    pub is_mute: AtomicBool,
}

impl World {
    /// Puts a block elsewhere, as a hand does.
    pub fn push(&self, id: u16, by: [f64; 2]) {
        let mut blocks = self.blocks.lock().expect("blocks");
        let block = blocks.iter_mut().find(|(block, ..)| *block == id).expect("a block");
        (block.1[0], block.1[1]) = (block.1[0] + by[0], block.1[1] + by[1]);
    }

    /// Gives every block another number, as a camera that finds them anew does.
    pub fn renumber(&self, ids: &[u16]) {
        self.blocks.lock().expect("blocks").iter_mut().zip(ids).for_each(|(block, id)| block.0 = *id);
    }

    /// How many executions were begun.
    pub fn executions(&self) -> u64 {
        self.executions.load(Ordering::SeqCst)
    }

    /// What stop is latched.
    pub fn stop(&self) -> Option<StopState> {
        self.stop.lock().expect("the stop").clone()
    }

    async fn waited(&self) {
        tokio::time::sleep(Duration::from_millis(self.takes_ms.load(Ordering::SeqCst))).await;
    }

    fn scene(&self) -> Scene {
        let blocks = self.blocks.lock().expect("blocks").clone();
        let (mut points, mut labels, mut colors, mut objects) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (id, [x, y], color) in blocks {
            for i in 0..512 {
                let at = |k: usize| f64::from(i >> (3 * k) & 7) / 7.0 * 0.08;
                points.push([(x - 0.04 + at(0)) as f32, (y - 0.04 + at(1)) as f32, at(2) as f32]);
                labels.push(id);
                colors.push(color);
            }
            objects.push(json!({"id": id, "points": 512, "centroid_m": [x, y, 0.04], "extent_m": [0.08, 0.08, 0.08], "completeness": 1.0}));
        }
        let down = RigidTransform([1., 0., 0., 0., 0., -1., 0., 0., 0., 0., -1., 1., 0., 0., 0., 1.]);
        let camera = CameraModel {
            width: 64,
            height: 48,
            fx: 40.0,
            fy: 40.0,
            cx: 32.0,
            cy: 24.0,
            depth_unit_m: 1e-3,
            world_from_camera: Some(down),
        };
        let meta = json!({
            "objects": objects, "surfaces": [], "camera": camera, "world_frame": "extrinsics", "view_yaw_rad": 0.0,
            "unseen": {"pixels_without_reading": 0, "pixels_on_borders": 0, "share": 0.0}
        });
        let meta = serde_json::from_value(meta).expect("metadata");
        Scene { camera_name: "front".to_owned(), stamp_ns: now_ns(), points, labels, colors: Some(colors), meta, as_sent: None }
    }

    fn place(&self, request: &PlaceRequest) -> PlaceResult {
        let mut result: PlaceResult =
            serde_json::from_str(include_str!("../../../../proto/tests/golden/PlaceResult.v1.third.json")).expect("a result");
        let [x, y, z] = GOES;
        result.placements[0].placed_from_observed = RigidTransform([1., 0., 0., x, 0., 1., 0., y, 0., 0., 1., z, 0., 0., 0., 1.]);
        if !*self.has_place.lock().expect("the answer") {
            result.placements.clear();
        }
        PlaceResult {
            scene_id: request.scene.scene_id.clone(),
            query: request.query,
            goal: request.goal.clone(),
            view_yaw_rad: 0.0,
            ..result
        }
    }

    fn plan(request: &MotionPlanRequest) -> MotionPlan {
        let plan: MotionPlan = serde_json::from_str(include_str!("../../../../proto/tests/golden/MotionPlan.v1.json")).expect("a plan");
        let (scene_id, robot) = (request.scene.scene_id.clone(), request.robot.clone());
        MotionPlan { scene_id, robot, query: request.query, placement: 0, not_chosen: Vec::new(), ..plan }
    }

    /// Moves the block when it may, or says that it was stopped.
    async fn execute(&self, plan: &MotionPlan) -> serde_json::Value {
        self.executions.fetch_add(1, Ordering::SeqCst);
        self.has_begun.notify_one();
        self.may_move.notified().await;
        let stopped = self.stop();
        if stopped.is_none() {
            self.push(plan.query, [GOES[0], GOES[1]]);
        }
        let outcome = if stopped.is_some() { "stopped" } else { "done" };
        json!({"outcome": outcome, "phase": "retreat", "reason": stopped.map(|s| s.reason), "joints_rad": plan.start_joints_rad})
    }

    fn state(&self, seq: u64) -> RobotState {
        let stop = self.stop();
        let mode = if stop.is_some() { RobotMode::Stopped } else { RobotMode::Idle };
        let still = [0.0; 7];
        serde_json::from_value(json!({
            "v": 1, "seq": seq, "stamp_ns": now_ns(), "robot_ms": 0.0, "q_rad": still, "dq_rad_s": still, "gripper_width_m": 0.04,
            "gripper_settled": true, "gripper_holding": false, "mode": mode, "stop": stop, "owner": null, "last_command": null, "stream_ms": null
        }))
        .expect("a state")
    }
}

struct Worker(Arc<World>);

#[async_trait::async_trait]
impl Handler for Worker {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "latest" => {
                self.0.waited().await;
                let scene = self.0.scene();
                Payload::json(&scene.summary(scene.id()))
            }
            "scene" => {
                let SceneRequest { scene_id, .. } = call.payload.decode_json()?;
                let scene = self.0.scene();
                match scene.id() == scene_id && !self.0.holds_none.load(Ordering::SeqCst) {
                    true => Payload::bulk(Scene::SCHEMA, &scene.to_bulk()),
                    false => Err(CallError::not_found("scene_id", "the blocks were moved meanwhile")),
                }
            }
            "place" => Payload::json(&self.0.place(&call.payload.decode_json()?)),
            "plan" => {
                self.0.waited().await;
                Payload::json(&World::plan(&call.payload.decode_json()?))
            }
            "execute" => {
                let plan = call.payload.decode_json()?;
                let reply = tokio::select! {
                    reply = self.0.execute(&plan) => reply,
                    () = call.cancelled.cancelled() => {
                        self.0.was_cancelled.notify_one();
                        return Err(CallError::new(ErrorCode::Cancelled, "the arm has come to rest"));
                    }
                };
                Payload::json(&serde_json::from_value::<repose_proto::motion::ExecuteReply>(reply).expect("a reply"))
            }
            _ => Err(call.unknown_method()),
        }
    }

    fn load(&self) -> WorkerLoad {
        load_of(&LoadGauge::default(), 8)
    }
}

/// A cell with a red, a blue and a green block, and a desk in it.
pub struct Cell {
    pub world: Arc<World>,
    pub desk: Arc<Desk>,
    _servers: Vec<Server>,
    _session: Session,
}

pub async fn start(allow_execute: bool) -> Cell {
    start_with(McpSettings { allow_execute, ..McpSettings::default() }).await
}

pub async fn start_with(settings: McpSettings) -> Cell {
    let session = Session::embedded().await.expect("a session");
    let world = Arc::new(World::default());
    *world.blocks.lock().expect("blocks") =
        vec![(1, [0.2, 0.0], [200, 30, 30]), (2, [0.0, 0.0], [30, 50, 200]), (3, [0.2, 0.25], [30, 150, 50])];
    *world.has_place.lock().expect("the answer") = true;
    let mut servers = Vec::new();
    for service in [Service::Perception, Service::Planner, Service::Motion] {
        servers.push(session.start(service, Arc::new(Worker(world.clone()))).await.expect("a worker"));
    }
    robot(&session, world.clone()).await;
    let desk = Desk::open(session.clone(), settings).await.expect("a desk");
    Cell { world, desk: Arc::new(desk), _servers: servers, _session: session }
}

/// A robot that tells its state and latches stops, until the session closes.
async fn robot(session: &Session, world: Arc<World>) {
    let mut stops = session.subscribe_queue(&session.cell().robot_estop("panda"), 16).await.expect("a subscription");
    let states = session.publisher(session.cell().robot_state("panda"), Traffic::RobotState);
    tokio::spawn(async move {
        let mut tick = tokio::time::interval(Duration::from_millis(10));
        for seq in 0.. {
            tokio::select! {
                _ = tick.tick() => {}
                Some(sample) = stops.recv() => {
                    let EmergencyStop { id, reason, .. } = EmergencyStop::read(&sample.payload.bytes);
                    let stop = StopState { kind: "estop".to_owned(), reason, estop_id: Some(id) };
                    *world.stop.lock().expect("the stop") = Some(stop);
                }
            }
            if world.is_mute.load(Ordering::SeqCst) {
                continue;
            }
            if states.put(Payload::json(&world.state(seq)).expect("encoded")).await.is_err() {
                return;
            }
        }
    });
}

pub fn asker(session: &str) -> Asker {
    Asker { client: "tests 1".to_owned(), session: session.to_owned() }
}
