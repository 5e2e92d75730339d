//! Calls that come: who is let in, and the one answer that each gets.
//!
//! A call runs in a task of its own; its terminal reply is the first of: what the handler returns, the deadline, the end of the grace
//! after a cancel, the end of the drain. The way back is dropped right after it, which is what ends the caller's stream.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use repose_proto::{CallAttachment, CallError, ErrorCode, JournalKind, Payload, ReplyAttachment, ReplyKind, limits, message};
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use super::Shared;
use super::answerer::Answerer;
use crate::call::Call;
use crate::call_key::CallKey;
use crate::cancel::given_up;
use crate::mailbox::{MailboxReceiver, mailbox};
use crate::registry::{Admission, CallResult, Fingerprint, MAX_JOINED};
use crate::shares::ForCell;
use crate::stages::Stages;
use crate::transport::IncomingQuery;

/// Progress replies of one call that may wait to be sent.
const PROGRESS_CAPACITY: usize = 64;

/// The id of an attachment that could not be read whole, so that the reply can carry it.
fn id_of(attachment: &[u8]) -> String {
    let value: Option<serde_json::Value> = serde_json::from_slice(attachment).ok();
    value.and_then(|v| Some(v.get("id")?.as_str()?.to_owned())).unwrap_or_default()
}

pub(super) async fn answer(shared: Arc<Shared>, query: IncomingQuery, call_key: CallKey) {
    let IncomingQuery { key, payload, attachment, replier } = query;
    let received = Instant::now();
    let mut reply = ReplyAttachment {
        v: limits::VERSION,
        id: String::new(),
        kind: ReplyKind::Error,
        n: None,
        worker: Some(shared.worker.clone()),
        attempt: None,
        timing_ms: BTreeMap::new(),
    };
    let decoded = match attachment.is_empty() {
        true => Err(CallError::invalid("attachment", "a call needs an attachment")),
        false => CallAttachment::decode(&attachment).and_then(|a| message::check_size(payload.bytes.len()).map(|()| a)),
    };
    let call = match decoded {
        Ok(call) => call,
        Err(error) => {
            reply.id = id_of(&attachment);
            return Answerer { replier, attachment: reply, journal: None }.finish(Err(error), BTreeMap::new()).await;
        }
    };
    reply.id.clone_from(&call.id);
    reply.attempt = Some(call.attempt);
    let journal = Some(&shared.journal).filter(|journal| journal.is_on() && shared.service.journals(&call.method)).cloned();
    let cell = call_key.cell(&key, &shared.cell);
    if let Some(journal) = &journal {
        journal.copy(JournalKind::Call, cell.as_ref().ok().and_then(Option::as_deref), &attachment, &payload);
    }
    let answerer = Answerer { replier, attachment: reply, journal };
    let deadline = received + Duration::from_millis(call.remaining_ms);
    let entered = shared.may_enter(call_key, &call.method).and(cell);
    let cell = match entered {
        Ok(cell) => cell,
        Err(error) => return answerer.finish(Err(error), BTreeMap::new()).await,
    };
    let fingerprint = Fingerprint::of(&call.method, &payload);
    let admission = shared.registry().admit(&call, &cell, fingerprint);
    let error = match admission {
        Admission::Compute { cancelled } => {
            let admitted = Admitted { attachment: call, cell, payload, deadline, cancelled };
            return compute(shared, admitted, answerer).await;
        }
        Admission::Join { outcome } => {
            // The first has its own.
            drop(payload);
            return join(outcome, deadline, answerer).await;
        }
        Admission::Crowded => shared.no_place(format!("{MAX_JOINED} repetitions of this call wait for it already")),
        Admission::Cancelled => CallError::new(ErrorCode::Cancelled, "the caller cancelled before the call came"),
        Admission::Conflict => CallError::precondition("this id belongs to a different request").at("id"),
        Admission::Full => shared.no_place(format!("{} calls are open already", shared.config.max_open_calls)),
        Admission::CellFull { open } => {
            let name = cell.as_deref().unwrap_or_default();
            shared.no_place(format!("{open} calls of cell {name} are open already, as many as places are left for others")).at("cell")
        }
    };
    let span = span_of(&shared, &call, &cell);
    let refused = Err(error);
    span.in_scope(|| shared.tally.count(shared.service, &call.method, &refused, received.elapsed()));
    answerer.finish(refused, BTreeMap::new()).await;
}

impl Shared {
    /// Whether a call of a method may arrive on a key now.
    fn may_enter(&self, call_key: CallKey, method: &str) -> Result<(), CallError> {
        if self.refusing.load(Ordering::Acquire) {
            return Err(CallError::new(ErrorCode::Unavailable, "this worker is stopping"));
        }
        // Of those that a router lets in as users some may call and not operate, whichever configuration a worker was started with.
        let operate_only = self.config.operate_only || self.transport.is_user();
        call_key.takes(method, self.service, operate_only)
    }

    /// Counts a refusal for lack of a place, as a queue's are counted, and says when to come back.
    fn no_place(&self, message: String) -> CallError {
        metrics::counter!("repose_refused_total", "queue" => self.service.as_str()).increment(1);
        CallError::new(ErrorCode::ResourceExhausted, message).retry_after(self.retry_after_ms())
    }

    /// In how long half of the open calls will have ended, milliseconds: half of what a call is open for, its waiting included, since open calls are half
    /// done on average, however many are served at once.
    fn retry_after_ms(&self) -> u64 {
        let call_ms = self.gauge.service_ms().max(self.handler.load().service_ms);
        (call_ms / 2.0).clamp(1.0, 10_000.0) as u64
    }
}

/// A call that was let in.
struct Admitted {
    attachment: CallAttachment,
    cell: ForCell,
    payload: Payload,
    deadline: Instant,
    cancelled: CancellationToken,
}

async fn compute(shared: Arc<Shared>, admitted: Admitted, mut answerer: Answerer) {
    let Admitted { attachment, cell, payload, deadline, cancelled } = admitted;
    let (progress, mut progressed) = mailbox(PROGRESS_CAPACITY);
    let span = span_of(&shared, &attachment, &cell);
    let call = Call {
        id: attachment.id,
        method: attachment.method,
        payload,
        priority: attachment.priority,
        attempt: attachment.attempt,
        // A call made on behalf of this one belongs under this one's span.
        traceparent: crate::trace::traceparent(&span).or(attachment.traceparent),
        caller: attachment.caller,
        cell,
        deadline,
        cancelled: cancelled.clone(),
        progress,
        stages: Stages::default(),
    };
    let (id, stages) = (call.id.clone(), call.stages.clone());
    let at_most_once = shared.handler.at_most_once(&call.method);
    let started = Instant::now();
    shared.gauge.started(1);
    let handler = shared.handler.clone();
    let method = call.method.clone();
    let task = tokio::spawn(async move { handler.call(call).await }.instrument(span.clone()));
    let grace = Duration::from_millis(shared.config.cancel_grace_ms);
    let mut outcome = supervise(task, (deadline, grace), &cancelled, &mut progressed, &mut answerer).await;
    match &outcome {
        Err(error) if error.code == ErrorCode::ResourceExhausted => shared.gauge.refused(1),
        _ => shared.gauge.finished(1, started.elapsed()),
    }
    // No more than wait now: one whose deadline has passed may still be telling.
    for payload in std::iter::from_fn(|| progressed.try_recv()).take(PROGRESS_CAPACITY) {
        answerer.progress(payload).await;
    }
    {
        let mut registry = shared.registry();
        let was_cancelled = outcome.as_ref().is_err_and(|error| error.code == ErrorCode::Cancelled);
        if was_cancelled && !registry.is_cancelled_by_caller(&id) {
            // The end of a drain: another worker may do it, unless it may have been done here.
            let error = CallError::new(ErrorCode::Unavailable, "this worker stopped before the work was done");
            outcome = Err(CallError { retryable: !at_most_once, ..error });
        }
        registry.finish(&id, outcome.clone(), at_most_once);
    }
    let mut timing_ms = stages.take();
    timing_ms.insert("total".to_owned(), started.elapsed().as_secs_f64() * 1e3);
    span.in_scope(|| shared.tally.count(shared.service, &method, &outcome, started.elapsed()));
    answerer.finish(outcome, timing_ms).await;
}

/// The span of a call, under the caller's where it sent one.
fn span_of(shared: &Shared, call: &CallAttachment, cell: &ForCell) -> tracing::Span {
    let (service, worker) = (shared.service.as_str(), shared.worker.as_str());
    let (id, method, attempt) = (call.id.as_str(), call.method.as_str(), call.attempt);
    let cell = cell.as_deref().unwrap_or(shared.cell.name());
    let span = tracing::info_span!("call", id, method, caller = call.caller, attempt, service, worker, cell);
    crate::trace::continue_from(&span, call.traceparent.as_deref());
    span
}

/// Waits for the handler, for its deadline and for the end of its grace after a cancel, and forwards progress meanwhile.
async fn supervise(
    mut task: tokio::task::JoinHandle<CallResult>,
    (deadline, grace): (Instant, Duration),
    cancelled: &CancellationToken,
    progressed: &mut MailboxReceiver<Payload>,
    answerer: &mut Answerer,
) -> CallResult {
    let mut give_up: Option<Instant> = None;
    loop {
        let end = give_up.unwrap_or(deadline).min(deadline);
        tokio::select! {
            biased;
            done = &mut task => {
                return done.unwrap_or_else(|failure| {
                    tracing::error!(%failure, "a handler panicked");
                    Err(CallError::internal("the handler panicked"))
                });
            }
            () = cancelled.cancelled(), if give_up.is_none() => give_up = Some(Instant::now() + grace),
            () = tokio::time::sleep_until(end) => {
                cancelled.cancel();
                let abort = task.abort_handle();
                if end == deadline {
                    // The caller is answered now; the handler may still clean up.
                    tokio::spawn(async move {
                        drop(tokio::time::timeout(grace, task).await);
                        abort.abort();
                    });
                    return Err(CallError::new(ErrorCode::DeadlineExceeded, "the deadline passed before the work was done"));
                }
                abort.abort();
                return Err(given_up());
            }
            // Last, since there is always some where it comes faster than it can be sent.
            Some(payload) = progressed.recv() => answerer.progress(payload).await,
        }
    }
}

/// Answers a repeated call with the outcome of the first.
async fn join(mut outcome: watch::Receiver<Option<CallResult>>, deadline: Instant, answerer: Answerer) {
    // Taken out of the channel's guard at once, which must not be held across an await.
    let waited = tokio::time::timeout_at(deadline, async { outcome.wait_for(Option::is_some).await.ok().and_then(|o| o.clone()) }).await;
    let outcome = match waited {
        Ok(outcome) => outcome.unwrap_or_else(|| Err(CallError::internal("the call ended without an outcome"))),
        Err(_) => Err(CallError::new(ErrorCode::DeadlineExceeded, "the deadline passed before the work was done")),
    };
    answerer.finish(outcome, BTreeMap::new()).await;
}

#[cfg(test)]
mod tests {
    use async_trait::async_trait;
    use bytes::Bytes;
    use metrics_exporter_prometheus::PrometheusBuilder;
    use repose_proto::Service;
    use repose_proto::scoring::ModelsRequest;

    use super::*;
    use crate::fake::{FakeNetwork, FakeSettings};
    use crate::mailbox::MailboxSender;
    use crate::transport::Replier;
    use crate::{CallOptions, Handler, RuntimeConfig, RuntimeError, Session};

    /// Takes a call, and never ends it.
    struct Endless;

    #[async_trait]
    impl Handler for Endless {
        async fn call(&self, _call: Call) -> CallResult {
            std::future::pending().await
        }
    }

    /// A way back on which every message takes a while.
    struct SlowWay;

    #[async_trait]
    impl Replier for SlowWay {
        async fn reply(&self, _: Payload, _: Bytes) -> Result<(), RuntimeError> {
            tokio::time::sleep(Duration::from_millis(10)).await;
            Ok(())
        }
    }

    async fn telling(progress: MailboxSender<Payload>) -> CallResult {
        loop {
            progress.push(Payload::json(&ModelsRequest {})?);
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_call_that_tells_more_than_its_caller_takes_ends_at_its_deadline_and_with_its_cancel() {
        for is_cancelled in [false, true] {
            let (progress, mut progressed) = mailbox(PROGRESS_CAPACITY);
            let attachment = ReplyAttachment {
                v: limits::VERSION,
                id: "a".to_owned(),
                kind: ReplyKind::Progress,
                n: None,
                worker: None,
                attempt: None,
                timing_ms: BTreeMap::new(),
            };
            let mut answerer = Answerer { replier: Box::new(SlowWay), attachment, journal: None };
            let (deadline, cancelled) = (Instant::now() + Duration::from_secs(5), CancellationToken::new());
            if is_cancelled {
                cancelled.cancel();
            }
            let bounds = (deadline, Duration::from_secs(1));
            let supervised = supervise(tokio::spawn(telling(progress)), bounds, &cancelled, &mut progressed, &mut answerer);
            let ended = tokio::time::timeout(Duration::from_secs(20), supervised).await.expect("an end");
            let code = if is_cancelled { ErrorCode::Cancelled } else { ErrorCode::DeadlineExceeded };
            assert_eq!(ended.map_err(|error| error.code), Err(code));
        }
    }

    /// Takes a second for every call.
    struct Slow;

    #[async_trait]
    impl Handler for Slow {
        async fn call(&self, call: Call) -> CallResult {
            tokio::time::sleep(Duration::from_secs(1)).await;
            Ok(call.payload)
        }
    }

    #[tokio::test(start_paused = true)]
    async fn who_finds_no_place_comes_back_when_half_of_the_open_calls_have_ended_however_many_are_served_at_once() {
        let network = FakeNetwork::new(FakeSettings::default());
        let mut config = RuntimeConfig::default();
        config.worker.max_open_calls = 8;
        let session = |node: &str| Session::over(network.node(node), config.clone()).unwrap();
        let _server = session("worker").start(Service::Inference, Arc::new(Slow)).await.unwrap();
        let caller = session("caller").caller(Service::Inference).await.unwrap();
        caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
        let call = || caller.call("models", Payload::json(&ModelsRequest {}).unwrap(), CallOptions::within(Duration::from_secs(10)));
        call().await.unwrap();
        let open = futures::future::join_all((0..8).map(|_| call()));
        let refused = async {
            tokio::time::sleep(Duration::from_millis(100)).await;
            call().await.unwrap_err().retry_after_ms
        };
        let (open, refused) = tokio::join!(open, refused);
        assert!(open.iter().all(Result::is_ok));
        assert!(refused.is_some_and(|ms| (450..=550).contains(&ms)), "{refused:?}");
    }

    /// Calls a worker with a single place twice.
    async fn second_call_is_refused() {
        let network = FakeNetwork::new(FakeSettings::default());
        let mut config = RuntimeConfig::default();
        config.worker.max_open_calls = 1;
        let session = |node: &str| Session::over(network.node(node), config.clone()).unwrap();
        let _server = session("worker").start(Service::Inference, Arc::new(Endless)).await.unwrap();
        let caller = session("caller").caller(Service::Inference).await.unwrap();
        caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
        let call = || caller.call("models", Payload::json(&ModelsRequest {}).unwrap(), CallOptions::within(Duration::from_secs(10)));
        let first = call();
        let second = async {
            // The first is there by then.
            tokio::time::sleep(Duration::from_secs(1)).await;
            call().await
        };
        tokio::select! {
            ended = first => panic!("it never ends: {ended:?}"),
            refused = second => assert_eq!(refused.unwrap_err().code, ErrorCode::ResourceExhausted),
        }
    }

    #[test]
    fn a_call_for_which_there_is_no_place_counts_as_refused() {
        let recorder = PrometheusBuilder::new().build_recorder();
        metrics::with_local_recorder(&recorder, || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap();
            runtime.block_on(second_call_is_refused());
        });
        let told = recorder.handle().render();
        assert!(told.contains("repose_refused_total{queue=\"inference\"} 1"), "{told}");
    }
}
