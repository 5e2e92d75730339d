//! A cell of a few lines, for tests: the planner's answers and the outcomes of moves are written down, and each move that is done shows the next view.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use repose_made_scenes::SceneBuilder;
use repose_proto::arrange::ArrangeResult;
use repose_proto::load::WorkerLoad;
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlan, MotionPlanRequest, Phase, RecoverReply};
use repose_proto::place::Placement;
use repose_proto::robot::RobotState;
use repose_proto::{CallError, ErrorCode, GoalTerm, Payload, PlaceResult, Relation, RigidTransform, Scene, SceneSummary, Service};
use repose_runtime::{Answer, Call, Caller, Handler, LoadGauge, Server, Session, load_of};
use serde_json::json;

use crate::site::Site;

/// A cell whose course is written down.
#[derive(Default)]
pub(crate) struct Script {
    pub(crate) clock_ns: AtomicU64,
    /// What is seen now, and after each move that is done.
    pub(crate) views: Mutex<VecDeque<Scene>>,
    /// What is seen once the arm was brought back; as before where none.
    pub(crate) home: Mutex<Option<Scene>>,
    /// By how much a place is away from where its object stands, metres; without it there is none.
    pub(crate) place: Option<[f64; 3]>,
    /// Whether the planner is too busy to find any.
    pub(crate) is_busy: bool,
    pub(crate) plans: Mutex<VecDeque<ArrangeResult>>,
    pub(crate) outcomes: Mutex<VecDeque<ExecutionOutcome>>,
    /// The objects that the robot has moved.
    pub(crate) moved: Mutex<Vec<u16>>,
    /// The object that motion finds no way for.
    pub(crate) unserved: Option<u16>,
}

impl Script {
    fn scene(&self) -> Scene {
        let seen = self.views.lock().expect("views").front().cloned().expect("a view");
        Scene { stamp_ns: self.clock_ns.load(Ordering::SeqCst), ..seen }
    }

    fn plan(&self, request: &MotionPlanRequest) -> Result<MotionPlan, CallError> {
        if self.unserved == Some(request.query) {
            return Err(CallError::precondition("no way there").at("placements"));
        }
        let plan: MotionPlan = serde_json::from_str(include_str!("../../../../proto/tests/golden/MotionPlan.v1.json")).expect("a plan");
        Ok(MotionPlan { query: request.query, placement: 0, not_chosen: Vec::new(), ..plan })
    }

    fn placed(&self) -> PlaceResult {
        let golden = include_str!("../../../../proto/tests/golden/PlaceResult.v1.third.json");
        let golden: PlaceResult = serde_json::from_str(golden).expect("a result");
        let away = |[x, y, z]: [f64; 3]| RigidTransform([1., 0., 0., x, 0., 1., 0., y, 0., 0., 1., z, 0., 0., 0., 1.]);
        let place = |by_m| Placement { placed_from_observed: away(by_m), ..golden.placements[0].clone() };
        PlaceResult { placements: self.place.map(place).into_iter().collect(), view_yaw_rad: 0.0, ..golden }
    }
}

/// The planner and motion.
struct Worker(Arc<Script>);

#[async_trait::async_trait]
impl Handler for Worker {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "arrange" => {
                let planned = self.0.plans.lock().expect("plans").pop_front();
                Payload::json(&planned.ok_or_else(|| CallError::internal("nothing more is planned"))?)
            }
            "place" if self.0.is_busy => Err(CallError::new(ErrorCode::ResourceExhausted, "others come first")),
            "place" => Payload::json(&self.0.placed()),
            "plan" => Payload::json(&self.0.plan(&call.payload.decode_json()?)?),
            _ => Err(call.unknown_method()),
        }
    }

    fn load(&self) -> WorkerLoad {
        load_of(&LoadGauge::default(), 8)
    }
}

/// The cell, at the hands of whoever has goals brought about.
pub(crate) struct ScriptedCell {
    pub(crate) script: Arc<Script>,
    planner: Caller,
    motion: Caller,
}

impl ScriptedCell {
    /// The cell, and its workers.
    pub(crate) async fn of(session: &Session, script: Script) -> (Self, Vec<Server>) {
        let script = Arc::new(script);
        let mut servers = Vec::new();
        for service in [Service::Planner, Service::Motion] {
            servers.push(session.start(service, Arc::new(Worker(script.clone()))).await.expect("a worker"));
        }
        let caller = async |service| session.caller(service).await.expect("a caller");
        let (planner, motion) = (caller(Service::Planner).await, caller(Service::Motion).await);
        (Self { script, planner, motion }, servers)
    }

    /// The arm, brought back.
    fn recovered(&self) -> Result<Payload, CallError> {
        if let Some(home) = self.script.home.lock().expect("home").take() {
            *self.script.views.lock().expect("views") = [home].into();
        }
        let (outcome, joints_rad) = (ExecutionOutcome::Done, [0.0; 7]);
        Payload::json(&RecoverReply { outcome, reason: None, retreated_m: None, checked_against: None, joints_rad })
    }
}

fn answer(payload: Payload) -> Answer {
    Answer { payload, worker: "motion".to_owned(), attempts: 1, timing_ms: BTreeMap::new() }
}

impl Site for ScriptedCell {
    fn robot(&self) -> &str {
        "panda"
    }

    fn camera(&self) -> &str {
        "front"
    }

    fn planner(&self) -> &Caller {
        &self.planner
    }

    fn motion(&self) -> &Caller {
        &self.motion
    }

    fn deadline(&self) -> Duration {
        Duration::from_secs(10)
    }

    async fn newest(&self) -> Result<SceneSummary, CallError> {
        self.script.clock_ns.fetch_add(1, Ordering::SeqCst);
        Ok(self.script.scene().summary("0".repeat(64)))
    }

    async fn scene(&self, _: &str) -> Result<Scene, CallError> {
        Ok(self.script.scene())
    }

    async fn state(&self) -> Result<RobotState, CallError> {
        let (still, stamp_ns) = ([0.0; 7], self.script.clock_ns.load(Ordering::SeqCst));
        let state = json!({"v": 1, "seq": 1, "stamp_ns": stamp_ns, "robot_ms": 0.0, "q_rad": still, "dq_rad_s": still,
            "gripper_width_m": 0.04, "gripper_settled": true, "gripper_holding": false, "mode": "idle"});
        serde_json::from_value(state).map_err(|e| CallError::internal(e.to_string()))
    }

    async fn moving(&mut self, _: &str, _: Payload, plan: Option<&MotionPlan>) -> Result<Answer, CallError> {
        let Some(plan) = plan else { return Ok(answer(self.recovered()?)) };
        let outcome = self.script.outcomes.lock().expect("outcomes").pop_front();
        let outcome = outcome.ok_or_else(|| CallError::internal("nothing more moves"))?;
        self.script.moved.lock().expect("moved").push(plan.query);
        if outcome == ExecutionOutcome::Done {
            self.script.views.lock().expect("views").pop_front();
        }
        let reply = ExecuteReply { outcome, phase: Phase::Retreat, reason: None, joints_rad: [0.0; 7] };
        Ok(answer(Payload::json(&reply)?))
    }
}

/// A term that is to hold.
pub(crate) fn term(relation: Relation, anchor: u16) -> GoalTerm {
    GoalTerm { relation, anchor, holds: true }
}

/// Blocks of 6 cm on a table; what is not seen may be hidden, for nobody knows where the camera is.
pub(crate) fn view(blocks: &[(u16, [f64; 2])]) -> Scene {
    let seen = blocks.iter().fold(SceneBuilder::table(), |seen, (id, at)| seen.object(*id, *at, [0.06; 3]));
    let mut scene = seen.scene();
    scene.meta.camera.world_from_camera = None;
    scene
}
