//! How one call is to be made: its deadline, its priority, and whether it may be computed twice.

use std::sync::Arc;
use std::time::Duration;

use repose_proto::{CallError, Payload, Priority};
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::cancel::given_up;
use crate::directory::Accept;

/// How one call is to be made.
#[derive(Clone)]
pub struct CallOptions {
    /// Time until the deadline (10 s), at most [`repose_proto::limits::MAX_REMAINING_MS`].
    pub deadline: Duration,
    /// Who waits.
    pub priority: Priority,
    /// Whether it may be computed twice, and so be tried again (yes). Never for what moves a robot.
    pub idempotent: bool,
    /// Whether an attempt that takes much longer than its worker's calls do is left for another (yes). Not where the answer takes its time on a slow
    /// link: a second one would wait there behind the first.
    pub leaves_slow: bool,
    /// Triggering it ends the call with `cancelled`, and tells the worker. Dropping the call's future tells it too.
    pub cancel: CancellationToken,
    /// This worker only.
    pub worker: Option<String>,
    /// Only workers whose load this accepts: a pin on weights and kernel.
    pub accept: Option<Accept>,
    /// Where progress goes; what does not fit is dropped.
    pub progress: Option<mpsc::Sender<Payload>>,
    /// The request's id; made up where absent. Repeating an at-most-once call needs the same one, at the same worker: it remembers what came
    /// of it, another would do it again.
    pub id: Option<String>,
    /// W3C trace context to pass on.
    pub traceparent: Option<String>,
    /// The cell that it is for, where that is not the session's: a pool's worker calls another on behalf of a cell.
    pub cell: Option<Arc<str>>,
}

impl Default for CallOptions {
    fn default() -> Self {
        Self {
            deadline: Duration::from_secs(10),
            priority: Priority::Interactive,
            idempotent: true,
            leaves_slow: true,
            cancel: CancellationToken::new(),
            worker: None,
            accept: None,
            progress: None,
            id: None,
            traceparent: None,
            cell: None,
        }
    }
}

impl CallOptions {
    /// The defaults with a deadline.
    pub fn within(deadline: Duration) -> Self {
        Self { deadline, ..Self::default() }
    }

    /// A call that must not happen twice.
    pub fn at_most_once(deadline: Duration) -> Self {
        Self { deadline, idempotent: false, ..Self::default() }
    }

    /// The same with what is left of the time until `deadline`: for a call that is one of several within it.
    pub fn until(&self, deadline: Instant) -> Self {
        Self { deadline: deadline.saturating_duration_since(Instant::now()), ..self.clone() }
    }

    /// Waits before a call is made again.
    ///
    /// # Errors
    /// `cancelled` when the caller gives it up meanwhile.
    pub(crate) async fn pause(&self, wait: Duration) -> Result<(), CallError> {
        tokio::select! {
            () = tokio::time::sleep(wait) => Ok(()),
            () = self.cancel.cancelled() => Err(given_up()),
        }
    }

    /// A call on behalf of another: the same deadline, cancel, trace and cell. It is interactive: who was let in at one door, and is being worked for,
    /// is not made to wait, or refused, at the next.
    pub fn for_call(call: &crate::Call) -> Self {
        Self {
            deadline: call.remaining(),
            cancel: call.cancelled.clone(),
            traceparent: call.traceparent.clone(),
            cell: call.cell.clone(),
            ..Self::default()
        }
    }
}
