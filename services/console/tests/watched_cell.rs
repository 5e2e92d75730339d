//! A watched cell whose activity several change at once, as the end of a sequence and whoever ends it do.

use std::sync::{Arc, Barrier};

use repose_console::ConsoleConfig;
use repose_console::cell::WatchedCell;
use repose_console::messages::SequenceShown;
use repose_console::viewers::{Outbox, Outgoing, ViewerMessage};
use repose_runtime::Session;

/// How often two change it at once.
const TIMES: usize = 300;

/// What a viewer who comes now is told of the activity.
async fn told(cell: &WatchedCell) -> Arc<str> {
    let outbox = Arc::new(Outbox::default());
    cell.audience().join(1, outbox.clone());
    cell.audience().leave(1);
    loop {
        match outbox.next().await.expect("the activity is told") {
            Outgoing::Whole(ViewerMessage::Text(text)) if text.contains(r#""kind":"activity""#) => return text,
            _ => {}
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_changes_at_once_the_later_one_is_what_viewers_are_left_with() {
    let session = Session::embedded().await.expect("a session");
    let cell = WatchedCell::follow(&session, "cell", Arc::new(ConsoleConfig::default())).await.expect("a cell");
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
