//! Arrangements in a cell whose course is written down.

use std::collections::VecDeque;
use std::sync::Mutex;

use repose_proto::{Relation, RigidTransform};
use repose_runtime::Session;

use super::*;
use crate::scripted::{Script, ScriptedCell, term, view};

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

/// What comes of goals in a cell, each object tried three times at most; and which objects were moved.
async fn brought_about(script: Script, goals: Vec<ObjectGoal>) -> (ArrangementReport, Vec<u16>) {
    let session = Session::embedded().await.expect("a session");
    let (site, servers) = ScriptedCell::of(&session, script).await;
    let script = site.script.clone();
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

#[tokio::test(flavor = "multi_thread")]
async fn a_planner_that_is_too_busy_for_other_places_does_not_end_what_is_planned() {
    let beside = (1, [0.7, 0.0, 0.0], term(Relation::RightOf, 2));
    let script = Script {
        views: Mutex::new([view(&[(1, [-0.4, 0.0]), (2, [-0.1, 0.0])]), view(&[(1, [0.3, 0.0]), (2, [-0.1, 0.0])])].into()),
        plans: Mutex::new([plan(Found::Found, &[beside]), plan(Found::Found, &[])].into()),
        outcomes: Mutex::new([ExecutionOutcome::Done].into()),
        is_busy: true,
        ..Script::default()
    };
    let (report, moved) = brought_about(script, vec![goal(1, Relation::RightOf, 2)]).await;
    assert_eq!((report.ended, moved, report.achieved), (ArrangementEnd::Achieved, vec![1], 1), "{:?}", report.why);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_is_not_said_to_hold_once_a_move_of_what_it_is_about_was_stopped() {
    let script = Script {
        views: Mutex::new([view(&[(1, [0.3, 0.0]), (2, [-0.1, 0.0])])].into()),
        plans: Mutex::new([plan(Found::Found, &[(1, [0.1, 0.1, 0.0], term(Relation::RightOf, 2))])].into()),
        outcomes: Mutex::new([ExecutionOutcome::Stopped].into()),
        ..Script::default()
    };
    let (report, moved) = brought_about(script, vec![goal(1, Relation::RightOf, 2)]).await;
    assert_eq!((report.ended, moved, report.achieved), (ArrangementEnd::Stopped, vec![1], 0), "{:?}", report.why);
    assert_eq!(report.holds, BTreeMap::from([(1, None)]));
}
