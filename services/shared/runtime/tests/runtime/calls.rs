//! Calls over real Zenoh sessions, embedded and through a router on a TCP port: every way in which one can end.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::common::{Network, Oddities, SERVICE, read, within, word};
use bytes::Bytes;
use futures::future::join_all;
use repose_proto::{ErrorCode, Payload, Priority, ReplyAttachment, ReplyKind, limits};
use repose_runtime::transport::{OutgoingQuery, ReplyEvent};
use repose_runtime::{CallOptions, CancellationToken, RuntimeConfig, Session, Traffic};

fn options() -> CallOptions {
    CallOptions::within(Duration::from_secs(10))
}

/// Every ending that needs one worker, on one network.
async fn every_ending(network: &Network) {
    let handler = Arc::new(Oddities::default());
    let (_session, server) = network.worker(&handler).await;
    let caller = network.caller(1).await;

    let answer = caller.call("echo", word("hello"), options()).await.unwrap();
    assert_eq!((read(&answer.payload), answer.worker.as_str(), answer.attempts), ("hello".to_owned(), server.worker(), 1));

    let (progress, mut progressed) = tokio::sync::mpsc::channel(16);
    let counted = caller.call("count", word(""), CallOptions { progress: Some(progress), ..options() }).await.unwrap();
    let mut seen = Vec::new();
    while let Some(payload) = progressed.recv().await {
        seen.push(read(&payload));
    }
    assert_eq!(seen, ["0", "1", "2", "3", "4"]);
    assert!((counted.timing_ms["counting"] - 1.5).abs() < 1e-9 && counted.timing_ms.contains_key("total"));

    let refused = caller.call("refuse", word(""), options()).await.unwrap_err();
    assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::NotFound, Some("text")));
    let unknown = caller.call("dance", word(""), options()).await.unwrap_err();
    assert_eq!((unknown.code, unknown.field.as_deref()), (ErrorCode::InvalidArgument, Some("method")));
    let panicked = caller.call("panic", word(""), options()).await.unwrap_err();
    assert_eq!(panicked.code, ErrorCode::Internal);
    let garbage = Payload { encoding: "application/json;repose.Word.v1".to_owned(), bytes: Bytes::from_static(b"{\"txet\":\"\"}") };
    let garbage = caller.call("strict", garbage, options()).await.unwrap_err();
    assert_eq!((garbage.code, garbage.field.as_deref()), (ErrorCode::InvalidArgument, Some("txet")));

    let oversize = Payload { encoding: String::new(), bytes: vec![0; limits::MAX_MESSAGE_BYTES + 1].into() };
    let oversize = caller.call("echo", oversize, options()).await.unwrap_err();
    assert_eq!((oversize.code, oversize.field.as_deref()), (ErrorCode::InvalidArgument, Some("payload")));
    let large = caller.call("large", word(""), options()).await.unwrap_err();
    assert_eq!(large.code, ErrorCode::Internal);

    within(Duration::from_secs(2), async || {
        let overdue = caller.call("held", word(""), CallOptions::within(Duration::from_millis(200))).await.unwrap_err();
        assert_eq!(overdue.code, ErrorCode::DeadlineExceeded);
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_ending_in_one_process() {
    every_ending(&Network::embedded(RuntimeConfig::default()).await).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_ending_through_a_router() {
    every_ending(&Network::routed(RuntimeConfig::default()).await).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_of_replies_ends_once_its_query_was_given_up() {
    for network in [Network::embedded(RuntimeConfig::default()).await, Network::routed(RuntimeConfig::default()).await] {
        let handler = Arc::new(Oddities::default());
        let (_session, server) = network.worker(&handler).await;
        network.caller(1).await;
        let key = network.caller.cell().call(SERVICE, server.worker());
        let attachment = Bytes::from_static(b"{\"v\":1,\"id\":\"given-up\",\"method\":\"held\",\"remaining_ms\":60000}");
        let query = OutgoingQuery { payload: word(""), attachment, priority: Priority::Interactive, timeout: Duration::from_millis(200) };
        let mut replies = network.caller.transport().query(&key, query).await.unwrap();
        handler.wait_for(&handler.started, 1).await;
        assert!(matches!(replies.next().await, Some(ReplyEvent::TimedOut)));
        let after = tokio::time::timeout(Duration::from_secs(10), replies.next()).await.expect("it ends by itself");
        assert!(after.is_none(), "{after:?}");
        handler.release.notify_one();
    }
}

/// The test's own future runs outside of the runtime's tasks (`block_on`), as a command's does: whatever blocks in it may take its wake-ups.
#[tokio::test(flavor = "multi_thread")]
async fn the_end_of_every_query_is_heard_of_where_many_end_at_once() {
    let network = Network::routed(RuntimeConfig::default()).await;
    let mut sessions = Vec::new();
    for _ in 0..8 {
        sessions.push(network.session().await);
    }
    let patience = Duration::from_secs(10);
    for round in 0..200 {
        let asked = join_all(sessions.iter().map(|session| async {
            let query = OutgoingQuery { payload: word(""), attachment: Bytes::new(), priority: Priority::Batch, timeout: patience };
            let end = session.transport().query("repose/v1/nowhere", query).await.unwrap().next().await;
            assert!(end.is_none(), "{end:?}");
        }));
        // The timer wakes what has ended and was not told so: only the time shows it.
        let began = Instant::now();
        tokio::time::timeout(patience, asked).await.expect("all end");
        assert!(began.elapsed() < patience, "round {round} ended when the timer woke it");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_is_seen_can_be_called_at_once() {
    let mut config = RuntimeConfig::default();
    config.worker.drain_notice_ms = 10;
    // A session that opens slowly is waited for: what is asked is what happens once the worker is seen.
    config.caller.worker_wait_ms = 8000;
    let network = Network::routed(config).await;
    let caller = network.caller.caller(SERVICE).await.unwrap();
    for round in 0..20 {
        let handler = Arc::new(Oddities::default());
        let session = network.session().await;
        let calling = caller.call("echo", word("first"), CallOptions { idempotent: false, ..options() });
        let (started, answer) = tokio::join!(session.start(SERVICE, handler.clone()), calling);
        // One attempt: an empty first reply stream would fail it.
        assert_eq!(read(&answer.unwrap_or_else(|e| panic!("round {round}: {e}")).payload), "first");
        started.unwrap().drain().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancel_reaches_the_handler_and_ends_the_call() {
    let network = Network::routed(RuntimeConfig::default()).await;
    let handler = Arc::new(Oddities::default());
    let _worker = network.worker(&handler).await;
    let caller = network.caller(1).await;
    let cancel = CancellationToken::new();
    let call = tokio::spawn({
        let (caller, options) = (caller.clone(), CallOptions { cancel: cancel.clone(), ..options() });
        async move { caller.call("patient", word(""), options).await }
    });
    handler.wait_for(&handler.started, 1).await;
    cancel.cancel();
    assert_eq!(call.await.unwrap().unwrap_err().code, ErrorCode::Cancelled);
    handler.wait_for(&handler.cancelled, 1).await;

    // A call that must not be repeated hears what became of it.
    let cancel = CancellationToken::new();
    let call = tokio::spawn({
        let (caller, options) = (caller.clone(), CallOptions { cancel: cancel.clone(), idempotent: false, ..options() });
        async move { caller.call("patient", word(""), options).await }
    });
    handler.wait_for(&handler.started, 2).await;
    cancel.cancel();
    assert_eq!(read(&call.await.unwrap().unwrap().payload), "stopped");

    // A caller that goes away cancels too.
    let forgotten = tokio::spawn({
        let caller = caller.clone();
        async move { caller.call("patient", word(""), options()).await }
    });
    handler.wait_for(&handler.started, 3).await;
    forgotten.abort();
    handler.wait_for(&handler.cancelled, 3).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_call_has_told_its_worker_though_its_session_is_closed_next() {
    // A cancel that nobody waits for is often fast enough, too: hence several rounds.
    for round in 0..4 {
        let network = Network::routed(RuntimeConfig::default()).await;
        let handler = Arc::new(Oddities::default());
        let _worker = network.worker(&handler).await;
        let caller = network.caller(1).await;
        let cancel = CancellationToken::new();
        let options = CallOptions { cancel: cancel.clone(), ..CallOptions::within(Duration::from_secs(60)) };
        let call = tokio::spawn(async move { caller.call("patient", word(""), options).await });
        handler.wait_for(&handler.started, 1).await;
        cancel.cancel();
        assert_eq!(call.await.unwrap().unwrap_err().code, ErrorCode::Cancelled);
        network.caller.close().await.unwrap();
        let told = tokio::time::timeout(Duration::from_secs(10), handler.wait_for(&handler.cancelled, 1)).await;
        assert!(told.is_ok(), "round {round}: its worker goes on");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancel_that_comes_first_still_counts() {
    let network = Network::embedded(RuntimeConfig::default()).await;
    let handler = Arc::new(Oddities::default());
    let (session, server) = network.worker(&handler).await;
    let caller = network.caller(1).await;
    let key = session.cell().cancel(SERVICE, server.worker(), "early");
    session.put(&key, Payload { encoding: String::new(), bytes: Bytes::new() }, Traffic::Call(Priority::Interactive)).await.unwrap();
    let ended = loop {
        // The cancel and the call take different ways; until it has arrived, the call under that id is simply answered.
        match caller.call("echo", word(""), CallOptions { id: Some("early".to_owned()), ..options() }).await {
            Ok(_) => tokio::task::yield_now().await,
            Err(error) => break error,
        }
    };
    assert_eq!(ended.code, ErrorCode::Cancelled);
}

#[tokio::test(flavor = "multi_thread")]
async fn more_calls_than_may_be_open_are_refused_at_once() {
    let mut config = RuntimeConfig::default();
    config.worker.max_open_calls = 1;
    config.caller.retries = 0;
    let network = Network::embedded(config).await;
    let handler = Arc::new(Oddities::default());
    let _worker = network.worker(&handler).await;
    let caller = network.caller(1).await;
    let held = tokio::spawn({
        let caller = caller.clone();
        async move { caller.call("held", word(""), options()).await }
    });
    handler.wait_for(&handler.started, 1).await;
    let refused = caller.call("echo", word(""), options()).await.unwrap_err();
    assert_eq!(refused.code, ErrorCode::ResourceExhausted);
    assert!(refused.retryable && refused.retry_after_ms.is_some());
    handler.release.notify_one();
    held.await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refused_batch_call_stands_for_others_like_it_and_for_no_others() {
    let mut config = RuntimeConfig::default();
    config.worker.max_open_calls = 1;
    // The worker asks to be left alone for longer than this test takes.
    config.caller.heed_refusals_ms = 60_000;
    let network = Network::embedded(config).await;
    let handler = Arc::new(Oddities { service_ms: 1e5, ..Oddities::default() });
    let _worker = network.worker(&handler).await;
    let caller = network.caller(1).await;
    let batch = || CallOptions { priority: Priority::Batch, ..options() };
    let held = tokio::spawn({
        let caller = caller.clone();
        async move { caller.call("held", word(""), options()).await }
    });
    handler.wait_for(&handler.started, 1).await;
    let refused = caller.call("echo", word(""), batch()).await.unwrap_err();
    assert!(refused.message.contains("open already"), "by the worker: {refused}");
    handler.release.notify_one();
    held.await.unwrap().unwrap();
    let refused = caller.call("echo", word(""), batch()).await.unwrap_err();
    assert_eq!(refused.code, ErrorCode::ResourceExhausted);
    assert!(refused.message.contains("asked again") && refused.retry_after_ms.is_some(), "by the caller: {refused}");
    let patient = CallOptions { deadline: options().deadline * 2, ..batch() };
    caller.call("echo", word(""), patient).await.expect("it may wait longer than the one that was refused");
    caller.call("echo", word(""), options()).await.expect("an interactive call always asks");
    let (_session, _second) = network.worker(&handler).await;
    caller.wait_for_workers(2, Duration::from_secs(10)).await.unwrap();
    caller.call("echo", word(""), batch()).await.expect("the second worker has refused nothing");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_id_is_computed_once_and_a_different_request_under_it_refused() {
    let network = Network::embedded(RuntimeConfig::default()).await;
    let handler = Arc::new(Oddities::default());
    let _worker = network.worker(&handler).await;
    let caller = network.caller(1).await;
    let execute = |text: &str| {
        let options = CallOptions { id: Some("once".to_owned()), ..CallOptions::at_most_once(Duration::from_secs(5)) };
        let (caller, request) = (caller.clone(), word(text));
        async move { caller.call("execute", request, options).await }
    };
    let (first, second) = tokio::join!(execute("a"), execute("a"));
    assert_eq!((read(&first.unwrap().payload), read(&second.unwrap().payload)), ("a".to_owned(), "a".to_owned()));
    assert_eq!(read(&execute("a").await.unwrap().payload), "a");
    assert_eq!(execute("b").await.unwrap_err().code, ErrorCode::FailedPrecondition);
    assert_eq!(handler.started.load(std::sync::atomic::Ordering::SeqCst), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_refused_for_now_can_be_asked_again_under_the_same_id() {
    let network = Network::embedded(RuntimeConfig::default()).await;
    let handler = Arc::new(Oddities::default());
    let _worker = network.worker(&handler).await;
    let caller = network.caller(1).await;
    let execute = || {
        let options = CallOptions { id: Some("later".to_owned()), ..CallOptions::at_most_once(Duration::from_secs(5)) };
        caller.call("execute-later", word("a"), options)
    };
    let refused = execute().await.unwrap_err();
    assert!(refused.code == ErrorCode::Unavailable && refused.retryable, "{refused}");
    for _ in 0..2 {
        assert_eq!(read(&execute().await.unwrap().payload), "a");
    }
    assert_eq!(handler.started.load(std::sync::atomic::Ordering::SeqCst), 2, "what came of it in the end is kept");
}

/// Sends an attachment as it is and returns the terminal reply's attachment and error.
async fn raw(session: &Session, worker: &str, attachment: &'static [u8]) -> (ReplyAttachment, repose_proto::CallError) {
    let key = session.cell().call(SERVICE, worker);
    let attachment = Bytes::from_static(attachment);
    let query = OutgoingQuery { payload: word(""), attachment, priority: Priority::Interactive, timeout: Duration::from_secs(5) };
    let mut replies = session.transport().query(&key, query).await.unwrap();
    let Some(ReplyEvent::Reply { payload, attachment }) = replies.next().await else { panic!("no reply") };
    assert!(replies.next().await.is_none(), "the stream must end after the terminal reply");
    (ReplyAttachment::decode(&attachment).unwrap(), payload.decode_json().unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn an_attachment_that_breaks_the_contract_is_answered_with_its_field() {
    let network = Network::routed(RuntimeConfig::default()).await;
    let handler = Arc::new(Oddities::default());
    let (_session, server) = network.worker(&handler).await;
    network.caller(1).await;
    let cases: [(&'static [u8], &str); 6] = [
        (b"", "attachment"),
        (b"{", "attachment"),
        (br#"{"v":2,"id":"a","method":"echo","remaining_ms":100,"news":1}"#, "v"),
        (br#"{"v":1,"id":"a","method":"echo","remaining_ms":0}"#, "remaining_ms"),
        (br#"{"v":1,"id":"a","method":"echo"}"#, "remaining_ms"),
        (br#"{"v":1,"id":"a/b","method":"echo","remaining_ms":100}"#, "id"),
    ];
    for (attachment, field) in cases {
        let (reply, error) = raw(&network.caller, server.worker(), attachment).await;
        assert_eq!((reply.kind, reply.worker.as_deref()), (ReplyKind::Error, Some(server.worker())));
        assert_eq!((error.code, error.field.as_deref()), (ErrorCode::InvalidArgument, Some(field)), "{error}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_call_whose_worker_dies_is_answered_by_another() {
    let network = Network::routed(RuntimeConfig::default()).await;
    let (doomed, other) = (Arc::new(Oddities::default()), Arc::new(Oddities { work_ms: 1, ..Oddities::default() }));
    let (doomed_session, doomed_server) = network.worker(&doomed).await;
    let caller = network.caller(1).await;
    let call = tokio::spawn({
        let caller = caller.clone();
        async move { caller.call("held", word("x"), options()).await }
    });
    doomed.wait_for(&doomed.started, 1).await;
    let (_session, server) = network.worker(&other).await;
    caller.wait_for_workers(2, Duration::from_secs(5)).await.unwrap();
    other.release.notify_one();
    // Not drained: the link goes while the call is open.
    doomed_session.close().await.unwrap();
    drop(doomed_server);
    let answer = call.await.unwrap().unwrap();
    assert_eq!((answer.worker.as_str(), answer.attempts), (server.worker(), 2));
}

#[tokio::test(flavor = "multi_thread")]
async fn tokens_that_nobody_stands_behind_cost_no_call_its_answer() {
    let network = Network::routed(RuntimeConfig::default()).await;
    let fakes = network.session().await;
    let mut tokens = Vec::new();
    for i in 0..500 {
        tokens.push(fakes.transport().declare_alive(&fakes.cell().live(SERVICE, &format!("fake-{i}"))).await.unwrap());
    }
    let caller = network.caller.caller(SERVICE).await.unwrap();
    while caller.workers().len() < tokens.len() {
        tokio::task::yield_now().await;
    }
    // Nobody but fakes: the call ends as one without workers does, and soon.
    let started = Instant::now();
    let nobody = caller.call("echo", word(""), options()).await.unwrap_err();
    assert_eq!(nobody.code, ErrorCode::Unavailable);
    assert!(started.elapsed() < Duration::from_secs(5), "{:?}", started.elapsed());
    let (_session, server) = network.worker(&Arc::new(Oddities::default())).await;
    caller.wait_for_workers(1, Duration::from_secs(5)).await.unwrap();
    for _ in 0..20 {
        assert_eq!(caller.call("echo", word("x"), options()).await.unwrap().worker, server.worker());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn draining_finishes_what_is_open_and_refuses_what_comes() {
    let mut config = RuntimeConfig::default();
    config.caller.retries = 0;
    let network = Network::routed(config).await;
    let handler = Arc::new(Oddities::default());
    let (_session, server) = network.worker(&handler).await;
    let caller = network.caller(1).await;
    let open = tokio::spawn({
        let caller = caller.clone();
        async move { caller.call("held", word(""), options()).await }
    });
    handler.wait_for(&handler.started, 1).await;
    let draining = tokio::spawn(server.drain());
    while !caller.workers().is_empty() {
        tokio::task::yield_now().await;
    }
    let refused = caller.call("echo", word(""), options()).await.unwrap_err();
    assert_eq!(refused.code, ErrorCode::Unavailable);
    handler.release.notify_one();
    assert_eq!(read(&open.await.unwrap().unwrap().payload), "released");
    draining.await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_end_of_a_drain_cuts_off_goes_to_another_worker_unless_it_may_have_been_done() {
    let mut config = RuntimeConfig::default();
    (config.worker.drain_ms, config.worker.drain_notice_ms) = (50, 10);
    let network = Network::routed(config).await;
    let [first, second] = [(); 2].map(|()| Arc::new(Oddities::default()));
    let (_session, server) = network.worker(&first).await;
    let caller = network.caller(1).await;
    let call = |method: &'static str, idempotent: bool| {
        let (caller, options) = (caller.clone(), CallOptions { idempotent, ..options() });
        tokio::spawn(async move { caller.call(method, word(""), options).await })
    };
    let (again, once) = (call("obedient", true), call("execute-obedient", false));
    first.wait_for(&first.started, 2).await;
    let (_session, _server) = network.worker(&second).await;
    caller.wait_for_workers(2, Duration::from_secs(10)).await.unwrap();
    server.drain().await;
    tokio::time::timeout(Duration::from_secs(20), second.wait_for(&second.started, 1)).await.unwrap();
    again.abort();
    let unknown = once.await.unwrap().unwrap_err();
    assert_eq!((unknown.code, unknown.retryable), (ErrorCode::Unavailable, false), "{unknown}");
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_go_where_they_are_pinned_and_can_ask_everyone() {
    let network = Network::routed(RuntimeConfig::default()).await;
    let [a, b] = ["aa", "bb"].map(|weights| Arc::new(Oddities { weights: weights.to_owned(), ..Oddities::default() }));
    let (_session_a, server_a) = network.worker(&a).await;
    let (_session_b, server_b) = network.worker(&b).await;
    let caller = network.caller(2).await;
    for _ in 0..5 {
        let pinned = CallOptions { worker: Some(server_b.worker().to_owned()), ..options() };
        assert_eq!(caller.call("echo", word(""), pinned).await.unwrap().worker, server_b.worker());
        let accept = CallOptions { accept: Some(Arc::new(|load| load.weights_hash == "aa")), ..options() };
        assert_eq!(caller.call("echo", word(""), accept).await.unwrap().worker, server_a.worker());
    }
    let nobody =
        CallOptions { accept: Some(Arc::new(|load| load.weights_hash == "cc")), ..CallOptions::within(Duration::from_millis(100)) };
    assert_eq!(caller.call("echo", word(""), nobody).await.unwrap_err().code, ErrorCode::DeadlineExceeded);
    assert_eq!(read(&caller.call_any("echo", &word("any"), &options()).await.unwrap().payload), "any");
    assert_eq!(caller.call_any("refuse", &word(""), &options()).await.unwrap_err().code, ErrorCode::NotFound);
}

#[tokio::test(flavor = "multi_thread")]
async fn large_requests_arrive_whole() {
    let network = Network::routed(RuntimeConfig::default()).await;
    let _worker = network.worker(&Arc::new(Oddities::default())).await;
    let caller = network.caller(1).await;
    let text = "x".repeat(8 << 20);
    assert_eq!(read(&caller.call("echo", word(&text), options()).await.unwrap().payload).len(), text.len());
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_are_spread_over_workers_that_take_as_long() {
    let network = Network::routed(RuntimeConfig::default()).await;
    let handlers = [(); 2].map(|()| Arc::new(Oddities { work_ms: 20, ..Oddities::default() }));
    let _first = network.worker(&handlers[0]).await;
    let _second = network.worker(&handlers[1]).await;
    let caller = network.caller(2).await;
    let calls = (0..40).map(|_| caller.call("work", word("w"), options()));
    for answer in join_all(calls).await {
        answer.unwrap();
    }
    let counts = handlers.map(|h| h.started.load(std::sync::atomic::Ordering::SeqCst));
    assert!(counts.iter().all(|c| *c >= 10), "uneven: {counts:?}");
}
