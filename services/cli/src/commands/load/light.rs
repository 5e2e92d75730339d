//! A light cell: without a camera, a robot and physics, but with their traffic. One session puts a robot's states, as a robot's side does; another hears
//! them and puts summaries of scenes, as perception does, and gives the cell's scene to whoever asks for it. Nobody hears the summaries.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use repose_proto::perception::SceneRequest;
use repose_proto::robot::RobotState;
use repose_proto::{CallError, Payload, Scene, SceneSummary, Service};
use repose_runtime::{Call, Handler, Publisher, RuntimeConfig, Server, Session, Traffic, now_ns};
use serde_json::json;
use tokio::task::JoinSet;

use crate::client;
use crate::failure::Failure;

/// By how much each cell's scene is off the one before it, metres: nothing to a search, and another content.
const APART_M: f32 = 1e-6;
/// States that may wait to be counted: those of some seconds.
const WAITING: usize = 1024;
/// What its robot and its camera are called.
const ROBOT: &str = "panda";
const CAMERA: &str = "front";

/// What light cells put by themselves, times a second; 0 is nothing.
#[derive(Debug, Clone, Copy)]
pub struct Rates {
    /// Robot states of each.
    pub states_per_s: f64,
    /// Summaries of scenes of each.
    pub summaries_per_s: f64,
}

/// What all light cells of a run have put and heard.
#[derive(Debug, Default)]
pub struct Counts {
    /// Robot states put.
    pub states_put: AtomicU64,
    /// Robot states that the cells' other sessions heard.
    pub states_heard: AtomicU64,
    /// Summaries put.
    pub summaries_put: AtomicU64,
    /// Times that a scene went to somebody, whole.
    pub scenes_sent: AtomicU64,
}

/// A cell. It falls silent when this goes.
pub struct LightCell {
    /// Its scene's id.
    pub scene_id: String,
    /// The session of its perception, and of whoever asks in it.
    pub session: Session,
    robot: Session,
    perception: Server,
    streams: JoinSet<()>,
}

/// The name of the `k`-th.
pub fn name(k: usize) -> String {
    format!("light-{k}")
}

/// The scene of the `k`-th, hardly another than the camera's.
pub fn scene_of(k: usize, camera: &Scene) -> Scene {
    let mut scene = camera.clone();
    if let Some(point) = scene.points.first_mut() {
        point[0] += APART_M * k as f32;
    }
    scene
}

impl LightCell {
    /// Starts the `k`-th. Of several routers it uses the one whose turn it is.
    pub async fn start(k: usize, camera: Arc<Scene>, config: &RuntimeConfig, rates: Rates, counts: Arc<Counts>) -> Result<Self, Failure> {
        let mut config = config.clone();
        let routers = config.session.connect.len().max(1);
        config.session.connect.rotate_left(k % routers);
        config.session.cell = name(k);
        let (robot, session) = (Session::open(config.clone()).await?, Session::open(config).await?);
        let scene = scene_of(k, &camera);
        let summary = scene.summary(scene.id());
        let scene_id = summary.scene_id.clone();
        let handler = OneScene { k, camera, scene_id: scene_id.clone(), counts: counts.clone() };
        let perception = session.start(Service::Perception, Arc::new(handler)).await?;
        let mut streams = JoinSet::new();
        // All are counted, those too that came while whoever counts them waited for a core.
        let mut heard = session.subscribe_queue(&session.cell().robot_state(ROBOT), WAITING).await?;
        let hearing = counts.clone();
        streams.spawn(async move {
            while heard.recv().await.is_some() {
                hearing.states_heard.fetch_add(1, Ordering::Relaxed);
            }
        });
        let states = robot.publisher(robot.cell().robot_state(ROBOT), Traffic::RobotState);
        let (putting, mut seq) = (counts.clone(), 0);
        streams.spawn(put_again_and_again(states, rates.states_per_s, move || {
            putting.states_put.fetch_add(1, Ordering::Relaxed);
            seq += 1;
            standing(seq).and_then(|state| Payload::json(&state))
        }));
        let summaries = session.publisher(session.cell().scene(CAMERA), Traffic::Scene);
        streams.spawn(put_again_and_again(summaries, rates.summaries_per_s, move || {
            counts.summaries_put.fetch_add(1, Ordering::Relaxed);
            Payload::json(&SceneSummary { stamp_ns: now_ns(), ..summary.clone() })
        }));
        Ok(Self { scene_id, session, robot, perception, streams })
    }

    /// Closes its sessions.
    pub async fn close(self) {
        drop(self.streams);
        self.perception.drain().await;
        client::close(self.robot).await;
        client::close(self.session).await;
    }
}

/// What a robot that stands says of itself.
fn standing(seq: u64) -> Result<RobotState, CallError> {
    let still = [0.0; 7];
    let state = json!({
        "v": 1, "seq": seq, "stamp_ns": now_ns(), "robot_ms": seq as f64 * 20.0, "q_rad": [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785],
        "dq_rad_s": still, "gripper_width_m": 0.08, "gripper_settled": true, "gripper_holding": false, "mode": "idle",
    });
    serde_json::from_value(state).map_err(|e| CallError::internal(format!("a robot's state: {e}")))
}

async fn put_again_and_again(to: Publisher, times_per_s: f64, mut next: impl FnMut() -> Result<Payload, CallError>) {
    if times_per_s <= 0.0 {
        return;
    }
    let mut ticks = tokio::time::interval(Duration::from_secs_f64(1.0 / times_per_s));
    // A machine that cannot keep up puts fewer, which the counts show.
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    loop {
        ticks.tick().await;
        let put = match next() {
            Ok(payload) => to.put(payload).await.map_err(|error| error.to_string()),
            Err(error) => Err(error.to_string()),
        };
        if let Err(error) = put {
            tracing::warn!(key = to.key(), error, "could not be put");
        }
    }
}

/// Perception that has seen one scene.
struct OneScene {
    k: usize,
    camera: Arc<Scene>,
    scene_id: String,
    counts: Arc<Counts>,
}

#[async_trait]
impl Handler for OneScene {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        if call.method != "scene" {
            return Err(call.unknown_method());
        }
        let asked: SceneRequest = call.payload.decode_json()?;
        if asked.scene_id != self.scene_id {
            return Err(CallError::not_found("scene_id", format!("scene {} is not of this cell", asked.scene_id)));
        }
        let is_first = asked.part.is_none_or(|range| range.offset == 0);
        self.counts.scenes_sent.fetch_add(u64::from(is_first), Ordering::Relaxed);
        // Made when it is asked for: megabytes for each of hundreds of cells would not fit.
        asked.answer(&Payload::bulk(Scene::SCHEMA, &scene_of(self.k, &self.camera).to_bulk())?)
    }
}
