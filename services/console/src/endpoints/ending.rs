//! The end of a console for which robots may be moving: nothing more begins, what moves is waited for, and what is left undone is said, in the log and on
//! the pages.

use std::time::Duration;

use repose_proto::{CallError, ErrorCode};
use repose_runtime::Shutdown;

use super::socket::goodbyes;
use super::state::AppState;
use super::{arrangement, sequence};

/// Ends what is carried out, and the pages after it: until then they show what moves, and can stop it.
pub async fn end(state: &AppState, drain: Duration, pages_end: &Shutdown) {
    end_moves(state, drain).await;
    pages_end.trigger();
    goodbyes(state).await;
}

/// Ends a sequence and an arrangement as a person does it, but with the move that they are at and not with its goal, for which other attempts may follow.
/// Waits for what moves, at most for `drain`.
async fn end_moves(state: &AppState, drain: Duration) {
    let moves = &state.moves;
    moves.end();
    let under_way = moves.under_way().len();
    if under_way > 0 {
        tracing::info!(moves = under_way, "moves are under way: the console ends after them, or in {:.1} s", drain.as_secs_f64());
    }
    let mut cells = Vec::new();
    let ending = async {
        cells = state.followed().await;
        for cell in &cells {
            sequence::end(cell);
            arrangement::end(cell);
        }
        moves.over().await;
    };
    if tokio::time::timeout(drain, ending).await.is_ok() {
        return;
    }
    tracing::warn!(moves = moves.under_way().len(), "moves are cut off by the end of the drain");
    let why = CallError::new(ErrorCode::Unavailable, "the console has ended before this was over: look at the robot");
    for cell in cells {
        let mut undone = Vec::new();
        cell.update(|activity| undone = activity.cut_off(&why));
        for what in undone {
            tracing::warn!(cell = cell.name(), "left undone: {what}");
        }
    }
}
