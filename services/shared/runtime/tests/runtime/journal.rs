//! Copies of calls for whoever records: all of them while somebody does, none otherwise, and at nobody's expense.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use crate::common::{Network, Oddities, SERVICE, read, word};
use repose_proto::load::WorkerLoad;
use repose_proto::{CallAttachment, JournalEntry, JournalKind, ReplyAttachment, ReplyKind};
use repose_runtime::{CallOptions, CancellationToken, RuntimeConfig, Session, SessionMode, Subscription};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;

fn options() -> CallOptions {
    CallOptions::within(Duration::from_secs(10))
}

/// Waits until a worker says whether it copies.
async fn told(loads: &mut Subscription, journals: bool) {
    while loads.recv().await.expect("a load").payload.decode_json::<WorkerLoad>().expect("a load").journals != journals {}
}

async fn next(entries: &mut Subscription) -> JournalEntry {
    let sample = entries.recv().await.expect("a copy");
    JournalEntry::from_bulk(&sample.payload.decode_bulk(JournalEntry::SCHEMA).expect("bulk")).expect("an entry")
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_and_their_replies_are_copied_as_they_were_while_somebody_records() {
    let network = Network::routed(RuntimeConfig::default()).await;
    let (_session, server) = network.worker(&Arc::new(Oddities::default())).await;
    let caller = network.caller(1).await;
    let recorder = network.session().await;
    let cell = recorder.cell().clone();
    let mut loads = recorder.subscribe_queue(&cell.loads(SERVICE), 16).await.unwrap();
    let mut entries = recorder.subscribe_queue(&cell.journals(), 64).await.unwrap();

    caller.call("echo", word("before"), options()).await.unwrap();
    let token = recorder.transport().declare_alive(&cell.live_recorder("r-1")).await.unwrap();
    told(&mut loads, true).await;
    caller.call("count", word("counted"), options()).await.unwrap();
    let refused = caller.call("refuse", word("refused"), options()).await.unwrap_err();

    let call = next(&mut entries).await;
    let asked = CallAttachment::decode(call.attachment.as_bytes()).unwrap();
    assert_eq!((call.seq, call.kind, asked.method.as_str()), (0, JournalKind::Call, "count"));
    assert_eq!(call.payload, word("counted"), "as it was on the wire");
    for n in 1..=6 {
        let reply = next(&mut entries).await;
        let answered = ReplyAttachment::decode(reply.attachment.as_bytes()).unwrap();
        assert_eq!((reply.seq, reply.kind, &answered.id), (n, JournalKind::Reply, &asked.id));
        assert_eq!(answered.kind, if n < 6 { ReplyKind::Progress } else { ReplyKind::Result });
        assert_eq!(answered.worker.as_deref(), if n < 6 { None } else { Some(server.worker()) });
    }
    assert_eq!(next(&mut entries).await.kind, JournalKind::Call);
    let error: repose_proto::CallError = next(&mut entries).await.payload.decode_json().unwrap();
    assert_eq!((error.code, error.field), (refused.code, refused.field));

    drop(token);
    told(&mut loads, false).await;
    caller.call("echo", word("after"), options()).await.unwrap();
    // Whoever records again hears nothing of the time between: the numbers go on.
    let _token = recorder.transport().declare_alive(&cell.live_recorder("r-2")).await.unwrap();
    told(&mut loads, true).await;
    caller.call("echo", word("again"), options()).await.unwrap();
    let again = next(&mut entries).await;
    assert_eq!((again.seq, &again.payload), (9, &word("again")));
}

/// What lies between a recorder and its router.
struct Wire {
    address: SocketAddr,
    /// From then on nothing that the router sends is read; what the recorder sends arrives, so that the router takes it for alive.
    deaf: CancellationToken,
    _links: JoinSet<()>,
}

impl Wire {
    async fn to(router: String) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let (address, deaf) = (listener.local_addr().unwrap(), CancellationToken::new());
        let (mut accepting, turns_deaf) = (JoinSet::new(), deaf.clone());
        accepting.spawn(async move {
            let mut links = JoinSet::new();
            loop {
                let (near, _) = listener.accept().await.unwrap();
                links.spawn(carry(near, TcpStream::connect(&router).await.unwrap(), turns_deaf.clone()));
            }
        });
        Self { address, deaf, _links: accepting }
    }
}

async fn carry(recorder: TcpStream, router: TcpStream, deaf: CancellationToken) {
    let ((mut from_recorder, mut to_recorder), (mut from_router, mut to_router)) = (recorder.into_split(), router.into_split());
    let there = tokio::io::copy(&mut from_recorder, &mut to_router);
    let back = async {
        tokio::select! {
            _ = tokio::io::copy(&mut from_router, &mut to_recorder) => {}
            () = deaf.cancelled() => std::future::pending::<()>().await,
        }
    };
    let _ended = tokio::join!(there, back);
}

/// A session whose links are believed in for longer than a test takes, however silent they are.
async fn patient(mode: SessionMode, endpoint: String) -> Session {
    let mut config = RuntimeConfig::default();
    (config.session.mode, config.session.lease_ms) = (mode, 60_000);
    match mode {
        SessionMode::Router => config.session.listen = vec![endpoint],
        _ => config.session.connect = vec![endpoint],
    }
    Session::open(config).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_are_answered_while_a_recorder_reads_nothing() {
    let router = patient(SessionMode::Router, "tcp/127.0.0.1:0".to_owned()).await;
    let endpoint = router.locators().await.swap_remove(0);
    let wire = Wire::to(endpoint.strip_prefix("tcp/").expect("TCP").to_owned()).await;
    let [worker, asking] = [patient(SessionMode::Client, endpoint.clone()).await, patient(SessionMode::Client, endpoint).await];
    let recorder = patient(SessionMode::Client, format!("tcp/{}", wire.address)).await;
    let _server = worker.start(SERVICE, Arc::new(Oddities::default())).await.unwrap();
    let caller = asking.caller(SERVICE).await.unwrap();
    caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    let mut loads = asking.subscribe_queue(&asking.cell().loads(SERVICE), 16).await.unwrap();
    let mut entries = recorder.subscribe_queue(&recorder.cell().journals(), 64).await.unwrap();
    let _token = recorder.transport().declare_alive(&recorder.cell().live_recorder("r-1")).await.unwrap();
    told(&mut loads, true).await;
    caller.call("echo", word("heard"), options()).await.unwrap();
    assert_eq!(next(&mut entries).await.payload, word("heard"));
    wire.deaf.cancel();
    // Copies of 64 MB, many times what a link and its buffers hold.
    let text = "x".repeat(2 << 20);
    for _ in 0..16 {
        // Less than the five seconds for which a link is waited with before it is closed.
        let answer = caller.call("echo", word(&text), CallOptions::within(Duration::from_secs(4))).await.unwrap();
        assert_eq!(read(&answer.payload).len(), text.len());
    }
}
