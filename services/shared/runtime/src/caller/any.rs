//! The same call to every worker: whoever holds something answers, and nobody has to know who that is.

use repose_proto::{CallError, ErrorCode, Payload};
use tokio::time::Instant;

use super::{Answer, Caller, deadline_of};
use crate::call_options::CallOptions;

impl Caller {
    /// Makes the same call to every worker alive and returns the first result: who holds it, whoever that is. Ends within its deadline, in which it may
    /// have to wait for a first worker.
    ///
    /// # Errors
    /// When nobody has a result: `resource_exhausted` if anyone was too busy to say, else `unavailable` or `deadline_exceeded` if anyone did not answer,
    /// else `not_found` if anyone said so, otherwise the last error; `unavailable` also when nobody is alive. `cancelled`, and those of a call's deadline.
    pub async fn call_any(&self, method: &str, payload: &Payload, options: &CallOptions) -> Result<Answer, CallError> {
        let deadline = deadline_of(options)?;
        self.wait_for_any(deadline, options).await?;
        let options = CallOptions { id: None, ..options.until(deadline) };
        let mut calls: futures::stream::FuturesUnordered<_> = self
            .workers()
            .into_iter()
            .map(|worker| {
                let options = CallOptions { worker: Some(worker.name), ..options.clone() };
                self.call(method, payload.clone(), options)
            })
            .collect();
        let mut worst: Option<CallError> = None;
        while let Some(ended) = futures::StreamExt::next(&mut calls).await {
            match ended {
                Ok(answer) => return Ok(answer),
                Err(error) if worst.as_ref().is_none_or(|worst| weight(&error) >= weight(worst)) => worst = Some(error),
                Err(_) => {}
            }
        }
        Err(worst.unwrap_or_else(|| CallError::new(ErrorCode::Unavailable, format!("no worker of {} answered", self.inner.target))))
    }

    /// Waits for a first worker as a call does: `worker_wait_ms`, and through an outage of the router. Whoever asks all of them needs to know none's load,
    /// which over a slow link comes a round trip and a period later.
    async fn wait_for_any(&self, deadline: Instant, options: &CallOptions) -> Result<(), CallError> {
        let someone = || (!self.workers().is_empty()).then_some(());
        match self.inner.wait_for(deadline, &options.cancel, someone).await? {
            Some(()) => Ok(()),
            None => Err(self.inner.patience.at_deadline(self.inner.patience.nobody().await)),
        }
    }
}

/// How much an error says of what is asked for. Whoever is too busy, or does not answer, may hold it, though all others do not; one that is too busy
/// says so when it is asked again.
fn weight(error: &CallError) -> u8 {
    match error.code {
        ErrorCode::ResourceExhausted => 3,
        ErrorCode::Unavailable | ErrorCode::DeadlineExceeded => 2,
        ErrorCode::NotFound => 1,
        _ => 0,
    }
}
