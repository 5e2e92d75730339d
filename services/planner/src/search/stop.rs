//! Why a search ends early.

use repose_proto::{CallError, ErrorCode};

/// Why a search stops early.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopReason {
    /// Nobody waits for the answer any more.
    Cancelled,
    /// Time is up.
    Deadline,
}

/// The models' answer; none when time ended while they were asked.
///
/// # Errors
/// Every other error of the models.
pub fn in_time<T>(answered: Result<T, CallError>) -> Result<Option<T>, CallError> {
    match answered {
        Err(error) if error.code == ErrorCode::DeadlineExceeded => Ok(None),
        answered => answered.map(Some),
    }
}
