//! A call as its handler sees it, and the handler.

use std::sync::Arc;
use std::time::{Duration, Instant};

use async_trait::async_trait;
use repose_proto::load::WorkerLoad;
use repose_proto::{CallError, Payload, Priority};
use tokio_util::sync::CancellationToken;

use crate::job::JobContext;
use crate::mailbox::MailboxSender;
use crate::stages::Stages;

/// One call to this worker. Cheap to clone.
#[derive(Clone)]
pub struct Call {
    /// The request's id, the same for every attempt.
    pub id: String,
    /// The method asked for.
    pub method: String,
    /// The request, not yet decoded.
    pub payload: Payload,
    /// Who waits.
    pub priority: Priority,
    /// 0 for the first attempt.
    pub attempt: u32,
    /// W3C trace context, if the caller sent one.
    pub traceparent: Option<String>,
    /// The name that the caller's process goes by, if it told one; anybody may say anything.
    pub caller: Option<String>,
    /// The cell that the call is for, where this worker serves it as its pool's; none for the worker's own. The key says so and not the caller.
    pub cell: Option<Arc<str>>,
    /// When the answer must be there. The runtime answers `deadline_exceeded` then, whatever the handler does.
    pub deadline: tokio::time::Instant,
    /// Triggered by the caller's cancel, by the deadline, and when draining takes too long.
    pub cancelled: CancellationToken,
    pub(crate) progress: MailboxSender<Payload>,
    pub(crate) stages: Stages,
}

impl Call {
    /// Sends progress. Never waits; the oldest goes when the caller is slow. Works from compute threads too.
    pub fn progress(&self, payload: Payload) {
        self.progress.push(payload);
    }

    /// Adds to the time of a stage, milliseconds. It travels beside the result.
    pub fn stage(&self, name: &str, ms: f64) {
        self.stages.add(name, ms);
    }

    /// Runs something and adds the time that it took to a stage.
    pub fn timed<T>(&self, name: &str, work: impl FnOnce() -> T) -> T {
        let started = Instant::now();
        let result = work();
        self.stage(name, started.elapsed().as_secs_f64() * 1e3);
        result
    }

    /// Time left.
    pub fn remaining(&self) -> Duration {
        self.deadline.saturating_duration_since(tokio::time::Instant::now())
    }

    /// What a compute job of this call needs to know.
    pub fn context(&self) -> JobContext {
        JobContext::new(self.deadline.into_std(), self.cancelled.clone())
            .with_priority(self.priority)
            .for_cell(self.cell.clone())
            .with_stages(self.stages.clone())
    }

    /// The error for a method that the service does not have.
    pub fn unknown_method(&self) -> CallError {
        CallError::invalid("method", format!("this service has no method {:?}", self.method))
    }
}

/// A service: requests in, replies out.
#[async_trait]
pub trait Handler: Send + Sync + 'static {
    /// Answers a call. The future is dropped some time after its deadline or its cancel (`cancel_grace_ms`): what must not be cut off,
    /// such as bringing a robot to a stop, belongs in a task of its own. A panic becomes `internal`.
    ///
    /// # Errors
    /// Whatever the caller is to see.
    async fn call(&self, call: Call) -> Result<Payload, CallError>;

    /// Methods whose effect must not happen twice: the same id again gets the same outcome, with a different payload
    /// `failed_precondition`. An error that is `retryable` says that nothing has happened: the same id again is a new call.
    fn at_most_once(&self, _method: &str) -> bool {
        false
    }

    /// The worker's load. `v`, `seq`, `draining` are filled in, and so are the counts and `service_ms` where the handler leaves them 0.
    fn load(&self) -> WorkerLoad {
        WorkerLoad::default()
    }
}
