//! The service as its callers and robots see it, on one embedded session.

mod common;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use async_trait::async_trait;
use common::{NOW_NS, PHASES, Robot, plan, task};
use repose_motion::robot_link::RobotLink;
use repose_motion::{MotionConfig, run, synthetic};
use repose_panda::READY;
use repose_proto::enclosed::enclose;
use repose_proto::motion::{
    ExecuteProgress, ExecuteReply, ExecutionOutcome, Grasp, MotionFailure, MotionPlan, MotionPlanRequest, Phase, RecoverReply,
    RecoverRequest, RecoveryMove, RobotResetReply, RobotResetRequest,
};
use repose_proto::perception::SceneRequest;
use repose_proto::robot::{RobotCommand, RobotMode, StopState};
use repose_proto::scene::WorldFrame;
use repose_proto::{CallError, ErrorCode, Message, Payload, RigidTransform, Scene, SceneRef, Service};
use repose_runtime::{Answer, Call, CallOptions, Caller, Handler, Session, Shutdown, Traffic, now_ns};
use tokio::sync::{Notify, Semaphore, oneshot};
use tokio::time::MissedTickBehavior;

/// The synthetic table as perception would send it.
fn scene() -> Scene {
    synthetic::wire_scene(now_ns())
}

/// Box 1 by 45 cm to the side.
fn request(scene: &Scene) -> MotionPlanRequest {
    let mut moved = RigidTransform::IDENTITY;
    moved.0[7] = 0.45;
    MotionPlanRequest { seed: 1, ..MotionPlanRequest::new(scene.id(), "panda".to_owned(), 1, vec![moved], READY) }
}

fn bulk(request: &MotionPlanRequest, scene: &Scene) -> Payload {
    Payload::bulk(MotionPlanRequest::SCHEMA, &enclose(request, Some(scene))).unwrap()
}

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
        let config = MotionConfig { robot_timeout_ms: 5000, command_period_ms: 10, ..MotionConfig::default() };
        let service = tokio::spawn(run(session.clone(), config, shutdown.clone()));
        let caller = session.caller(Service::Motion).await.unwrap();
        caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
        Self { session, caller, shutdown, service }
    }

    async fn call(&self, method: &str, payload: Payload) -> Result<Answer, CallError> {
        self.caller.call(method, payload, CallOptions::at_most_once(Duration::from_secs(30))).await
    }

    /// A robot on the keys, ten times as fast as real time.
    async fn robot(&self, robot: Robot) -> Arc<Mutex<Robot>> {
        let robot = Arc::new(Mutex::new(robot));
        let (session, state_key) = (self.session.clone(), self.session.cell().robot_state("panda"));
        let mut commands = session.subscribe_queue(&session.cell().robot_command("panda"), 64).await.unwrap();
        let shown = robot.clone();
        tokio::spawn(async move {
            let mut ticks = tokio::time::interval(Duration::from_millis(1));
            // While nothing of this process runs, no time passes for the robot: one that made up for a pause would outrun its commander.
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
            loop {
                tokio::select! {
                    Some(sample) = commands.recv() => shown.lock().unwrap().take(&sample.payload.decode_json::<RobotCommand>().unwrap()),
                    _ = ticks.tick() => {
                        let state = {
                            let mut robot = shown.lock().unwrap();
                            robot.advance();
                            Payload::json(&robot.state).unwrap()
                        };
                        session.put(&state_key, state, Traffic::RobotState).await.unwrap();
                    }
                }
            }
        });
        robot
    }

    async fn stop(self) {
        self.shutdown.trigger();
        self.service.await.unwrap().unwrap();
    }
}

fn refusal(result: Result<Answer, CallError>) -> (ErrorCode, Option<String>) {
    let error = result.unwrap_err();
    (error.code, error.field)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_needs_its_scene_once_and_says_what_is_wrong_with_a_request() {
    let running = Running::start().await;
    let scene = scene();
    let request = request(&scene);
    let by_id = || Payload::json(&request).unwrap();
    assert_eq!(refusal(running.call("plan", by_id()).await), (ErrorCode::NotFound, Some("scene_id".to_owned())));
    let mut far = request.clone();
    far.placements[0].0[7] = 5.0;
    let error = running.call("plan", bulk(&far, &scene)).await.unwrap_err();
    assert_eq!((error.code, error.field.as_deref()), (ErrorCode::FailedPrecondition, Some("placements")));
    assert!(error.message.contains("place_unreachable: "), "{}", error.message);
    // The scene is kept though nothing could be planned on it.
    let planned: MotionPlan = running.call("plan", by_id()).await.unwrap().payload.decode_json().unwrap();
    assert_eq!(planned.phases.iter().map(|p| p.name).collect::<Vec<_>>(), [&PHASES[..], &[Phase::Home]].concat());
    assert_eq!((planned.placement, planned.scene_stamp_ns), (0, scene.stamp_ns));
    let again: MotionPlan = running.call("plan", by_id()).await.unwrap().payload.decode_json().unwrap();
    assert_eq!(again, planned, "the same request and seed give the same plan");
    // The same content seen again makes the scene younger, and an older sighting of it no older.
    let seen_again = Scene { stamp_ns: scene.stamp_ns + 5, ..scene.clone() };
    for sent in [bulk(&request, &seen_again), by_id(), bulk(&request, &scene)] {
        let younger: MotionPlan = running.call("plan", sent).await.unwrap().payload.decode_json().unwrap();
        assert_eq!(younger.scene_stamp_ns, seen_again.stamp_ns);
    }

    let refused = async |change: &dyn Fn(&mut MotionPlanRequest)| {
        let mut changed = request.clone();
        change(&mut changed);
        refusal(running.call("plan", Payload::json(&changed).unwrap()).await)
    };
    assert_eq!(refused(&|r| r.query = 9).await, (ErrorCode::NotFound, Some("query".to_owned())));
    assert_eq!(refused(&|r| r.start_joints_rad[1] = 0.9).await, (ErrorCode::FailedPrecondition, Some("start_joints_rad".to_owned())));
    assert_eq!(refusal(running.call("dance", by_id()).await).0, ErrorCode::InvalidArgument);

    let mut other = scene.clone();
    other.points[0][0] += 0.1;
    assert_eq!(
        refusal(
            running
                .call("plan", bulk(&MotionPlanRequest { scene: SceneRef { scene_id: "0".repeat(64) }, ..request.clone() }, &other))
                .await
        )
        .0,
        ErrorCode::InvalidArgument
    );
    other.meta.world_frame = WorldFrame::SupportPlane;
    let uncalibrated = MotionPlanRequest { scene: SceneRef { scene_id: other.id() }, ..request.clone() };
    assert_eq!(refusal(running.call("plan", bulk(&uncalibrated, &other)).await).0, ErrorCode::FailedPrecondition);
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_may_bring_its_grasps_and_the_answer_says_why_better_placements_were_not_taken() {
    let running = Running::start().await;
    let scene = scene();
    let found: MotionPlan = running.call("plan", bulk(&request(&scene), &scene)).await.unwrap().payload.decode_json().unwrap();
    let asked = async |grasps: Vec<Grasp>, x_m: f64| {
        let mut far = RigidTransform::IDENTITY;
        far.0[3] = x_m;
        let mut placements = request(&scene).placements;
        placements.insert(0, far);
        let asked = MotionPlanRequest { grasps: Some(grasps), placements, ..request(&scene) };
        running.call("plan", Payload::json(&asked).unwrap()).await
    };
    let mut out_of_reach = found.grasp.clone();
    out_of_reach.world_from_tcp.0[3] += 2.0;
    let plan: MotionPlan = asked(vec![out_of_reach.clone(), found.grasp.clone()], 1.5).await.unwrap().payload.decode_json().unwrap();
    assert_eq!((plan.grasp.world_from_tcp, plan.placement), (found.grasp.world_from_tcp, 1), "the second grasp, the second placement");
    let reasons: Vec<_> = plan.not_chosen.iter().map(|n| (n.placement, n.reason)).collect();
    assert_eq!(reasons, [(0, MotionFailure::PlaceUnreachable)]);
    assert!(plan.not_chosen[0].detail.contains("out of reach"), "{}", plan.not_chosen[0].detail);

    assert_eq!(refusal(asked(vec![out_of_reach], 0.0).await), (ErrorCode::FailedPrecondition, Some("placements".to_owned())));
    assert_eq!(refusal(asked(Vec::new(), 0.0).await), (ErrorCode::InvalidArgument, Some("grasps".to_owned())));
    let mut bent = found.grasp.clone();
    bent.world_from_tcp.0[0] = 7.0;
    let (code, field) = refusal(asked(vec![bent], 0.0).await);
    assert_eq!(code, ErrorCode::InvalidArgument);
    assert!(field.as_deref().is_some_and(|f| f.starts_with("grasps[0]")), "{field:?}");
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_execution_reports_its_phases_and_happens_once() {
    let running = Running::start().await;
    let robot = running.robot(Robot::new()).await;
    let plan = MotionPlan { scene_stamp_ns: NOW_NS, max_scene_age_ms: 60_000, ..plan() };
    let payload = Payload::json(&plan).unwrap();
    let (progress, mut progressed) = tokio::sync::mpsc::channel(16);
    let options = || CallOptions {
        id: Some("5d0a5ffc-6f0c-4a55-a04a-6d3c3f2b7f11".to_owned()),
        ..CallOptions::at_most_once(Duration::from_secs(30))
    };
    let answer = running.caller.call("execute", payload.clone(), CallOptions { progress: Some(progress), ..options() }).await.unwrap();
    let reply: ExecuteReply = answer.payload.decode_json().unwrap();
    assert_eq!((reply.outcome, reply.phase), (ExecutionOutcome::Done, Phase::Retreat), "{reply:?}");
    let mut phases = Vec::new();
    while let Some(payload) = progressed.recv().await {
        phases.push(payload.decode_json::<ExecuteProgress>().unwrap().phase);
    }
    assert_eq!(phases, PHASES);

    let commands = robot.lock().unwrap().state.last_command;
    let again = running.caller.call("execute", payload, options()).await.unwrap();
    assert_eq!(again.payload.decode_json::<ExecuteReply>().unwrap(), reply);
    assert_eq!(robot.lock().unwrap().state.last_command, commands, "nothing was sent the second time");
    let other = Payload::json(&MotionPlan { query: 2, ..plan }).unwrap();
    assert_eq!(refusal(running.caller.call("execute", other, options()).await).0, ErrorCode::FailedPrecondition);
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_arm_comes_to_rest_where_one_beside_it_begins_to_do_something() {
    let running = Running::start().await;
    let robot = running.robot(Robot::new()).await;
    let mut slow = MotionPlan { scene_stamp_ns: NOW_NS, max_scene_age_ms: 60_000, ..plan() };
    slow.phases.iter_mut().flat_map(|phase| &mut phase.set_points).for_each(|point| point.t_ms *= 10.0);
    let (progress, mut progressed) = tokio::sync::mpsc::channel(16);
    let options = CallOptions { progress: Some(progress), ..CallOptions::at_most_once(Duration::from_secs(30)) };
    let executing = running.caller.call("execute", Payload::json(&slow).unwrap(), options);
    let mut across = Robot::new().state;
    let base = RigidTransform([1.0, 0.0, 0.0, 0.9, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    (across.mode, across.world_from_base) = (RobotMode::Moving, Some(base));
    let beginning = async {
        // Each has been found standing still by the other.
        progressed.recv().await.unwrap();
        let told = running.session.cell().robot_state("across");
        running.session.put(&told, Payload::json(&across).unwrap(), Traffic::RobotState).await.unwrap();
    };
    let (answer, ()) = tokio::join!(executing, beginning);
    let reply: ExecuteReply = answer.unwrap().payload.decode_json().unwrap();
    assert_eq!((reply.outcome, reply.phase), (ExecutionOutcome::Stopped, Phase::Standoff), "{reply:?}");
    assert!(reply.reason.as_deref().is_some_and(|reason| reason.contains("robot across")), "{reply:?}");
    let state = robot.lock().unwrap().state.clone();
    assert_eq!((state.mode, state.open_task()), (RobotMode::Idle, None), "it stands, and its task is closed");
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_arm_beside_has_moved_since_makes_a_scene_stale() {
    let running = Running::start().await;
    let robot = running.robot(Robot::new()).await;
    let seen_before = MotionPlan { scene_stamp_ns: NOW_NS - 10_000_000_000, max_scene_age_ms: 60_000, ..plan() };
    let home = async |age_s: u64| {
        let scene = Scene { stamp_ns: NOW_NS - age_s * 1_000_000_000, ..scene() };
        let request = RecoverRequest { robot: "panda".to_owned(), motion: RecoveryMove::Home, scene: None };
        running.call("recover", Payload::with_scene(&request, Some(&scene)).unwrap()).await
    };
    let base = RigidTransform([1.0, 0.0, 0.0, 0.9, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    let mut across = Robot::new().state;
    (across.world_from_base, across.since_handling_ms) = (Some(base), Some(1_000));
    let told = running.session.cell().robot_state("across");
    let refused = loop {
        running.session.put(&told, Payload::json(&across).unwrap(), Traffic::RobotState).await.unwrap();
        // It is known as soon as its state has come.
        match home(10).await {
            Err(error) => break error,
            Ok(_) => tokio::time::sleep(Duration::from_millis(20)).await,
        }
    };
    assert!(refused.field.as_deref() == Some("scene") && refused.message.contains("robot across"), "{refused}");
    let commands = robot.lock().unwrap().state.last_command;
    let seen_before = MotionPlan { start_joints_rad: robot.lock().unwrap().state.q_rad, ..seen_before };
    let refused = refusal(running.call("execute", Payload::json(&seen_before).unwrap()).await);
    assert_eq!(refused, (ErrorCode::FailedPrecondition, Some("scene_stamp_ns".to_owned())));
    assert_eq!(robot.lock().unwrap().state.last_command, commands, "nothing was sent");
    assert!(home(1).await.is_ok());
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_cannot_make_its_scene_younger_than_it_is() {
    let running = Running::start().await;
    let robot = running.robot(Robot::new()).await;
    let scene = Scene { stamp_ns: now_ns() - 300_000_000_000, ..scene() };
    let answer = running.call("plan", bulk(&request(&scene), &scene)).await.unwrap();
    let honest = answer.payload.decode_json::<MotionPlan>().unwrap();
    for plan in [
        MotionPlan { max_scene_age_ms: u64::MAX, ..honest.clone() },
        MotionPlan { scene_stamp_ns: now_ns(), ..honest.clone() },
        MotionPlan { query: 77, ..honest },
    ] {
        let code = if plan.query == 77 { ErrorCode::NotFound } else { ErrorCode::FailedPrecondition };
        let field = if plan.query == 77 { "query" } else { "scene_stamp_ns" };
        // From where the stub of a robot stands, so that nothing else is wrong with it.
        let plan = MotionPlan { start_joints_rad: robot.lock().unwrap().state.q_rad, phases: common::plan().phases, ..plan };
        assert_eq!(refusal(running.call("execute", Payload::json(&plan).unwrap()).await), (code, Some(field.to_owned())));
    }
    assert_eq!(robot.lock().unwrap().state.last_command, None, "nothing was sent");
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_way_back_is_not_checked_against_what_stood_there_before() {
    let running = Running::start().await;
    let robot = running.robot(Robot::new()).await;
    let home = async |age_s: u64| {
        let scene = Scene { stamp_ns: NOW_NS - age_s * 1_000_000_000, ..scene() };
        let named = Some(SceneRef { scene_id: scene.id() });
        let request = RecoverRequest { robot: "panda".to_owned(), motion: RecoveryMove::Home, scene: named };
        running.call("recover", Payload::with_scene(&request, Some(&scene)).unwrap()).await
    };
    let stale = (ErrorCode::FailedPrecondition, Some("scene".to_owned()));
    assert_eq!(refusal(home(300).await), stale, "a camera that has stopped");
    robot.lock().unwrap().state.since_handling_ms = Some(1_000);
    assert_eq!(refusal(home(10).await), stale, "the hand has moved something since");
    assert_eq!(robot.lock().unwrap().state.last_command, None, "nothing was sent");
    assert!(home(1).await.is_ok());

    // What stood there long ago is held, and named; what is sent stands there now.
    let before = Scene { stamp_ns: NOW_NS - 300_000_000_000, ..scene() };
    running.call("plan", bulk(&request(&before), &before)).await.unwrap();
    let mut now = Scene { stamp_ns: NOW_NS, ..before.clone() };
    now.points[0][0] += 0.1;
    let named = Some(SceneRef { scene_id: before.id() });
    let request = RecoverRequest { robot: "panda".to_owned(), motion: RecoveryMove::Home, scene: named };
    let error = running.call("recover", Payload::with_scene(&request, Some(&now)).unwrap()).await.unwrap_err();
    assert_eq!((error.code, error.field.as_deref()), (ErrorCode::InvalidArgument, Some("scene.scene_id")), "{error}");
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_way_back_is_checked_against_a_scene_that_is_enclosed_and_not_named() {
    let running = Running::start().await;
    let robot = running.robot(Robot::new()).await;
    let home = async |scene: &Scene| {
        let request = RecoverRequest { robot: "panda".to_owned(), motion: RecoveryMove::Home, scene: None };
        running.call("recover", Payload::with_scene(&request, Some(scene)).unwrap()).await
    };
    let mut scene = Scene { stamp_ns: NOW_NS, ..scene() };
    scene.meta.world_frame = WorldFrame::SupportPlane;
    assert_eq!(refusal(home(&scene).await), (ErrorCode::FailedPrecondition, Some("scene".to_owned())), "it tells not where things are");
    assert_eq!(robot.lock().unwrap().state.last_command, None, "nothing was sent");
    scene.meta.world_frame = WorldFrame::Extrinsics;
    let reply: RecoverReply = home(&scene).await.unwrap().payload.decode_json().unwrap();
    assert_eq!(reply.checked_against, Some(scene.id()));
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_whose_states_cannot_be_read_is_no_fault_of_the_request() {
    let running = Running::start().await;
    let (session, key) = (running.session.clone(), running.session.cell().robot_state("panda"));
    let telling = tokio::spawn(async move {
        loop {
            let garbled = Payload::json(&RobotResetRequest::new("panda".to_owned())).unwrap();
            session.put(&key, garbled, Traffic::RobotState).await.unwrap();
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    });
    let execute = Payload::json(&MotionPlan { scene_stamp_ns: NOW_NS, max_scene_age_ms: 60_000, ..plan() }).unwrap();
    let error = running.call("execute", execute).await.unwrap_err();
    telling.abort();
    assert_eq!((error.code, error.field.as_deref()), (ErrorCode::Unavailable, Some("robot")), "{error}");
    assert!(error.message.contains("no state that can be read"), "{error}");
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_latched_stop_refuses_executions_until_it_is_reset() {
    let running = Running::start().await;
    let execute = || Payload::json(&MotionPlan { scene_stamp_ns: NOW_NS, max_scene_age_ms: 60_000, ..plan() }).unwrap();
    assert_eq!(refusal(running.call("execute", execute()).await).0, ErrorCode::Unavailable, "there is no robot yet");
    let mut stopped = Robot::new();
    stopped.state.mode = RobotMode::Stopped;
    stopped.state.stop = Some(StopState { kind: "estop".to_owned(), reason: "button".to_owned(), estop_id: Some("e1".to_owned()) });
    let robot = running.robot(stopped).await;
    assert_eq!(refusal(running.call("execute", execute()).await), (ErrorCode::FailedPrecondition, Some("robot".to_owned())));

    // Somebody saw another stop, and would clear that one.
    let seen = StopState { kind: "estop".to_owned(), reason: "another".to_owned(), estop_id: Some("e0".to_owned()) };
    let of_another = Payload::json(&RobotResetRequest { robot: "panda".to_owned(), stop: Some(seen) }).unwrap();
    assert_eq!(refusal(running.call("reset", of_another).await), (ErrorCode::FailedPrecondition, Some("robot".to_owned())));
    assert_eq!(robot.lock().unwrap().state.mode, RobotMode::Stopped, "it stays");

    let reset = || Payload::json(&RobotResetRequest::new("panda".to_owned())).unwrap();
    let reply = running.call("reset", reset()).await.unwrap();
    assert_eq!(reply.payload.decode_json::<RobotResetReply>().unwrap(), RobotResetReply { was_stopped: true });
    {
        let robot = robot.lock().unwrap();
        assert_eq!(robot.state.mode, RobotMode::Idle);
        assert_eq!(robot.cleared.as_ref().and_then(|stop| stop.estop_id.as_deref()), Some("e1"), "the stop that is cleared is named");
    }
    let reply = running.call("reset", reset()).await.unwrap();
    assert_eq!(reply.payload.decode_json::<RobotResetReply>().unwrap(), RobotResetReply { was_stopped: false });

    // A robot that does not say why it is stopped is set going, too.
    robot.lock().unwrap().state.mode = RobotMode::Stopped;
    let reply = running.call("reset", reset()).await.unwrap();
    assert_eq!(reply.payload.decode_json::<RobotResetReply>().unwrap(), RobotResetReply { was_stopped: true });
    assert_eq!(robot.lock().unwrap().state.mode, RobotMode::Idle);
    running.stop().await;
}

/// A perception that has one scene, and gives it when it may.
struct HeldScene {
    scene: Scene,
    /// Whether it was asked for any scene.
    is_found: AtomicBool,
    /// Tells that it was asked for the one that it has.
    is_wanted: Notify,
    /// A permit lets the scene go.
    may_go: Semaphore,
}

#[async_trait]
impl Handler for HeldScene {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        let request: SceneRequest = call.payload.decode_json()?;
        self.is_found.store(true, Ordering::Release);
        if request.scene_id != self.scene.id() {
            return Err(CallError::not_found("scene_id", "it is not here"));
        }
        self.is_wanted.notify_one();
        let _permit = self.may_go.acquire().await.unwrap();
        request.answer(&Payload::bulk(Scene::SCHEMA, &self.scene.to_bulk())?)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_moves_for_a_client_that_goes_while_its_motion_is_prepared() {
    let scene = Scene { stamp_ns: NOW_NS, ..scene() };
    let named = Some(SceneRef { scene_id: scene.id() });
    let back = RecoverRequest { robot: "panda".to_owned(), motion: RecoveryMove::Home, scene: named };
    let plan = MotionPlan { scene_id: scene.id(), scene_stamp_ns: NOW_NS, max_scene_age_ms: 60_000, ..plan() };
    for (method, payload) in [("recover", Payload::json(&back).unwrap()), ("execute", Payload::json(&plan).unwrap())] {
        let running = Running::start().await;
        let robot = running.robot(Robot::new()).await;
        let perception = Arc::new(HeldScene {
            scene: scene.clone(),
            is_found: AtomicBool::new(false),
            is_wanted: Notify::new(),
            may_go: Semaphore::new(0),
        });
        let perceiving = running.session.start(Service::Perception, perception.clone()).await.unwrap();
        // Once it asks perception for a scene, it has seen that there is one.
        let unknown = MotionPlanRequest::new("0".repeat(64), "panda".to_owned(), 1, vec![RigidTransform::IDENTITY], READY);
        while !perception.is_found.load(Ordering::Acquire) {
            assert_eq!(refusal(running.call("plan", Payload::json(&unknown).unwrap()).await).0, ErrorCode::NotFound);
        }
        let id = "0f6e0d6c-6a53-4a62-9a5e-3d2f6d1c7b20";
        let key = running.session.cell().live_client(id);
        let mut alive = running.session.watch_alive(&key).await.unwrap();
        let client = running.session.transport().declare_alive(&key).await.unwrap();
        while alive.current().is_empty() {
            assert!(alive.changed().await, "the network closed");
        }
        let options = CallOptions { id: Some(id.to_owned()), ..CallOptions::at_most_once(Duration::from_secs(30)) };
        let calling = running.caller.call(method, payload, options);
        let leaving = async {
            perception.is_wanted.notified().await;
            drop(client);
            while !alive.current().is_empty() {
                assert!(alive.changed().await, "the network closed");
            }
            perception.may_go.add_permits(1);
        };
        let (ended, ()) = tokio::join!(calling, leaving);
        let error = ended.unwrap_err();
        assert!(error.code == ErrorCode::FailedPrecondition && error.message.contains("client is gone"), "{method}: {error}");
        assert_eq!(robot.lock().unwrap().state.last_command, None, "{method}: nothing was sent");
        perceiving.drain().await;
        running.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_arm_that_is_to_rest_before_its_robot_has_told_a_state_is_not_commanded() {
    let running = Running::start().await;
    let link = RobotLink::new(running.session.clone(), &MotionConfig::default()).unwrap();
    let plan = MotionPlan { scene_stamp_ns: NOW_NS, max_scene_age_ms: 60_000, ..plan() };
    let (rest, to_rest) = oneshot::channel();
    let executing = link.execute(plan, task(), Box::pin(async { to_rest.await.unwrap() }), |_| {});
    let cancelled = CallError::new(ErrorCode::Cancelled, "the caller cancelled");
    let meanwhile = async {
        rest.send(cancelled.clone()).unwrap();
        running.robot(Robot::new()).await
    };
    let (ended, robot) = tokio::join!(executing, meanwhile);
    assert_eq!(ended.unwrap_err(), cancelled);
    assert_eq!(robot.lock().unwrap().state.last_command, None, "nothing was sent");
    running.stop().await;
}
