//! Refusals that are heeded: an overloaded worker that has refused a batch call is not asked at once for the next one like it.
//!
//! A refusal costs the worker, the router and the caller about a twentieth of what a placement costs, so that a crowd that asks three times as
//! often as can be answered would take a tenth of the capacity by being refused. A worker says after how long half of what waits is done; until
//! then it has enough to do, and others like the refused call are refused by their own caller. Interactive calls always ask.

use std::sync::Arc;
use std::time::Duration;

use repose_proto::{CallError, ErrorCode};
use tokio::time::Instant;

/// How much more time than a refused call's makes another call another case: a sixty-fourth.
const MORE_TIME: f64 = 1.0 + 1.0 / 64.0;

/// What a worker has refused.
#[derive(Debug, Clone)]
pub(crate) struct Refused {
    /// The refused call.
    call: BatchCall,
    until: Instant,
}

/// A batch call, as far as a refusal looks at it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct BatchCall {
    /// How much of its deadline is left.
    pub(crate) left: Duration,
    /// The cell that it is for, where that is not the worker's.
    pub(crate) cell: Option<Arc<str>>,
}

impl Refused {
    /// A refusal of `call` that stands for as long as the worker asked for, and for `most` at most; none where the error is another one or says
    /// nothing of when to come back.
    pub(crate) fn by(error: &CallError, call: BatchCall, most: Duration) -> Option<Self> {
        let asked = error.retry_after_ms.filter(|_| error.code == ErrorCode::ResourceExhausted)?;
        let holds = Duration::from_millis(asked).min(most);
        (!holds.is_zero()).then(|| Self { call, until: Instant::now() + holds })
    }

    /// For how long the refusal stands for another call; none where it does not.
    pub(crate) fn stands_for(&self, call: &BatchCall) -> Option<Duration> {
        let is_alike = call.cell == self.call.cell && call.left <= self.call.left.mul_f64(MORE_TIME);
        let left = self.until.saturating_duration_since(Instant::now());
        (is_alike && !left.is_zero()).then_some(left)
    }
}

/// The error of a call that every worker it could go to has refused already.
pub(crate) fn refusal(target: &str, stands: Duration) -> CallError {
    let ms = u64::try_from(stands.as_millis()).unwrap_or(u64::MAX).max(1);
    let message = format!("{target} is overloaded: it has just refused a call like this, and is asked again in {ms} ms");
    CallError::new(ErrorCode::ResourceExhausted, message).retry_after(ms)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn call(left_ms: u64, cell: Option<&str>) -> BatchCall {
        BatchCall { left: Duration::from_millis(left_ms), cell: cell.map(Arc::from) }
    }

    #[tokio::test(start_paused = true)]
    async fn a_refusal_stands_for_its_time_for_calls_with_no_more_time_and_for_their_cell() {
        let error = CallError::new(ErrorCode::ResourceExhausted, "full").retry_after(300);
        let refused = Refused::by(&error, call(3000, Some("a")), Duration::from_millis(200)).expect("it says when to come back");
        assert_eq!(refused.stands_for(&call(3001, Some("a"))), Some(Duration::from_millis(200)), "bounded");
        assert_eq!(refused.stands_for(&call(4000, Some("a"))), None, "this one may wait longer");
        assert_eq!(refused.stands_for(&call(3000, None)), None, "another cell has its own places");
        tokio::time::advance(Duration::from_millis(200)).await;
        assert_eq!(refused.stands_for(&call(100, Some("a"))), None, "it is over");
    }

    #[tokio::test(start_paused = true)]
    async fn other_errors_and_a_bound_of_nothing_are_no_refusals_to_heed() {
        let busy = CallError::new(ErrorCode::ResourceExhausted, "full");
        assert!(Refused::by(&busy, call(1, None), Duration::from_secs(1)).is_none(), "it does not say when to come back");
        assert!(Refused::by(&busy.clone().retry_after(5), call(1, None), Duration::ZERO).is_none());
        let gone = CallError::new(ErrorCode::Unavailable, "gone").retry_after(5);
        assert!(Refused::by(&gone, call(1, None), Duration::from_secs(1)).is_none());
    }
}
