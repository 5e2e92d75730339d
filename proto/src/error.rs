//! The one error that crosses the wire.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What went wrong, coarse enough to act on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ErrorCode {
    /// A bad value, NaN, unknown relation, unknown JSON field, unknown version or schema, empty cloud, oversize message.
    InvalidArgument,
    /// No such scene or object.
    NotFound,
    /// A queue is full; another worker, or a later try, may do.
    ResourceExhausted,
    /// The deadline passed before the work was done.
    DeadlineExceeded,
    /// The caller cancelled.
    Cancelled,
    /// The worker is gone, draining or out of reach.
    Unavailable,
    /// The request is well-formed but the world is not in the state that it needs.
    FailedPrecondition,
    /// A defect on our side.
    Internal,
}

impl ErrorCode {
    /// Whether the worker failed, and not its caller or the world: what an operator counts as errors.
    pub fn is_workers(self) -> bool {
        matches!(self, Self::Internal | Self::Unavailable | Self::ResourceExhausted | Self::DeadlineExceeded)
    }

    /// The code as it is spelled in JSON.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::InvalidArgument => "invalid_argument",
            Self::NotFound => "not_found",
            Self::ResourceExhausted => "resource_exhausted",
            Self::DeadlineExceeded => "deadline_exceeded",
            Self::Cancelled => "cancelled",
            Self::Unavailable => "unavailable",
            Self::FailedPrecondition => "failed_precondition",
            Self::Internal => "internal",
        }
    }

    /// Whether the same call may succeed on another worker or a little later.
    pub fn retryable(self) -> bool {
        matches!(self, Self::ResourceExhausted | Self::Unavailable)
    }
}

/// A typed error reply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema, thiserror::Error)]
#[error("{}: {message}{}", code.as_str(), field.as_ref().map(|f| format!(" (field {f})")).unwrap_or_default())]
pub struct CallError {
    /// What kind of error this is.
    pub code: ErrorCode,
    /// What was expected and what came, for a person.
    pub message: String,
    /// The request's field at fault, dotted path.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// Whether the same call may be tried again.
    pub retryable: bool,
    /// How long to wait before that, milliseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retry_after_ms: Option<u64>,
}

impl CallError {
    /// An error of some kind; `retryable` follows the code.
    pub fn new(code: ErrorCode, message: impl Into<String>) -> Self {
        Self { code, message: message.into(), field: None, retryable: code.retryable(), retry_after_ms: None }
    }

    /// A value of the request that cannot be used.
    pub fn invalid(field: impl Into<String>, message: impl Into<String>) -> Self {
        Self::new(ErrorCode::InvalidArgument, message).at(field)
    }

    /// Something that the request names and that is not there.
    pub fn not_found(field: impl Into<String>, message: impl Into<String>) -> Self {
        Self::new(ErrorCode::NotFound, message).at(field)
    }

    /// A state of the world that forbids the call.
    pub fn precondition(message: impl Into<String>) -> Self {
        Self::new(ErrorCode::FailedPrecondition, message)
    }

    /// A defect on our side.
    pub fn internal(message: impl Into<String>) -> Self {
        Self::new(ErrorCode::Internal, message)
    }

    /// Names the field at fault.
    #[must_use]
    pub fn at(mut self, field: impl Into<String>) -> Self {
        self.field = Some(field.into());
        self
    }

    /// Says when to try again.
    #[must_use]
    pub fn retry_after(mut self, retry_after_ms: u64) -> Self {
        self.retry_after_ms = Some(retry_after_ms);
        self
    }
}

impl crate::Message for CallError {
    const SCHEMA: &'static str = "CallError.v1";
}
