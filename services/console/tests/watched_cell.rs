//! A watched cell: its activity, which several change at once, as the end of a sequence and whoever ends it do, and its robots.

use std::sync::{Arc, Barrier};
use std::time::Duration;

use repose_console::activity::SequenceShown;
use repose_console::cell::WatchedCell;
use repose_console::viewers::{Outbox, Outgoing, ViewerMessage};
use repose_proto::robot::RobotState;
use repose_proto::{ErrorCode, Payload};
use repose_runtime::{Moves, Session, Traffic};
use serde_json::json;

/// How often two change it at once.
const TIMES: usize = 300;

/// The first message of a kind that comes to a viewer.
async fn first_of(kind: &str, outbox: &Outbox) -> Arc<str> {
    let kind = format!(r#""kind":"{kind}""#);
    loop {
        match outbox.next().await.expect("it is told") {
            Outgoing::Whole(ViewerMessage::Text(text)) if text.contains(&kind) => return text,
            _ => {}
        }
    }
}

/// What a viewer who comes now is told of the activity.
async fn told(cell: &WatchedCell) -> Arc<str> {
    let outbox = Arc::new(Outbox::default());
    cell.audience().join(1, outbox.clone());
    cell.audience().leave(1);
    first_of("activity", &outbox).await
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_changes_at_once_the_later_one_is_what_viewers_are_left_with() {
    let session = Session::embedded().await.expect("a session");
    let cell = WatchedCell::follow(&session, "cell", Arc::default(), Moves::of("the console")).await.expect("a cell");
    let changes: [fn(&mut SequenceShown); 2] = [|s| s.ending = true, |s| s.ended = true];
    let both = Barrier::new(changes.len());
    for _ in 0..TIMES {
        cell.update(|activity| activity.sequence = Some(SequenceShown::default()));
        std::thread::scope(|scope| {
            for change in changes {
                let (cell, both) = (&cell, &both);
                scope.spawn(move || {
                    both.wait();
                    cell.update(|activity| activity.sequence.iter_mut().for_each(change));
                });
            }
        });
        let told = told(&cell).await;
        assert!(told.contains(r#""ending":true,"ended":true"#), "{told}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_whose_hand_has_failed_is_shown_as_it_stands_and_no_motion_begins_there() {
    let session = Session::embedded().await.expect("a session");
    let cell = WatchedCell::follow(&session, "cell", Arc::default(), Moves::of("the console")).await.expect("a cell");
    let outbox = Arc::new(Outbox::default());
    cell.audience().join(1, outbox.clone());
    let still = [0.0; 7];
    let state = json!({
        "v": 1, "seq": 1, "stamp_ns": 1, "robot_ms": 0.0, "q_rad": still, "dq_rad_s": still, "gripper_width_m": -1.0, "gripper_settled": true,
        "gripper_holding": false, "mode": "stopped", "stop": {"kind": "estop", "reason": "a person is in the way", "estop_id": "1"}
    });
    let state = Payload::json(&serde_json::from_value::<RobotState>(state).expect("a state")).expect("encoded");
    let states = session.publisher(session.cell().robot_state("right"), Traffic::RobotState);
    let telling = tokio::spawn(async move {
        let mut tick = tokio::time::interval(Duration::from_millis(10));
        loop {
            tick.tick().await;
            states.put(state.clone()).await.expect("put");
        }
    });
    let shown = tokio::time::timeout(Duration::from_secs(20), first_of("robot", &outbox)).await.expect("told in time");
    telling.abort();
    assert!(shown.contains(r#""mode":"stopped""#) && shown.contains("a person is in the way") && !shown.contains("links"), "{shown}");
    let refused = cell.robot("right").expect_err("it cannot be there");
    assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::Unavailable, Some("robot")), "{refused}");
}
