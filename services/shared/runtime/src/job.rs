//! A request on its way to a compute thread: how long it may take, and the way back.

use std::sync::Arc;
use std::time::{Duration, Instant};

use repose_proto::{CallError, ErrorCode, Priority};
use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

use crate::cancel::given_up;
use crate::shares::ForCell;
use crate::stages::Stages;

/// How long a job may still be worth computing. Long computations ask between their steps.
#[derive(Debug, Clone)]
pub struct JobContext {
    deadline: Instant,
    cancelled: CancellationToken,
    pub(crate) priority: Priority,
    pub(crate) cell: ForCell,
    pub(crate) stages: Stages,
    pub(crate) span: tracing::Span,
}

impl JobContext {
    /// A job that must be done by `deadline` and ends when `cancelled` is triggered.
    pub fn new(deadline: Instant, cancelled: CancellationToken) -> Self {
        Self { deadline, cancelled, priority: Priority::Interactive, cell: None, stages: Stages::default(), span: tracing::Span::current() }
    }

    /// The same, whose time in the queue is added to a call's stages.
    #[must_use]
    pub fn with_stages(self, stages: Stages) -> Self {
        Self { stages, ..self }
    }

    /// The same with another priority; jobs are interactive unless said otherwise.
    #[must_use]
    pub fn with_priority(self, priority: Priority) -> Self {
        Self { priority, ..self }
    }

    /// The same for another cell than the worker's own.
    #[must_use]
    pub fn for_cell(self, cell: Option<Arc<str>>) -> Self {
        Self { cell, ..self }
    }

    /// A job that nobody cancels.
    pub fn within(time: Duration) -> Self {
        Self::new(Instant::now() + time, CancellationToken::new())
    }

    /// When the job must be done.
    pub fn deadline(&self) -> Instant {
        self.deadline
    }

    /// Triggered when the caller cancels.
    pub fn cancelled(&self) -> &CancellationToken {
        &self.cancelled
    }

    /// Time left.
    pub fn remaining(&self) -> Duration {
        self.deadline.saturating_duration_since(Instant::now())
    }

    /// Whether to go on.
    ///
    /// # Errors
    /// `cancelled` or `deadline_exceeded`.
    pub fn check(&self) -> Result<(), CallError> {
        // The deadline first: passing it triggers the cancel as well.
        if self.remaining().is_zero() {
            return Err(CallError::new(ErrorCode::DeadlineExceeded, "the deadline passed before the work was done"));
        }
        if self.cancelled.is_cancelled() {
            return Err(given_up());
        }
        Ok(())
    }
}

/// A request on its way to a compute thread, with the way back.
pub struct Job<R, T> {
    pub(crate) queued: Instant,
    /// What to compute.
    pub request: R,
    /// How long it may take.
    pub context: JobContext,
    /// Where the answer goes.
    pub reply: JobReply<T>,
}

impl<R, T> Job<R, T> {
    /// Answers, and drops the request.
    pub fn finish(self, result: Result<T, CallError>) {
        self.reply.finish(result);
    }

    /// The job, if anyone still waits for it; answers if it is too late.
    pub(crate) fn alive(self) -> Option<Self> {
        if !self.reply.is_awaited() {
            return None;
        }
        match self.context.check() {
            Ok(()) => Some(self),
            Err(error) => {
                self.finish(Err(error));
                None
            }
        }
    }
}

/// The way back of a [`Job`]. Dropped without an answer, the job ends as `internal`.
pub struct JobReply<T>(pub(crate) oneshot::Sender<Result<T, CallError>>);

impl<T> JobReply<T> {
    /// Whether anyone still waits for the answer.
    pub fn is_awaited(&self) -> bool {
        !self.0.is_closed()
    }

    /// Answers.
    pub fn finish(self, result: Result<T, CallError>) {
        // A caller that has gone needs no answer.
        drop(self.0.send(result));
    }
}
