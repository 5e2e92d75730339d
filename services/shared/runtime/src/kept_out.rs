//! A user whose call access control keeps from a worker is told that, and not that the worker were gone: the router drops such a call in silence.

use std::time::Duration;

use repose_proto::{CallError, ErrorCode};

use crate::directory::Directory;
use crate::target::Target;
use crate::transport::Transport;

/// Whether a worker that answered nothing lives all the same, as its next load tells. Where nobody is a user, or the worker falls silent, it has died.
pub(crate) async fn is_kept_out(transport: &dyn Transport, directory: &Directory, worker: &str, within: Duration) -> bool {
    transport.is_user() && directory.hears_anew(worker, within).await
}

/// What the user is told.
pub(crate) fn refusal(target: &Target, worker: &str, method: &str) -> CallError {
    let message = format!(
        "{} worker {worker} is alive, and this user's call of {method} does not reach it: the user's role or cells in the roles file do not allow it",
        target.service
    );
    CallError::new(ErrorCode::FailedPrecondition, message)
}
