//! The moves that a client has robots make. Its going would be taken for its death, and a robot would halt on its way, with what it holds
//! (`on_client_loss`): a client that is to end begins no other, and waits for those under way.

use std::collections::BTreeMap;
use std::pin::pin;
use std::time::Duration;

use repose_proto::{CallError, ErrorCode, Payload};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::call_options::CallOptions;
use crate::caller::{Answer, Caller};
use crate::robots::call_moving;
use crate::session::Session;

/// How long moves that are cut off may take to end: their arms come to rest, and whoever asked for them is told so.
const CUT_OFF: Duration = Duration::from_secs(2);

/// The moves of a client; clones are of the same.
#[derive(Debug, Clone)]
pub struct Moves {
    whose: &'static str,
    known: watch::Sender<Known>,
    cut_off: CancellationToken,
}

#[derive(Debug, Default)]
struct Known {
    /// What is prepared or under way, in words.
    under_way: BTreeMap<u64, String>,
    /// Answers that are not given or not read yet.
    owed: usize,
    are_ending: bool,
}

/// A move, or several, under way for as long as this is kept.
#[derive(Debug)]
pub struct UnderWay {
    moves: Moves,
    number: u64,
}

/// An answer, owed for as long as this is kept.
#[derive(Debug)]
pub struct OwedAnswer(Moves);

impl Moves {
    /// Those of a client that messages call `whose`: "the console".
    pub fn of(whose: &'static str) -> Self {
        Self { whose, known: watch::Sender::default(), cut_off: CancellationToken::new() }
    }

    /// Begins one, which the log calls `what`.
    ///
    /// # Errors
    /// `unavailable` once no other is to begin.
    pub fn begin(&self, what: impl Into<String>) -> Result<UnderWay, CallError> {
        self.begin_where(what.into(), |_| Ok(()))
    }

    /// The same, beside no other.
    ///
    /// # Errors
    /// The same, and `failed_precondition` while another is under way.
    pub fn begin_alone(&self, what: impl Into<String>) -> Result<UnderWay, CallError> {
        let is_alone = |known: &Known| match known.under_way.is_empty() {
            true => Ok(()),
            false => Err(CallError::precondition("another plan is being carried out; wait for its end, or stop the robot")),
        };
        self.begin_where(what.into(), is_alone)
    }

    fn begin_where(&self, what: String, may: impl FnOnce(&Known) -> Result<(), CallError>) -> Result<UnderWay, CallError> {
        let mut begun = Err(self.refusal());
        self.known.send_if_modified(|known| {
            // Looked at under the lock: what begins before the end is there to be waited for after it.
            if !known.are_ending {
                begun = may(known).map(|()| {
                    let number = known.under_way.last_key_value().map_or(0, |(last, _)| last + 1);
                    known.under_way.insert(number, what);
                    number
                });
            }
            begun.is_ok()
        });
        begun.map(|number| UnderWay { moves: self.clone(), number })
    }

    /// Whether one that belongs to others under way may begin.
    ///
    /// # Errors
    /// `unavailable` once no other is to begin.
    pub fn check(&self) -> Result<(), CallError> {
        if self.are_ending() { Err(self.refusal()) } else { Ok(()) }
    }

    /// Owes somebody the answer to one: it is waited for, too.
    pub fn owe(&self) -> OwedAnswer {
        self.known.send_modify(|known| known.owed += 1);
        OwedAnswer(self.clone())
    }

    /// No other begins from here on.
    pub fn end(&self) {
        self.known.send_modify(|known| known.are_ending = true);
    }

    /// Whether no other is to begin.
    pub fn are_ending(&self) -> bool {
        self.known.borrow().are_ending
    }

    /// What is under way, in words.
    pub fn under_way(&self) -> Vec<String> {
        self.known.borrow().under_way.values().cloned().collect()
    }

    /// Waits until no other is to begin; then the refusal of one that has not moved anything yet.
    pub async fn refused(&self) -> CallError {
        self.told(|known| known.are_ending).await;
        self.refusal()
    }

    /// Waits until those under way are cut off; then what is said of them.
    pub async fn cut_off(&self) -> CallError {
        self.cut_off.cancelled().await;
        CallError::new(ErrorCode::Unavailable, format!("{} has ended before this was over: look at the robot", self.whose))
    }

    /// Calls a method that moves a robot as [`call_moving`] does, until those under way are cut off: then it is cancelled, and the arm comes to rest.
    ///
    /// # Errors
    /// Those of [`call_moving`]; once it was cut off, what [`Self::cut_off`] says.
    pub async fn call(
        &self,
        session: &Session,
        motion: &Caller,
        method: &str,
        payload: Payload,
        options: CallOptions,
    ) -> Result<Answer, CallError> {
        let cancel = options.cancel.child_token();
        let mut moving = pin!(call_moving(session, motion, method, payload, CallOptions { cancel: cancel.clone(), ..options }));
        tokio::select! {
            answer = &mut moving => answer,
            why = self.cut_off() => {
                cancel.cancel();
                moving.await.map_err(|_| why)
            }
        }
    }

    /// Waits until none is under way and no answer is owed.
    pub async fn over(&self) {
        self.told(|known| known.under_way.is_empty() && known.owed == 0).await;
    }

    /// Begins no other, and waits for those under way, at most for `drain`. What is left then is named in the log and cut off.
    pub async fn ended(&self, drain: Duration) {
        self.end();
        let under_way = self.under_way();
        if !under_way.is_empty() {
            let within_s = drain.as_secs_f64();
            tracing::info!("moves are under way, and {} ends after them, or in {within_s:.1} s: {}", self.whose, under_way.join("; "));
        }
        if tokio::time::timeout(drain, self.over()).await.is_ok() {
            return;
        }
        for what in self.under_way() {
            tracing::warn!("left undone, cut off by the end of the drain: {what}");
        }
        self.cut_off.cancel();
        drop(tokio::time::timeout(CUT_OFF, self.over()).await);
    }

    async fn told(&self, what: impl FnMut(&Known) -> bool) {
        // It is told for as long as there are moves to tell of: these.
        drop(self.known.subscribe().wait_for(what).await);
    }

    fn refusal(&self) -> CallError {
        CallError::new(ErrorCode::Unavailable, format!("{} is ending: no robot begins to move for it", self.whose))
    }
}

impl Drop for UnderWay {
    fn drop(&mut self) {
        self.moves.known.send_modify(|known| drop(known.under_way.remove(&self.number)));
    }
}

impl Drop for OwedAnswer {
    fn drop(&mut self) {
        self.0.known.send_modify(|known| known.owed -= 1);
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt as _;

    use super::*;

    const DRAIN: Duration = Duration::from_secs(60);

    #[tokio::test]
    async fn once_they_are_to_end_none_begins_and_they_are_over_with_the_last_one_under_way_and_its_answer() {
        let moves = Moves::of("the console");
        moves.over().await;
        let [first, second] = ["the first", "the second"].map(|what| moves.clone().begin(what).expect("it begins"));
        let owed = moves.owe();
        let mut ended = Box::pin(moves.ended(DRAIN));
        assert!((&mut ended).now_or_never().is_none());
        let refused = moves.begin("another").expect_err("it is ending");
        assert!(refused.code == ErrorCode::Unavailable && refused.message.contains("the console"), "{refused:?}");
        assert_eq!((moves.refused().await.code, moves.check().map_err(|e| e.code)), (refused.code, Err(refused.code)));
        drop(first);
        assert!((&mut ended).now_or_never().is_none());
        assert_eq!(moves.under_way(), ["the second"]);
        drop(second);
        assert!((&mut ended).now_or_never().is_none(), "the answer is not read");
        drop(owed);
        ended.await;
        assert!(moves.cut_off().now_or_never().is_none());
    }

    #[test]
    fn one_that_is_to_be_alone_begins_beside_no_other() {
        let moves = Moves::of("the server");
        let alone = moves.begin_alone("the first").expect("it begins");
        assert_eq!(moves.begin_alone("another").expect_err("one at a time").code, ErrorCode::FailedPrecondition);
        drop(alone);
        assert!(moves.begin_alone("another").is_ok());
        moves.end();
        assert_eq!(moves.begin_alone("a third").expect_err("it is ending").code, ErrorCode::Unavailable);
    }

    #[tokio::test(start_paused = true)]
    async fn what_takes_longer_than_the_drain_is_cut_off_and_nobody_is_waited_for_without_end() {
        let moves = Moves::of("the bridge");
        let [comes_to_rest, never_ends] = ["the first", "the second"].map(|what| moves.begin(what).expect("it begins"));
        let _never_read = moves.owe();
        let resting = async {
            assert_eq!(moves.cut_off().await.code, ErrorCode::Unavailable);
            drop(comes_to_rest);
        };
        tokio::join!(moves.ended(DRAIN), resting);
        assert_eq!(moves.under_way(), ["the second"]);
        drop(never_ends);
    }
}
