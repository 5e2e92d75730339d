//! Cancels of calls: what a worker is told of an attempt that nobody waits for any more.

use std::sync::Arc;

use bytes::Bytes;
use repose_proto::{CallError, ErrorCode, Payload, Priority};

use crate::target::Target;
use crate::transport::{Traffic, Transport};

/// The error of a call that its caller gave up.
pub(crate) fn given_up() -> CallError {
    CallError::new(ErrorCode::Cancelled, "the caller cancelled")
}

/// Cancels the call `id` at a worker.
pub(crate) fn cancel_at(transport: &Arc<dyn Transport>, target: &Target, worker: &str, id: &str) -> impl Future<Output = ()> + use<> {
    let (transport, key) = (transport.clone(), target.workers_in.cancel(target.service, worker, id));
    async move {
        let payload = Payload { encoding: String::new(), bytes: Bytes::new() };
        if let Err(error) = transport.put(&key, payload, Traffic::Call(Priority::Interactive)).await {
            tracing::debug!(%error, "a cancel could not be sent");
        }
    }
}

/// Tells the worker when an attempt is left before its terminal reply, however that happens.
pub(crate) struct CancelUnlessDone<'a> {
    pub(crate) transport: &'a Arc<dyn Transport>,
    pub(crate) target: &'a Target,
    pub(crate) worker: String,
    pub(crate) id: String,
    pub(crate) armed: bool,
}

impl Drop for CancelUnlessDone<'_> {
    fn drop(&mut self) {
        if self.armed
            && let Ok(runtime) = tokio::runtime::Handle::try_current()
        {
            runtime.spawn(cancel_at(self.transport, self.target, &self.worker, &self.id));
        }
    }
}
