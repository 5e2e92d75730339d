//! How a worker's calls ended: counted for its load and its metrics, and said in its log.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use repose_proto::{CallError, ErrorCode, Payload, Service};

use crate::scenes::lacks_scene;

/// Between two lines of the log that say that calls are refused for lack of room. A crowd has hundreds refused a second, for days.
const REFUSALS_EVERY: Duration = Duration::from_secs(10);

/// Calls that ended since the worker started.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    ended: AtomicU64,
    failed: AtomicU64,
    refusals: Mutex<Refusals>,
}

/// Calls refused for lack of room of which the log has not said.
#[derive(Debug, Default)]
struct Refusals {
    unsaid: u64,
    said: Option<Instant>,
}

impl Refusals {
    /// Counts one; how many there were since the log said so last, where it is to say so again.
    fn note(&mut self, now: Instant) -> Option<u64> {
        self.unsaid += 1;
        if self.said.is_some_and(|said| now.duration_since(said) < REFUSALS_EVERY) {
            return None;
        }
        self.said = Some(now);
        Some(std::mem::take(&mut self.unsaid))
    }
}

impl Tally {
    /// Counts how a call ended, and says so in the log.
    pub(crate) fn count(&self, service: Service, method: &str, outcome: &Result<Payload, CallError>, took: Duration) {
        let code = outcome.as_ref().map_or_else(|error| error.code.as_str(), |_| "result");
        self.ended.fetch_add(1, Ordering::Relaxed);
        self.failed.fetch_add(u64::from(outcome.as_ref().is_err_and(|error| error.code.is_workers())), Ordering::Relaxed);
        let (method, service) = (label_of(service, method, outcome).to_owned(), service.as_str());
        metrics::counter!("repose_requests_total", "service" => service, "method" => method.clone(), "code" => code).increment(1);
        metrics::histogram!("repose_request_seconds", "service" => service, "method" => method).record(took.as_secs_f64());
        let took_ms = took.as_millis() as u64;
        match outcome {
            Err(error) if error.code == ErrorCode::Internal => tracing::error!(%error, took_ms, "ended"),
            // The caller now sends the scene, or asks another worker: this is how it finds out.
            Err(error) if lacks_scene(error) => tracing::debug!(%error, took_ms, "ended"),
            Err(error) if error.code == ErrorCode::ResourceExhausted => {
                let said = self.refusals.lock().unwrap_or_else(PoisonError::into_inner).note(Instant::now());
                match said {
                    Some(refused) => tracing::info!(%error, took_ms, refused, "calls are refused"),
                    None => tracing::debug!(%error, took_ms, "ended"),
                }
            }
            Err(error) => tracing::info!(%error, took_ms, "ended"),
            Ok(_) => tracing::debug!(took_ms, "ended"),
        }
    }

    /// Calls that ended, and those of them that the worker failed, as a load tells them.
    pub(crate) fn so_far(&self) -> (Option<u64>, Option<u64>) {
        (Some(self.ended.load(Ordering::Relaxed)), Some(self.failed.load(Ordering::Relaxed)))
    }
}

/// What metrics call a method. Callers make methods up, and each would be a series of its own for as long as the worker lives: also where a call was
/// refused, or its time was over, before its method was looked at.
fn label_of<'a>(service: Service, method: &'a str, outcome: &Result<Payload, CallError>) -> &'a str {
    let is_known = outcome.is_ok() || service.methods().contains(&method);
    if is_known { method } else { "unknown" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_that_callers_make_up_are_no_labels_however_their_calls_end() {
        let ended = |code, method| label_of(Service::Motion, method, &Err(CallError::new(code, "")));
        for code in [ErrorCode::InvalidArgument, ErrorCode::ResourceExhausted, ErrorCode::Cancelled, ErrorCode::DeadlineExceeded] {
            assert_eq!((ended(code, "made-up"), ended(code, "place"), ended(code, "plan")), ("unknown", "unknown", "plan"));
        }
    }

    #[test]
    fn a_crowd_that_is_refused_has_a_line_now_and_then_and_not_one_each() {
        let (mut refusals, start) = (Refusals::default(), Instant::now());
        let said = |refusals: &mut Refusals, after: Duration| refusals.note(start + after);
        assert_eq!(said(&mut refusals, Duration::ZERO), Some(1), "at once");
        let unsaid = (0..500).filter(|ms| said(&mut refusals, Duration::from_millis(*ms)).is_none()).count();
        assert_eq!((unsaid, said(&mut refusals, REFUSALS_EVERY)), (500, Some(501)));
        assert_eq!(said(&mut refusals, REFUSALS_EVERY), None);
    }

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
