//! What agents are told, and what they may: every tool in a cell of a few lines.

mod cell;

use std::sync::atomic::Ordering;
use std::time::Duration;

use cell::agent::{Agent, error_of};
use cell::http::{HttpAgent, answered};
use cell::{Cell, WITHIN, asker, start, start_with};
use repose_mcp::McpSettings;
use repose_mcp::answer::ToolResult;
use repose_mcp::tools::{Tool, call};
use repose_proto::{CallError, ErrorCode};
use repose_runtime::CancellationToken;
use serde_json::{Value, json};

/// How long an execution may take to begin, and to be given up.
const SOON: Duration = Duration::from_secs(10);

async fn ask(cell: &Cell, tool: &str, arguments: Value) -> Result<ToolResult, CallError> {
    ask_as(cell, tool, arguments, "one").await
}

async fn ask_as(cell: &Cell, tool: &str, arguments: Value, session: &str) -> Result<ToolResult, CallError> {
    call(&cell.desk, tool, arguments, &asker(session), CancellationToken::new()).await
}

async fn planned(cell: &Cell) -> String {
    let answer = ask(cell, "plan", json!({"say": "put the red box left of the blue box"})).await.expect("an answer");
    answer.data["plan"].as_str().unwrap_or_else(|| panic!("no plan: {}", answer.text)).to_owned()
}

fn refused(answer: Result<ToolResult, CallError>) -> (ErrorCode, Option<String>, String) {
    let error = answer.expect_err("it must be refused");
    (error.code, error.field, error.message)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_look_tells_numbers_colors_sizes_and_relations_and_shows_them() {
    let cell = start(false).await;
    let looked = ask(&cell, "look", json!({})).await.expect("an answer");
    let objects = looked.data["objects"].as_array().expect("objects");
    assert_eq!(objects.iter().map(|o| o["color"].as_str()).collect::<Vec<_>>(), [Some("red"), Some("blue"), Some("green")]);
    assert_eq!(objects[0]["relations"]["right_of"], json!([2]), "{}", looked.text);
    assert!((objects[0]["size_cm"][2].as_f64().expect("a height") - 8.0).abs() < 0.5);
    assert!(looked.text.contains("object 1: red") && looked.text.contains("right of 2"), "{}", looked.text);
    assert!(looked.picture.is_some_and(|jpeg| jpeg.starts_with(&[0xff, 0xd8, 0xff])));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_view_that_looks_the_same_to_the_last_point_is_not_sent_again() {
    let cell = start(false).await;
    let seen = ask(&cell, "look", json!({})).await.expect("an answer").data;
    cell.world.holds_none.store(true, Ordering::SeqCst);
    let again = ask(&cell, "look", json!({})).await.expect("an answer").data;
    assert_eq!((&again["scene"], &again["objects"]), (&seen["scene"], &seen["objects"]));
    cell.world.push(1, [0.1, 0.0]);
    let (code, ..) = refused(ask(&cell, "look", json!({})).await);
    assert_eq!(code, ErrorCode::NotFound, "another view is");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_is_made_by_number_by_looks_or_in_a_sentence_and_none_says_why() {
    let cell = start(false).await;
    let looked = ask(&cell, "look", json!({})).await.expect("an answer");
    let scene = looked.data["scene"].clone();
    let by_number = json!({"scene": scene, "move": 1, "goal": [{"relation": "left_of", "to": 2}]});
    let by_looks = json!({"move": "the red box", "goal": [{"relation": "left_of", "to": "the blue box"}]});
    let said = json!({"say": "put the red box left of the blue box"});
    for arguments in [by_number.clone(), by_looks, said] {
        let answer = ask(&cell, "plan", arguments.clone()).await.expect("an answer");
        assert_eq!((&answer.data["move"], &answer.data["goal"]), (&json!(1), &json!(["left_of:2"])), "{arguments}");
        assert!(answer.data["plan"].is_string() && answer.picture.is_some(), "{}", answer.text);
        assert!(answer.text.contains("success 0.94") && answer.text.contains("holds by rule"), "{}", answer.text);
    }
    let field = |answer| refused(answer).1;
    for no_scene in [
        json!({"move": 1, "goal": [{"relation": "left_of", "to": 2}]}),
        json!({"move": "object 1", "goal": [{"relation": "left_of", "to": "the blue box"}]}),
        json!({"move": "the red box", "goal": [{"relation": "left_of", "to": "box #2"}]}),
        json!({"say": "put object 1 left of the blue box"}),
    ] {
        assert_eq!(field(ask(&cell, "plan", no_scene.clone()).await).as_deref(), Some("scene"), "numbers are of a scene: {no_scene}");
    }
    let numbers_said = json!({"scene": scene, "say": "put object 1 left of object 2"});
    let answer = ask(&cell, "plan", numbers_said).await.expect("an answer");
    assert_eq!((&answer.data["move"], &answer.data["goal"]), (&json!(1), &json!(["left_of:2"])));
    let unknown = json!({"scene": "0123456789ab", "move": 1, "goal": [{"relation": "left_of", "to": 2}]});
    assert_eq!(field(ask(&cell, "plan", unknown).await).as_deref(), Some("scene"));
    let absent = json!({"scene": scene, "move": 1, "goal": [{"relation": "left_of", "to": 9}]});
    assert_eq!(field(ask(&cell, "plan", absent).await).as_deref(), Some("goal[0].to"));
    let (code, at, message) = refused(ask(&cell, "plan", json!({"say": "put the box left of the blue box"})).await);
    assert_eq!((code, at.as_deref()), (ErrorCode::InvalidArgument, Some("say")));
    assert!(message.contains("object 1") && message.contains("object 3"), "the objects in question are named: {message}");
    assert_eq!(field(ask(&cell, "plan", json!({})).await).as_deref(), Some("move"));

    *cell.world.has_place.lock().expect("the answer") = false;
    let none = ask(&cell, "plan", by_number).await.expect("none is an answer");
    assert!(none.data["plan"].is_null() && none.picture.is_none());
    assert!(none.text.contains("out of reach 2") && none.text.contains("without not:near:3"), "{}", none.text);
}

#[tokio::test(flavor = "multi_thread")]
async fn all_objects_of_a_phrase_are_told_and_what_to_do_where_one_is_expected() {
    let cell = start(false).await;
    let said = json!({"say": "put the red box left of the blue box, away from the boxes"});
    let answer = ask(&cell, "plan", said).await.expect("an answer");
    assert_eq!(answer.data["goal"], json!(["left_of:2", "not:near:2", "not:near:3"]));
    assert_eq!(answer.data["understood"], json!({"the red box": [1], "the blue box": [2], "the boxes": [2, 3]}));
    assert!(
        answer.text.contains("\"the boxes\" are objects 2 and 3") && answer.text.contains("\"the red box\" is object 1"),
        "{}",
        answer.text
    );
    let to_several = json!({"move": "the red box", "goal": [{"relation": "near", "to": "the boxes", "not": true}]});
    let cases = [
        (to_several, "goal[0].to", "a term of its own"),
        (json!({"move": "the boxes", "goal": []}), "move", "a plan for each of them"),
        (json!({"say": "put the boxes left of the blue box"}), "say", "a plan for each of them"),
        (json!({"move": "the box", "goal": []}), "move", "or give its number"),
    ];
    for (arguments, field, way) in cases {
        let (code, at, message) = refused(ask(&cell, "plan", arguments).await);
        assert_eq!((code, at.as_deref()), (ErrorCode::InvalidArgument, Some(field)));
        assert!(message.contains("several objects") && message.contains(way), "{message}");
        assert!(message.contains("object 1") && message.contains("object 3"), "all are named: {message}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_carried_out_where_it_is_not_allowed_and_a_stop_always_is() {
    let cell = start(false).await;
    let plan = planned(&cell).await;
    let (code, _, message) = refused(ask(&cell, "execute", json!({"plan": plan})).await);
    assert_eq!(code, ErrorCode::FailedPrecondition);
    assert!(message.contains("--allow-execute"), "{message}");
    assert_eq!(cell.world.executions(), 0);
    let state = ask(&cell, "state", json!({})).await.expect("a state");
    assert_eq!((&state.data["mode"], &state.data["may_execute"]), (&json!("idle"), &json!(false)));
    let stopped = ask(&cell, "stop", json!({"reason": "a hand"})).await.expect("stopped");
    assert_eq!((&stopped.data["mode"], &stopped.data["stopped_because"]), (&json!("stopped"), &json!("a hand")));
    assert_eq!(cell.world.stop().map(|stop| stop.reason).as_deref(), Some("a hand"));
    assert_eq!(refused(ask(&cell, "drive", json!({})).await).1.as_deref(), Some("tool"));
    assert_eq!(refused(ask(&cell, "stop", json!({"robot": "other"})).await).0, ErrorCode::InvalidArgument, "no robot but this");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_whose_state_is_late_is_waited_for() {
    let cell = start(false).await;
    cell.world.is_mute.store(true, Ordering::SeqCst);
    let late = async {
        // As on a machine that has too much to do.
        tokio::time::sleep(Duration::from_secs(2)).await;
        cell.world.is_mute.store(false, Ordering::SeqCst);
    };
    let (told, ()) = tokio::join!(ask(&cell, "state", json!({})), late);
    assert_eq!(told.expect("a state").data["mode"], json!("idle"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_place_is_found_in_time_though_the_robot_tells_nothing() {
    let cell = start_with(McpSettings { deadline: Duration::from_secs(6), ..McpSettings::default() }).await;
    cell.world.is_mute.store(true, Ordering::SeqCst);
    let answer = ask(&cell, "plan", json!({"say": "put the red box left of the blue box"})).await.expect("an answer");
    assert!(answer.data["plan"].is_string() && answer.text.contains("the arm was not asked"), "{}", answer.text);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_of_this_session_is_carried_out_once_and_no_other_is() {
    let cell = start(true).await;
    let plan = planned(&cell).await;
    let not_found = |answer| refused(answer).0 == ErrorCode::NotFound;
    assert!(not_found(ask(&cell, "execute", json!({"plan": "made up"})).await));
    assert!(not_found(ask_as(&cell, "execute", json!({"plan": plan}), "another").await), "another session's");
    let elsewhere = start(true).await;
    assert!(not_found(ask(&elsewhere, "execute", json!({"plan": plan})).await), "another server's");
    assert_eq!(cell.world.executions() + elsewhere.world.executions(), 0);
    // The camera may number the objects anew meanwhile.
    cell.world.renumber(&[7, 8, 9]);
    cell.world.may_move.notify_one();
    let done = ask(&cell, "execute", json!({"plan": plan})).await.expect("an answer");
    assert_eq!(
        (&done.data["outcome"], &done.data["holds"], &done.data["fates"]),
        (&json!("done"), &json!([{"term": "left_of:2", "holds": true}]), &json!({})),
        "{}",
        done.text
    );
    assert!(done.picture.is_some() && done.text.contains("nothing else has moved or fallen"), "{}", done.text);
    assert!(not_found(ask(&cell, "execute", json!({"plan": plan})).await), "it was carried out already");
    assert_eq!(cell.world.executions(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn however_much_one_session_plans_another_keeps_its_plans_and_scenes() {
    let cell = start(true).await;
    let scene = ask(&cell, "look", json!({})).await.expect("an answer").data["scene"].clone();
    let plan = planned(&cell).await;
    let mut of_another = Vec::new();
    for _ in 0..33 {
        // Each on a scene of its own.
        cell.world.push(3, [0.001, 0.0]);
        let say = json!({"say": "put the red box left of the blue box"});
        let answer = ask_as(&cell, "plan", say, "another").await.expect("an answer");
        of_another.push(answer.data["plan"].clone());
    }
    assert!(of_another.iter().all(Value::is_string), "{of_another:?}");
    let (code, field, message) = refused(ask_as(&cell, "execute", json!({"plan": of_another[0]}), "another").await);
    assert_eq!((code, field.as_deref()), (ErrorCode::NotFound, Some("plan")));
    assert!(message.contains("no longer kept"), "it was made, and not carried out: {message}");

    cell.world.push(3, [-0.033, 0.0]);
    let by_number = json!({"scene": scene, "move": 1, "goal": [{"relation": "left_of", "to": 2}]});
    assert!(ask(&cell, "plan", by_number).await.expect("the scene is at hand").data["plan"].is_string());
    cell.world.may_move.notify_one();
    let done = ask(&cell, "execute", json!({"plan": plan})).await.expect("the plan is kept");
    assert_eq!((&done.data["outcome"], cell.world.executions()), (&json!("done"), 1), "{}", done.text);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_else_the_robot_has_moved_is_said() {
    let cell = start(true).await;
    let plan = planned(&cell).await;
    let executing = async { ask(&cell, "execute", json!({"plan": plan})).await.expect("an answer") };
    let meanwhile = async {
        cell.world.has_begun.notified().await;
        cell.world.push(3, [0.0, 0.07]);
        cell.world.may_move.notify_one();
    };
    let (done, ()) = tokio::join!(executing, meanwhile);
    assert_eq!(done.data["outcome"], "done");
    let fates = done.data["fates"].as_object().expect("fates");
    assert_eq!((fates.len(), &fates["3"]["fate"]), (1, &json!("moved")), "{}", done.text);
    assert!((fates["3"]["by_m"].as_f64().expect("how far") - 0.07).abs() < 0.01, "{}", done.text);
    assert!(done.text.contains("object 3 is 70 mm from where it was to be") && !done.text.contains("nothing else"), "{}", done.text);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scene_that_somebody_touched_is_not_acted_upon() {
    let cell = start(true).await;
    let plan = planned(&cell).await;
    cell.world.push(3, [0.0, 0.03]);
    let (code, field, message) = refused(ask(&cell, "execute", json!({"plan": plan})).await);
    assert_eq!((code, field.as_deref()), (ErrorCode::FailedPrecondition, Some("plan")));
    assert!(message.contains("object 3 has moved by 30 mm"), "{message}");
    assert_eq!(cell.world.executions(), 0);
    // What is put back is as it was: the plan still stands.
    cell.world.push(3, [0.0, -0.03]);
    cell.world.may_move.notify_one();
    assert_eq!(ask(&cell, "execute", json!({"plan": plan})).await.expect("an answer").data["outcome"], "done");
}

#[tokio::test(flavor = "multi_thread")]
async fn while_a_plan_is_carried_out_no_other_is_and_everybody_may_stop() {
    let cell = start(true).await;
    let (first, second) = (planned(&cell).await, planned(&cell).await);
    let executing = async { ask(&cell, "execute", json!({"plan": first})).await.expect("an answer") };
    let meanwhile = async {
        cell.world.has_begun.notified().await;
        let state = ask(&cell, "state", json!({})).await.expect("a state");
        assert_eq!(state.data["carrying_out"], true);
        let (code, _, message) = refused(ask(&cell, "execute", json!({"plan": second})).await);
        assert!(code == ErrorCode::FailedPrecondition && message.contains("being carried out"), "{message}");
        let stopped = ask_as(&cell, "stop", json!({}), "another").await.expect("stopped");
        assert_eq!(stopped.data["mode"], "stopped");
        cell.world.may_move.notify_one();
    };
    let (ended, ()) = tokio::join!(executing, meanwhile);
    assert_eq!((&ended.data["outcome"], &ended.data["reason"]), (&json!("stopped"), &json!("stopped by an agent")), "{}", ended.text);
    // Only a person lets it go on.
    let (code, field, message) = refused(ask(&cell, "execute", json!({"plan": second})).await);
    assert_eq!((code, field.as_deref()), (ErrorCode::FailedPrecondition, Some("robot")));
    assert!(message.contains("stopped by an agent"), "{message}");
    assert_eq!(cell.world.executions(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_execution_that_is_given_up_while_it_is_prepared_moves_nothing_and_leaves_the_plan() {
    let cell = start(true).await;
    let plan = json!({"plan": planned(&cell).await});
    let given_up = CancellationToken::new();
    given_up.cancel();
    let (code, ..) = refused(call(&cell.desk, "execute", plan.clone(), &asker("one"), given_up).await);
    assert_eq!((code, cell.world.executions()), (ErrorCode::Cancelled, 0));
    cell.world.may_move.notify_one();
    let ended = ask(&cell, "execute", plan).await.expect("the plan is still there");
    assert_eq!((&ended.data["outcome"], cell.world.executions()), (&json!("done"), 1), "{}", ended.text);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_that_is_given_up_while_its_scene_is_fetched_ends_at_once() {
    let cell = start(false).await;
    cell.world.takes_ms.store(60_000, Ordering::SeqCst);
    let given_up = CancellationToken::new();
    let say = json!({"say": "put the red box left of the blue box"});
    let asker = asker("one");
    let both = async {
        tokio::join!(call(&cell.desk, "plan", say, &asker, given_up.clone()), async {
            tokio::time::sleep(Duration::from_millis(100)).await;
            given_up.cancel();
        })
    };
    let (ended, ()) = tokio::time::timeout(Duration::from_secs(20), both).await.expect("it does not wait for what nobody wants");
    assert_eq!(refused(ended).0, ErrorCode::Cancelled);
}

#[tokio::test(flavor = "multi_thread")]
async fn all_that_prepares_an_execution_is_within_one_deadline() {
    let cell = start_with(McpSettings { allow_execute: true, deadline: Duration::from_secs(2), ..McpSettings::default() }).await;
    let plan = json!({"plan": planned(&cell).await});
    // A view and the arm's way, each of which alone is in time.
    cell.world.takes_ms.store(1200, Ordering::SeqCst);
    let (code, ..) = refused(ask(&cell, "execute", plan).await);
    assert_eq!((code, cell.world.executions()), (ErrorCode::DeadlineExceeded, 0));
}

/// An agent over HTTP, and what it calls a plan.
async fn http_agent_with_a_plan(cell: &Cell) -> (HttpAgent, Value) {
    let mut agent = HttpAgent::connect(cell.desk.clone(), WITHIN).await;
    let planned = agent.answer("plan", json!({"say": "put the red box left of the blue box"})).await;
    let plan = &planned["structuredContent"]["plan"];
    assert!(plan.is_string(), "there is a plan: {planned}");
    (agent, json!({"plan": plan}))
}

/// Waits until an execution has begun.
async fn begun(cell: &Cell) {
    tokio::time::timeout(SOON, cell.world.has_begun.notified()).await.expect("it has begun");
}

/// Waits until an execution was given up.
async fn came_to_rest(cell: &Cell) {
    tokio::time::timeout(SOON, cell.world.was_cancelled.notified()).await.expect("it goes on for nobody");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_arm_comes_to_rest_when_the_connection_of_the_agent_that_moves_it_is_lost() {
    let cell = start(true).await;
    let (mut agent, plan) = http_agent_with_a_plan(&cell).await;
    let waiting = agent.ask("execute", plan).await;
    begun(&cell).await;
    drop(waiting);
    came_to_rest(&cell).await;
    agent.shutdown.trigger();
    agent.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_has_a_plan_carried_out_over_http_reads_how_it_ended_before_the_server_ends() {
    let cell = start(true).await;
    let (mut agent, plan) = http_agent_with_a_plan(&cell).await;
    let waiting = agent.ask("execute", plan).await;
    begun(&cell).await;
    agent.shutdown.trigger();
    let state = agent.answer("state", json!({})).await;
    assert_eq!(state["structuredContent"]["carrying_out"], true, "whoever looks on is told so: {state}");
    cell.world.may_move.notify_one();
    let (_, ended) = answered(waiting).await;
    assert_eq!(ended["structuredContent"]["outcome"], "done", "{ended}");
    agent.end().await;
    assert_eq!(cell.world.executions(), 1);
}

/// An agent on standard input and output, and what it calls a plan.
async fn agent_with_a_plan(cell: &Cell) -> (Agent, Value) {
    agent_of_a_draining_server(cell, WITHIN).await
}

/// The same of a server that waits so long for what it has begun, when it is to end.
async fn agent_of_a_draining_server(cell: &Cell, drain: Duration) -> (Agent, Value) {
    let mut agent = Agent::connect(cell.desk.clone(), drain).await;
    agent.ask("plan", json!({"say": "put the red box left of the blue box"})).await;
    let plan = agent.answer().await["structuredContent"]["plan"].take();
    assert!(plan.is_string(), "there is a plan");
    (agent, json!({"plan": plan}))
}

#[tokio::test(flavor = "multi_thread")]
async fn an_arm_comes_to_rest_when_the_input_of_the_agent_that_moves_it_ends() {
    let cell = start(true).await;
    let (mut agent, plan) = agent_with_a_plan(&cell).await;
    agent.ask("execute", plan).await;
    begun(&cell).await;
    agent.close_input().await;
    // It reads on: of what the kit cuts off by itself, seconds later, there is no answer.
    assert_eq!(error_of(&agent.answer().await).code, ErrorCode::Cancelled);
    came_to_rest(&cell).await;
    agent.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_is_to_end_brings_the_plan_under_way_to_its_end_and_tells_the_agent_how_it_ended() {
    let cell = start(true).await;
    let (mut agent, plan) = agent_with_a_plan(&cell).await;
    agent.ask("execute", plan).await;
    begun(&cell).await;
    agent.shutdown.trigger();
    agent.ask("state", json!({})).await;
    let state = agent.answer().await;
    assert_eq!(state["structuredContent"]["carrying_out"], true, "it is still served: {state}");
    cell.world.may_move.notify_one();
    let ended = agent.answer().await;
    assert_eq!(ended["structuredContent"]["outcome"], "done", "{ended}");
    agent.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_may_not_wait_has_the_arm_come_to_rest_and_says_that_it_has_ended() {
    let cell = start(true).await;
    let (mut agent, plan) = agent_of_a_draining_server(&cell, Duration::ZERO).await;
    agent.ask("execute", plan).await;
    begun(&cell).await;
    agent.shutdown.trigger();
    let error = error_of(&agent.answer().await);
    assert!(error.code == ErrorCode::Unavailable && error.message.contains("look at the robot"), "{error}");
    came_to_rest(&cell).await;
    agent.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_begins_to_move_for_a_server_that_is_ending() {
    let cell = start(true).await;
    let plan = json!({"plan": planned(&cell).await});
    // The next view is a minute away: the first is given up while it is prepared.
    cell.world.takes_ms.store(60_000, Ordering::SeqCst);
    let (prepared, ()) = tokio::join!(ask(&cell, "execute", plan.clone()), cell.desk.end(WITHIN));
    for refusal in [prepared, ask(&cell, "execute", plan).await] {
        assert_eq!(refused(refusal).0, ErrorCode::Unavailable);
    }
    assert_eq!(cell.world.executions(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_moves_when_the_input_of_an_agent_ends_while_that_is_prepared() {
    let cell = start(true).await;
    let (mut agent, plan) = agent_with_a_plan(&cell).await;
    // The next view is a minute away.
    cell.world.takes_ms.store(60_000, Ordering::SeqCst);
    agent.ask("execute", plan).await;
    agent.close_input().await;
    assert_eq!(error_of(&agent.answer().await).code, ErrorCode::Cancelled);
    agent.end().await;
    assert_eq!(cell.world.executions(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_agent_whose_input_has_ended_is_still_told_what_there_is() {
    let cell = start(false).await;
    let mut agent = Agent::connect(cell.desk.clone(), WITHIN).await;
    agent.ask("look", json!({})).await;
    agent.close_input().await;
    assert_eq!(agent.answer().await["structuredContent"]["objects"].as_array().map(Vec::len), Some(3));
    agent.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refusal_of_any_tool_says_its_code_and_field_in_a_text_and_has_no_structured_content() {
    let cell = start(true).await;
    let mut agent = Agent::connect(cell.desk.clone(), WITHIN).await;
    for tool in Tool::ALL {
        agent.ask(tool.name(), json!({"joints": [0.0]})).await;
        let refusal = agent.answer().await;
        let error = error_of(&refusal);
        assert_eq!((error.code, error.field.as_deref()), (ErrorCode::InvalidArgument, Some("joints")), "{}", tool.name());
        assert!(refusal.get("structuredContent").is_none_or(Value::is_null), "{}: {refusal}", tool.name());
    }
    agent.close_input().await;
    agent.end().await;
}
