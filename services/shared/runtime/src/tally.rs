//! How a worker's calls ended: counted for its load and its metrics, and said in its log.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use repose_proto::{CallError, ErrorCode, Payload, Service};

use crate::scenes::lacks_scene;

/// Calls that ended since the worker started.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    ended: AtomicU64,
    failed: AtomicU64,
}

impl Tally {
    /// Counts how a call ended, and says so in the log.
    pub(crate) fn count(&self, service: Service, method: &str, outcome: &Result<Payload, CallError>, took: Duration) {
        let service = service.as_str();
        let (code, is_unknown) = match outcome {
            Ok(_) => ("result", false),
            Err(error) => (error.code.as_str(), error.field.as_deref() == Some("method")),
        };
        self.ended.fetch_add(1, Ordering::Relaxed);
        self.failed.fetch_add(u64::from(outcome.as_ref().is_err_and(|error| error.code.is_workers())), Ordering::Relaxed);
        // Callers make methods up; the names of metrics are ours.
        let known = if is_unknown { "unknown" } else { method }.to_owned();
        metrics::counter!("repose_requests_total", "service" => service, "method" => known.clone(), "code" => code).increment(1);
        metrics::histogram!("repose_request_seconds", "service" => service, "method" => known).record(took.as_secs_f64());
        let took_ms = took.as_millis() as u64;
        match outcome {
            Err(error) if error.code == ErrorCode::Internal => tracing::error!(%error, took_ms, "ended"),
            // The caller now sends the scene, or asks another worker: this is how it finds out.
            Err(error) if lacks_scene(error) => tracing::debug!(%error, took_ms, "ended"),
            Err(error) => tracing::info!(%error, took_ms, "ended"),
            Ok(_) => tracing::debug!(took_ms, "ended"),
        }
    }

    /// Calls that ended, and those of them that the worker failed, as a load tells them.
    pub(crate) fn so_far(&self) -> (Option<u64>, Option<u64>) {
        (Some(self.ended.load(Ordering::Relaxed)), Some(self.failed.load(Ordering::Relaxed)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_caller_did_wrong_is_no_failure_of_the_worker() {
        let tally = Tally::default();
        let count = |outcome: Result<(), CallError>| {
            let outcome = outcome.and_then(|()| Payload::json(&repose_proto::scoring::ModelsRequest {}));
            tally.count(Service::Inference, "models", &outcome, Duration::ZERO);
        };
        count(Ok(()));
        count(Err(CallError::invalid("seed", "")));
        count(Err(CallError::not_found("scene_id", "")));
        assert_eq!(tally.so_far(), (Some(3), Some(0)));
        count(Err(CallError::internal("")));
        count(Err(CallError::new(ErrorCode::ResourceExhausted, "")));
        assert_eq!(tally.so_far(), (Some(5), Some(2)));
    }
}
