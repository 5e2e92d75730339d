//! Copies of calls for whoever records: all of them while somebody does, and none otherwise.

use std::sync::Arc;
use std::time::Duration;

use crate::common::{Network, Oddities, SERVICE, word};
use repose_proto::load::WorkerLoad;
use repose_proto::{CallAttachment, JournalEntry, JournalKind, ReplyAttachment, ReplyKind};
use repose_runtime::{CallOptions, RuntimeConfig, Subscription};

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
