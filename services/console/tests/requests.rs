//! What a viewer asks while something else goes on: another cell chosen meanwhile, a sequence or a console that is to end, an arm that nobody sees.

mod serving;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures::StreamExt;
use repose_console::ConsoleConfig;
use repose_made_scenes::SceneBuilder;
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlan, MotionPlanRequest, Phase, RecoverReply, RecoverRequest};
use repose_proto::scene::WorldFrame;
use repose_proto::{CallError, Frame, Payload, PlaceRequest, PlaceResult, Scene, Service};
use repose_runtime::{Call, Handler, Server, Session, Traffic, now_ns};
use serde_json::{Value, json};
use serving::{Running, Socket, WITHIN, ask, heard, robot, socket, start, start_draining};
use tokio::sync::Notify;
use tokio_tungstenite::tungstenite::Message;

/// A cell of a few lines: what its camera sees, and what its services were asked.
#[derive(Default)]
struct World {
    seen: Mutex<Option<Scene>>,
    asked: Mutex<Vec<(String, Value)>>,
    /// Whether the planner finds a place.
    has_places: AtomicBool,
    /// Tells that the planner or motion has been asked for a place, a plan or its execution, which waits for [`World::may_answer`].
    has_begun: Notify,
    may_answer: Notify,
}

impl World {
    /// The cameras that scenes were asked of.
    fn cameras(&self) -> Vec<Value> {
        let asked = self.asked.lock().expect("what was asked");
        asked.iter().filter(|(method, _)| method == "latest").map(|(_, request)| request["camera"].clone()).collect()
    }

    fn times(&self, method: &str) -> usize {
        self.asked.lock().expect("what was asked").iter().filter(|(asked, _)| asked == method).count()
    }

    fn sees(&self, frame: WorldFrame) -> String {
        let mut scene = SceneBuilder::table().object(1, [0.5, 0.0], [0.05; 3]).object(2, [0.5, 0.2], [0.05; 3]).scene();
        scene.meta.world_frame = frame;
        let id = scene.id();
        *self.seen.lock().expect("the scene") = Some(scene);
        id
    }

    /// The scene as it is now.
    fn scene(&self) -> Result<Scene, CallError> {
        let seen = self.seen.lock().expect("the scene").clone();
        let scene = seen.ok_or_else(|| CallError::not_found("camera", "nothing is seen"))?;
        Ok(Scene { stamp_ns: now_ns(), ..scene })
    }

    async fn waited(&self) {
        self.has_begun.notify_one();
        self.may_answer.notified().await;
    }
}

struct Worker(Arc<World>);

#[async_trait::async_trait]
impl Handler for Worker {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        let request = serde_json::from_slice(&call.payload.bytes).unwrap_or(Value::Null);
        self.0.asked.lock().expect("what was asked").push((call.method.clone(), request));
        match call.method.as_str() {
            "latest" => {
                let scene = self.0.scene()?;
                Payload::json(&scene.summary(scene.id()))
            }
            "scene" => Payload::bulk(Scene::SCHEMA, &self.0.scene()?.to_bulk()),
            "place" => {
                let request: PlaceRequest = call.payload.decode_json()?;
                self.0.waited().await;
                let result: PlaceResult =
                    serde_json::from_str(include_str!("../../../proto/tests/golden/PlaceResult.v1.third.json")).expect("a result");
                let placements = if self.0.has_places.load(Ordering::Relaxed) { result.placements.clone() } else { Vec::new() };
                Payload::json(&PlaceResult { placements, query: request.query, goal: request.goal, ..result })
            }
            "plan" => {
                let request: MotionPlanRequest = call.payload.decode_json()?;
                self.0.waited().await;
                let plan: MotionPlan =
                    serde_json::from_str(include_str!("../../../proto/tests/golden/MotionPlan.v1.json")).expect("a plan");
                let (scene_id, robot) = (request.scene.scene_id, request.robot);
                Payload::json(&MotionPlan { scene_id, robot, query: request.query, placement: 0, not_chosen: Vec::new(), ..plan })
            }
            "execute" => {
                self.0.waited().await;
                let (outcome, phase, joints_rad) = (ExecutionOutcome::Done, Phase::Home, repose_panda::READY);
                Payload::json(&ExecuteReply { outcome, phase, reason: None, joints_rad })
            }
            "recover" => {
                let checked_against = call.payload.decode_json::<RecoverRequest>()?.scene.map(|named| named.scene_id);
                let (outcome, joints_rad) = (ExecutionOutcome::Done, repose_panda::READY);
                Payload::json(&RecoverReply { outcome, reason: None, retreated_m: None, checked_against, joints_rad })
            }
            _ => Err(call.unknown_method()),
        }
    }
}

/// The services of a cell, until this is dropped.
async fn serve(session: &Session) -> (Arc<World>, Vec<Server>) {
    let (world, mut servers) = (Arc::new(World::default()), Vec::new());
    for service in [Service::Perception, Service::Planner, Service::Motion] {
        servers.push(session.start(service, Arc::new(Worker(world.clone()))).await.expect("a worker"));
    }
    (world, servers)
}

/// A console on a cell whose services and robot are there, for as long as the first is kept; the cell; a viewer.
async fn working_cell() -> ((Running, Vec<Server>), Arc<World>, Socket) {
    working_cell_draining(WITHIN).await
}

/// The same with a console that waits so long for moves, when it is to end.
async fn working_cell_draining(drain: Duration) -> ((Running, Vec<Server>), Arc<World>, Socket) {
    let console = start_draining(ConsoleConfig::default(), drain).await;
    let (world, servers) = serve(&console.session).await;
    robot(&console.session).await;
    let viewer = socket(console.address, &[]).await.expect("a socket");
    ((console, servers), world, viewer)
}

/// Asks, and waits for the answer or the refusal.
async fn answered(viewer: &mut Socket, request: Value) -> Value {
    let id = request["id"].clone();
    ask(viewer, request).await;
    heard(viewer, |m| m["id"] == id && (m["kind"] == "answer" || m["kind"] == "refused")).await
}

async fn begun(world: &World) {
    tokio::time::timeout(WITHIN, world.has_begun.notified()).await.expect("begun in time");
}

/// Watches the cell, and asks as number 2 for the motion to a place; once motion has begun with it, the scene that it is of.
async fn plan_that_has_begun(world: &World, viewer: &mut Socket) -> String {
    let scene_id = world.sees(WorldFrame::Extrinsics);
    ask(viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    heard(viewer, |m| m["kind"] == "robot").await;
    let placements = [[1., 0., 0., 0.1, 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.]];
    ask(viewer, json!({"id": 2, "ask": "plan", "scene_id": scene_id, "robot": "panda", "query": 1, "placements": placements})).await;
    begun(world).await;
    scene_id
}

/// A request for a sequence of two goals.
fn sequence(id: u64, scene_id: &str) -> Value {
    let terms = json!([{"relation": "left_of", "anchor": 2, "holds": true}]);
    let goal = json!({"scene": {"scene_id": scene_id}, "query": 1, "goal": terms});
    json!({"id": id, "ask": "sequence", "scene_id": scene_id, "robot": "panda", "goals": [goal, goal]})
}

/// Begins a sequence, whose first motion is under way then; the scene that its goals are about.
async fn sequence_that_moves(world: &World, viewer: &mut Socket) -> String {
    world.has_places.store(true, Ordering::Relaxed);
    let scene_id = world.sees(WorldFrame::Extrinsics);
    answered(viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    heard(viewer, |m| m["kind"] == "robot").await;
    assert_eq!(answered(viewer, sequence(2, &scene_id)).await["kind"], "answer");
    for _place_then_plan in 0..2 {
        begun(world).await;
        world.may_answer.notify_one();
    }
    begun(world).await;
    assert_eq!(world.times("execute"), 1);
    scene_id
}

/// Until the console has closed a socket with a word; all that was told before.
async fn last_words(viewer: &mut Socket) -> Vec<Value> {
    let mut told = Vec::new();
    let hearing = async {
        while let Some(Ok(message)) = viewer.next().await {
            match message {
                Message::Text(text) => told.push(serde_json::from_str(&text).expect("JSON")),
                Message::Close(word) => return word.is_some_and(|word| word.reason.contains("ending")),
                _ => {}
            }
        }
        false
    };
    assert!(tokio::time::timeout(WITHIN, hearing).await.expect("heard in time"), "it is closed with a word");
    told
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cell_that_was_chosen_and_left_again_leaves_its_camera_to_nobody() {
    let console = start(ConsoleConfig::default()).await;
    let (world, _servers) = serve(&console.session).await;
    let far = console.session.in_cell("far").expect("a cell");
    let mut viewer = socket(console.address, &[]).await.expect("a socket");
    // The far cell has no camera yet: the request waits for one while another overtakes it.
    ask(&mut viewer, json!({"id": 1, "ask": "watch", "cell": "far", "camera": null})).await;
    heard(&mut viewer, |m| m["kind"] == "system" && m["cell"] == "far").await;
    assert_eq!(answered(&mut viewer, json!({"id": 2, "ask": "watch", "cell": "cell", "camera": "front"})).await["kind"], "answer");
    let scenes = far.publisher(far.cell().scene("top"), Traffic::Scene);
    let telling = tokio::spawn(async move {
        let mut tick = tokio::time::interval(Duration::from_millis(10));
        loop {
            tick.tick().await;
            scenes.put(Payload { encoding: String::new(), bytes: Vec::new().into() }).await.expect("put");
        }
    });
    let first = heard(&mut viewer, |m| m["id"] == 1).await;
    telling.abort();
    assert_eq!((&first["kind"], &first["error"]["code"]), (&json!("refused"), &json!("cancelled")), "{first}");
    // The camera that the arm's way is checked by is the watched cell's.
    answered(&mut viewer, json!({"id": 3, "ask": "recover", "robot": "panda", "move": "home"})).await;
    let cameras = world.cameras();
    assert!(!cameras.is_empty() && cameras.iter().all(|camera| camera == "front"), "{cameras:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_that_comes_when_another_cell_is_watched_is_not_to_be_carried_out() {
    let (_console, world, mut viewer) = working_cell().await;
    let scene_id = plan_that_has_begun(&world, &mut viewer).await;
    ask(&mut viewer, json!({"id": 3, "ask": "watch", "cell": "far", "camera": "top"})).await;
    assert_eq!(heard(&mut viewer, |m| m["kind"] == "watching" && m["cell"] == "far").await["cell"], "far");
    world.may_answer.notify_one();
    let planned = heard(&mut viewer, |m| m["id"] == 2).await;
    assert_eq!((&planned["kind"], &planned["error"]["field"]), (&json!("refused"), &json!("cell")), "{planned}");
    // What was seen in the one cell is not to be planned on in the other.
    let held = answered(&mut viewer, json!({"id": 4, "ask": "hold", "scene_id": scene_id})).await;
    assert_eq!(held["error"]["code"], "not_found", "{held}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_is_shown_no_more_when_whoever_made_it_looks_at_another_cell() {
    let ((console, _servers), world, mut planner) = working_cell().await;
    let scene_id = world.sees(WorldFrame::Extrinsics);
    let mut other = socket(console.address, &[]).await.expect("a socket");
    for viewer in [&mut planner, &mut other] {
        ask(viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
        heard(viewer, |m| m["kind"] == "robot").await;
    }
    let placements = [[1., 0., 0., 0.1, 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.]];
    let plan = json!({"id": 2, "ask": "plan", "scene_id": scene_id, "robot": "panda", "query": 1, "placements": placements});
    world.may_answer.notify_one();
    let planned = answered(&mut planner, plan).await;
    let id = &planned["result"]["plan"];
    assert!(id.is_string(), "{planned}");
    heard(&mut other, |m| m["kind"] == "plan" && m["shown"]["plan"] == *id).await;
    // Whose it is not cannot take it away.
    answered(&mut other, json!({"id": 2, "ask": "discard", "plan": id})).await;
    let mut late = socket(console.address, &[]).await.expect("a socket");
    ask(&mut late, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    let shown = heard(&mut late, |m| m["kind"] == "plan").await;
    assert_eq!(shown["shown"]["plan"], *id);
    // The same cell's other camera is no other cell: the plan is still at hand there.
    answered(&mut planner, json!({"id": 3, "ask": "watch", "cell": "cell", "camera": "side"})).await;
    answered(&mut planner, json!({"id": 4, "ask": "watch", "cell": "far", "camera": "top"})).await;
    heard(&mut other, |m| m["kind"] == "plan" && m["shown"].is_null()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_picture_that_a_page_held_before_its_connection_was_lost_is_held_again_while_perception_has_it() {
    let (_console, world, mut viewer) = working_cell().await;
    answered(&mut viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    while world.times("latest") == 0 {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    // Nobody was sent it over this connection.
    let scene_id = world.sees(WorldFrame::Extrinsics);
    let held = answered(&mut viewer, json!({"id": 2, "ask": "hold", "scene_id": scene_id})).await;
    assert_eq!(held["kind"], "answer", "{held}");
}

#[tokio::test(flavor = "multi_thread")]
async fn where_nothing_moves_a_scene_that_came_before_its_frame_gets_it_from_a_later_one() {
    let ((console, _servers), world, mut viewer) = working_cell().await;
    let scene_id = world.sees(WorldFrame::Extrinsics);
    answered(&mut viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    let cell = console.session.cell();
    let frames = console.session.publisher(cell.camera_frame("front"), Traffic::Frame);
    let summaries = console.session.publisher(cell.scene("front"), Traffic::Scene);
    for id in 2.. {
        // The same scene, seen again.
        let scene = world.scene().expect("a scene");
        let camera = scene.meta.camera.clone();
        let frame = Frame::new("front".to_owned(), scene.stamp_ns, camera.clone(), vec![1000; camera.width * camera.height]);
        frames.put(Payload::bulk(Frame::SCHEMA, &frame.to_bulk()).expect("encoded")).await.expect("put");
        tokio::time::sleep(Duration::from_millis(300)).await;
        summaries.put(Payload::json(&scene.summary(scene_id.clone())).expect("encoded")).await.expect("put");
        tokio::time::sleep(Duration::from_millis(600)).await;
        let refused = answered(&mut viewer, json!({"id": id, "ask": "segment", "scene_id": scene_id, "pixel": [0, 0]})).await;
        let why = refused["error"]["message"].as_str().expect("a reason");
        if !why.contains("no longer at hand") {
            assert!(world.times("segment") > 0, "perception is asked: {refused}");
            // All parts of a scene are asked for at once, before anybody knows how few there are.
            return assert!(world.times("scene") <= 16, "the scene was at hand");
        }
        assert!(id < 20, "{refused}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sequence_that_is_to_end_keeps_its_cell_until_it_has() {
    let (_console, world, mut viewer) = working_cell().await;
    let scene_id = world.sees(WorldFrame::Extrinsics);
    answered(&mut viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    let sequence = |id: u64| sequence(id, &scene_id);
    let first = answered(&mut viewer, sequence(2)).await;
    assert_eq!(first["kind"], "answer", "{first}");
    begun(&world).await;
    ask(&mut viewer, json!({"id": 3, "ask": "end_sequence"})).await;
    let ending = heard(&mut viewer, |m| m["kind"] == "activity" && m["sequence"]["ending"] == true).await;
    assert_eq!(ending["sequence"]["ended"], false, "its goal is still at hand: {ending}");
    let second = answered(&mut viewer, sequence(4)).await;
    assert_eq!((&second["kind"], &second["error"]["code"]), (&json!("refused"), &json!("failed_precondition")), "{second}");
    world.may_answer.notify_one();
    heard(&mut viewer, |m| m["kind"] == "activity" && m["sequence"]["ended"] == true).await;
    assert_eq!(world.times("place"), 1, "the goal after the one that it was to end at was not asked for");
    assert_eq!(answered(&mut viewer, sequence(5)).await["kind"], "answer");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_console_that_is_to_end_brings_the_move_under_way_to_its_end_and_begins_no_other() {
    let ((mut console, _servers), world, mut viewer) = working_cell().await;
    let scene_id = sequence_that_moves(&world, &mut viewer).await;
    console.shutdown.trigger();
    let ending = heard(&mut viewer, |m| m["kind"] == "activity" && m["sequence"]["ending"] == true).await;
    assert_eq!(ending["sequence"]["ended"], false, "{ending}");
    let recover = json!({"id": 3, "ask": "recover", "robot": "panda", "move": "open"});
    for another in [recover, sequence(4, &scene_id)] {
        let refused = answered(&mut viewer, another).await;
        assert_eq!(refused["error"]["code"], "unavailable", "{refused}");
    }
    assert!(!console.serving.is_finished(), "the robot is on its way");
    world.may_answer.notify_one();
    let told = last_words(&mut viewer).await;
    let activity = told.iter().rfind(|m| m["kind"] == "activity").expect("how it has ended");
    assert_eq!(activity["execution"]["ended"]["outcome"]["outcome"], "done", "{activity}");
    let sequence = &activity["sequence"];
    assert_eq!((&sequence["ended"], &sequence["steps"][1]["stage"]), (&json!(true), &json!("waiting")), "{activity}");
    console.ended().await;
    assert_eq!((world.times("place"), world.times("execute"), world.times("recover")), (1, 1, 0), "nothing was begun");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_console_that_may_not_wait_says_on_its_pages_what_it_leaves_undone() {
    let ((mut console, _servers), world, mut viewer) = working_cell_draining(Duration::ZERO).await;
    sequence_that_moves(&world, &mut viewer).await;
    console.shutdown.trigger();
    let told = last_words(&mut viewer).await;
    let activity = told.iter().rfind(|m| m["kind"] == "activity").expect("how it has ended");
    let (execution, sequence) = (&activity["execution"]["ended"]["error"], &activity["sequence"]);
    assert_eq!((&execution["code"], &sequence["ended"]), (&json!("unavailable"), &json!(true)), "{activity}");
    let [first, second] = [0, 1].map(|k: usize| &sequence["steps"][k]);
    assert_eq!((&first["stage"], &first["error"], &second["stage"]), (&json!("failed"), execution, &json!("waiting")), "{activity}");
    console.ended().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_asked_for_a_motion_has_its_answer_before_the_console_ends() {
    let ((mut console, _servers), world, mut viewer) = working_cell().await;
    plan_that_has_begun(&world, &mut viewer).await;
    world.may_answer.notify_one();
    let planned = heard(&mut viewer, |m| m["id"] == 2).await;
    ask(&mut viewer, json!({"id": 3, "ask": "execute", "plan": planned["result"]["plan"]})).await;
    begun(&world).await;
    console.shutdown.trigger();
    world.may_answer.notify_one();
    let told = last_words(&mut viewer).await;
    let answer = told.iter().find(|m| m["id"] == 3).expect("an answer");
    assert_eq!((&answer["kind"], &answer["result"]["outcome"]), (&json!("answer"), &json!("done")), "{answer}");
    console.ended().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_arm_goes_back_unseen_only_where_that_is_asked_for_and_what_it_was_checked_against_is_said() {
    let console = start(ConsoleConfig::default()).await;
    let (world, _servers) = serve(&console.session).await;
    let mut viewer = socket(console.address, &[]).await.expect("a socket");
    answered(&mut viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    let recover = |id: u64, motion: &str| json!({"id": id, "ask": "recover", "robot": "panda", "move": motion});

    let unseen = answered(&mut viewer, recover(2, "home")).await;
    assert_eq!((&unseen["error"]["code"], &unseen["error"]["field"]), (&json!("failed_precondition"), &json!("unchecked")), "{unseen}");
    assert!(unseen["error"]["message"].as_str().is_some_and(|why| why.contains("nothing is seen")), "{unseen}");
    world.sees(WorldFrame::SupportPlane);
    let uncalibrated = answered(&mut viewer, recover(3, "retreat")).await;
    assert_eq!(uncalibrated["error"]["field"], "unchecked", "{uncalibrated}");
    assert!(uncalibrated["error"]["message"].as_str().is_some_and(|why| why.contains("where it stands")), "{uncalibrated}");
    assert_eq!(world.times("recover"), 0, "nothing has moved");

    assert_eq!(answered(&mut viewer, recover(4, "open")).await["result"]["outcome"], "done", "opening the hand moves no arm");
    let asked = json!({"id": 5, "ask": "recover", "robot": "panda", "move": "home", "unchecked": true});
    let unchecked = answered(&mut viewer, asked).await;
    assert_eq!((&unchecked["result"]["outcome"], &unchecked["result"]["checked_against"]), (&json!("done"), &Value::Null), "{unchecked}");
    let scene_id = world.sees(WorldFrame::Extrinsics);
    let checked = answered(&mut viewer, recover(6, "home")).await;
    assert_eq!((&checked["result"]["checked_against"], &checked["result"]["camera"]), (&json!(scene_id), &json!("front")), "{checked}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_that_has_as_many_requests_open_as_may_be_can_give_one_up() {
    let (_console, world, mut viewer) = working_cell().await;
    let scene_id = world.sees(WorldFrame::Extrinsics);
    answered(&mut viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    let goal = json!([{"relation": "left_of", "anchor": 2, "holds": true}]);
    let place = |id: u64| json!({"id": id, "ask": "place", "request": {"scene": {"scene_id": scene_id}, "query": 1, "goal": goal}});
    for id in 10..26 {
        ask(&mut viewer, place(id)).await;
    }
    let refused = answered(&mut viewer, place(26)).await;
    assert_eq!(refused["error"]["code"], "resource_exhausted", "{refused}");
    ask(&mut viewer, json!({"id": 30, "ask": "cancel", "request": 10})).await;
    // Either may be told first.
    for _ in 0..2 {
        let told = heard(&mut viewer, |m| (m["id"] == 10 || m["id"] == 30) && m["kind"] != "progress").await;
        match told["id"] == 30 {
            true => assert_eq!(told["kind"], "answer", "{told}"),
            false => assert_eq!(told["error"]["code"], "cancelled", "{told}"),
        }
    }
}
