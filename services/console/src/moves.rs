//! The moves that this console has robots make. Its going would be taken for its death, and a robot would halt on its way, with what it holds
//! (`on_client_loss`): a console that is to end begins no other, and waits for those under way.

use repose_proto::{CallError, ErrorCode};
use tokio::sync::watch;

/// The moves of a console; clones are of the same.
#[derive(Debug, Clone, Default)]
pub struct Moves(watch::Sender<Known>);

#[derive(Debug, Default)]
struct Known {
    under_way: usize,
    are_ending: bool,
}

/// A move, or several, under way for as long as this is kept.
#[derive(Debug)]
pub struct UnderWay(Moves);

impl Moves {
    /// Begins one.
    ///
    /// # Errors
    /// `unavailable` once no other is to begin.
    pub fn begin(&self) -> Result<UnderWay, CallError> {
        let begins = self.0.send_if_modified(|known| {
            known.under_way += usize::from(!known.are_ending);
            !known.are_ending
        });
        if begins { Ok(UnderWay(self.clone())) } else { Err(refusal()) }
    }

    /// Whether one that belongs to others under way may begin.
    ///
    /// # Errors
    /// `unavailable` once no other is to begin.
    pub fn check(&self) -> Result<(), CallError> {
        if self.are_ending() { Err(refusal()) } else { Ok(()) }
    }

    /// No other begins from here on.
    pub fn end(&self) {
        self.0.send_modify(|known| known.are_ending = true);
    }

    /// Whether no other is to begin.
    pub fn are_ending(&self) -> bool {
        self.0.borrow().are_ending
    }

    /// How many are under way.
    pub fn under_way(&self) -> usize {
        self.0.borrow().under_way
    }

    /// Waits until none is.
    pub async fn over(&self) {
        let mut known = self.0.subscribe();
        // It is told for as long as there are moves to tell of: these.
        drop(known.wait_for(|known| known.under_way == 0).await);
    }
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        self.0.0.send_modify(|known| known.under_way -= 1);
    }
}

fn refusal() -> CallError {
    CallError::new(ErrorCode::Unavailable, "the console is ending: no robot begins to move for it")
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;

    use super::*;

    #[tokio::test]
    async fn once_they_are_ending_none_begins_and_they_are_over_with_the_last_one_under_way() {
        let moves = Moves::default();
        moves.over().await;
        let (first, second) = (moves.begin().expect("one"), moves.clone().begin().expect("another"));
        moves.end();
        assert_eq!(moves.begin().expect_err("it is ending").code, ErrorCode::Unavailable);
        assert!(moves.check().is_err() && moves.are_ending() && moves.under_way() == 2);
        let mut over = Box::pin(moves.over());
        assert!((&mut over).now_or_never().is_none());
        drop(first);
        assert!((&mut over).now_or_never().is_none());
        drop(second);
        over.await;
    }
}
