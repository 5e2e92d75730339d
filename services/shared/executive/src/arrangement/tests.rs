//! Arrangements in a cell of a few lines: the planner's answers and the outcomes of moves are written down, and each move that is done shows the next view.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use repose_made_scenes::SceneBuilder;
use repose_proto::load::WorkerLoad;
use repose_proto::motion::{ExecuteReply, MotionPlan, MotionPlanRequest, Phase};
use repose_proto::robot::RobotState;
use repose_proto::{PlaceResult, Relation, RigidTransform, SceneSummary, Service};
use repose_runtime::{Answer, Call, Caller, Handler, LoadGauge, Session, load_of};
use serde_json::json;

use super::*;

/// A cell whose course is written down.
#[derive(Default)]
struct Script {
    clock_ns: AtomicU64,
    /// What is seen now, and after each move that is done.
    views: Mutex<VecDeque<Scene>>,
    plans: Mutex<VecDeque<ArrangeResult>>,
    outcomes: Mutex<VecDeque<ExecutionOutcome>>,
    /// The objects that the robot has moved.
    moved: Mutex<Vec<u16>>,
    /// The object that motion finds no way for.
    unserved: Option<u16>,
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
        let plan: MotionPlan = serde_json::from_str(include_str!("../../../../../proto/tests/golden/MotionPlan.v1.json")).expect("a plan");
        Ok(MotionPlan { query: request.query, placement: 0, not_chosen: Vec::new(), ..plan })
    }
}

/// The planner, which has no places but those of its plans, and motion.
struct Worker(Arc<Script>);

#[async_trait::async_trait]
impl Handler for Worker {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "arrange" => {
                let planned = self.0.plans.lock().expect("plans").pop_front();
                Payload::json(&planned.ok_or_else(|| CallError::internal("nothing more is planned"))?)
            }
            "place" => {
                let golden = include_str!("../../../../../proto/tests/golden/PlaceResult.v1.third.json");
                let result: PlaceResult = serde_json::from_str(golden).expect("a result");
                Payload::json(&PlaceResult { placements: Vec::new(), ..result })
            }
            "plan" => Payload::json(&self.0.plan(&call.payload.decode_json()?)?),
            _ => Err(call.unknown_method()),
        }
    }

    fn load(&self) -> WorkerLoad {
        load_of(&LoadGauge::default(), 8)
    }
}

struct ScriptedCell {
    script: Arc<Script>,
    planner: Caller,
    motion: Caller,
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

    async fn moving(&mut self, method: &str, _: Payload, plan: Option<&MotionPlan>) -> Result<Answer, CallError> {
        let plan = plan.ok_or_else(|| CallError::internal(format!("{method}: it only carries plans out")))?;
        let outcome = self.script.outcomes.lock().expect("outcomes").pop_front();
        let outcome = outcome.ok_or_else(|| CallError::internal("nothing more moves"))?;
        self.script.moved.lock().expect("moved").push(plan.query);
        if outcome == ExecutionOutcome::Done {
            self.script.views.lock().expect("views").pop_front();
        }
        let reply = ExecuteReply { outcome, phase: Phase::Retreat, reason: None, joints_rad: [0.0; 7] };
        Ok(Answer { payload: Payload::json(&reply)?, worker: "motion".to_owned(), attempts: 1, timing_ms: BTreeMap::new() })
    }
}

fn term(relation: Relation, anchor: u16) -> GoalTerm {
    GoalTerm { relation, anchor, holds: true }
}

fn goal(object: u16, relation: Relation, anchor: u16) -> ObjectGoal {
    ObjectGoal { object, terms: vec![term(relation, anchor)] }
}

/// A plan: each object, where it goes from where it is, and what for.
fn plan(outcome: Found, moves: &[(u16, [f64; 3], GoalTerm)]) -> ArrangeResult {
    let golden = include_str!("../../../../../proto/tests/golden/ArrangeResult.v1.json");
    let golden: ArrangeResult = serde_json::from_str(golden).expect("a result");
    let a_move = golden.moves[0].clone();
    let planned = |(object, [x, y, z], term): &(u16, [f64; 3], GoalTerm)| {
        let motion = RigidTransform([1., 0., 0., *x, 0., 1., 0., *y, 0., 0., 1., *z, 0., 0., 0., 1.]);
        let placement = Placement { placed_from_observed: motion, ..a_move.placement.clone() };
        ArrangeMove { object: *object, purpose: Purpose::Goal, goal: vec![*term], placement }
    };
    ArrangeResult { outcome, moves: moves.iter().map(planned).collect(), conflict: None, needs_view: Vec::new(), ..golden }
}

/// Blocks of 6 cm on a table; what is not seen may be hidden, for nobody knows where the camera is.
fn view(blocks: &[(u16, [f64; 2])]) -> Scene {
    let seen = blocks.iter().fold(SceneBuilder::table(), |seen, (id, at)| seen.object(*id, *at, [0.06; 3]));
    let mut scene = seen.scene();
    scene.meta.camera.world_from_camera = None;
    scene
}

/// What comes of goals in a cell, each object tried three times at most; and which objects were moved.
async fn brought_about(script: Script, goals: Vec<ObjectGoal>) -> (ArrangementReport, Vec<u16>) {
    let session = Session::embedded().await.expect("a session");
    let script = Arc::new(script);
    let mut servers = Vec::new();
    for service in [Service::Planner, Service::Motion] {
        servers.push(session.start(service, Arc::new(Worker(script.clone()))).await.expect("a worker"));
    }
    let caller = async |service| session.caller(service).await.expect("a caller");
    let (planner, motion) = (caller(Service::Planner).await, caller(Service::Motion).await);
    let site = ScriptedCell { script: script.clone(), planner, motion };
    let report = bring_about(site, None, ArrangeRequest::new("0".repeat(64), goals), 3, |_| ()).await.expect("a report");
    drop(servers);
    let moved = script.moved.lock().expect("moved").clone();
    (report, moved)
}

/// 2 stands behind 1 and is hidden once 3 stands before that.
fn hiding() -> Mutex<VecDeque<Scene>> {
    let first = view(&[(1, [0.0, 0.0]), (2, [0.0, 0.2]), (3, [0.3, 0.0])]);
    Mutex::new([first, view(&[(1, [0.0, 0.0]), (3, [0.0, -0.2])])].into())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_that_holds_from_the_first_and_is_hidden_by_the_first_move_is_achieved() {
    let before = (3, [-0.3, -0.2, 0.0], term(Relation::InFrontOf, 1));
    let script = Script {
        views: hiding(),
        plans: Mutex::new([plan(Found::Found, &[before]), plan(Found::Found, &[])].into()),
        outcomes: Mutex::new([ExecutionOutcome::Done].into()),
        ..Script::default()
    };
    let goals = vec![goal(2, Relation::Behind, 1), goal(3, Relation::InFrontOf, 1)];
    let (report, moved) = brought_about(script, goals).await;
    assert_eq!((report.ended, moved), (ArrangementEnd::Achieved, vec![3]), "{:?}", report.why);
    assert_eq!((report.remembered, report.achieved), ([2].into(), 2));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_planned_on_top_of_a_move_that_was_not_made_is_not_carried_out() {
    let seen = view(&[(1, [0.0, 0.0]), (2, [0.2, 0.1]), (3, [-0.3, 0.0])]);
    let stacking = [(1, [-0.3, 0.0, 0.06], term(Relation::Above, 3)), (2, [-0.5, -0.1, 0.12], term(Relation::Above, 1))];
    let none = || plan(Found::None, &[]);
    let script = Script {
        views: Mutex::new([seen].into()),
        plans: Mutex::new([plan(Found::Found, &stacking), none(), none(), none()].into()),
        outcomes: Mutex::new([ExecutionOutcome::Done].into()),
        unserved: Some(1),
        ..Script::default()
    };
    let goals = vec![goal(1, Relation::Above, 3), goal(2, Relation::Above, 1)];
    let (report, moved) = brought_about(script, goals).await;
    assert_eq!((report.ended, moved), (ArrangementEnd::NoArrangement, vec![]), "{:?}", report.why);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hidden_goal_is_not_remembered_once_a_move_of_what_it_is_about_was_stopped() {
    let before = (3, [-0.3, -0.2, 0.0], term(Relation::InFrontOf, 1));
    let aside = (1, [0.2, 0.0, 0.0], term(Relation::RightOf, 3));
    let script = Script {
        views: hiding(),
        plans: Mutex::new([plan(Found::Found, &[before, aside]), plan(Found::Found, &[aside])].into()),
        outcomes: Mutex::new([ExecutionOutcome::Done, ExecutionOutcome::Stopped].into()),
        ..Script::default()
    };
    let (report, moved) = brought_about(script, vec![goal(2, Relation::Behind, 1), goal(1, Relation::RightOf, 3)]).await;
    assert_eq!((report.ended, moved), (ArrangementEnd::Stopped, vec![3, 1]), "{:?}", report.why);
    assert_eq!((report.remembered, report.achieved), (BTreeSet::new(), 0));
}
