//! Asking every worker: while there is none yet the wait is part of the deadline, and ends where the caller gives up; and one that does not answer counts
//! for more than another that has nothing. On the fake network, whose clock jumps.

use std::sync::Arc;
use std::time::Duration;

use crate::common::{Oddities, SERVICE, word};
use repose_proto::ErrorCode;
use repose_runtime::fake::{FakeNetwork, FakeSettings};
use repose_runtime::{CallOptions, Caller, RuntimeConfig, Session};
use tokio::time::Instant;

fn session(network: &FakeNetwork, node: &str) -> Session {
    Session::over(network.node(node), RuntimeConfig::default()).unwrap()
}

/// How asking everybody for a method ends, and after how long.
async fn ended(caller: &Caller, method: &str, options: &CallOptions) -> (ErrorCode, Duration) {
    let began = Instant::now();
    let error = caller.call_any(method, &word(""), options).await.unwrap_err();
    (error.code, began.elapsed())
}

#[tokio::test(start_paused = true)]
async fn the_wait_for_a_first_worker_is_part_of_the_deadline() {
    let network = FakeNetwork::new(FakeSettings::default());
    let caller = session(&network, "caller").caller(SERVICE).await.unwrap();
    let options = CallOptions::within(Duration::from_millis(1500));
    let late = async {
        tokio::time::sleep(Duration::from_millis(900)).await;
        session(&network, "worker").start(SERVICE, Arc::new(Oddities::default())).await.unwrap()
    };
    // The worker takes the call, and nothing ever releases what it holds.
    let (_server, (code, took)) = tokio::join!(late, ended(&caller, "held", &options));
    assert_eq!(code, ErrorCode::DeadlineExceeded);
    assert!(took <= Duration::from_millis(1510), "{took:?}");
}

#[tokio::test(start_paused = true)]
async fn whoever_gives_up_waits_for_no_first_worker() {
    let network = FakeNetwork::new(FakeSettings::default());
    let caller = session(&network, "caller").caller(SERVICE).await.unwrap();
    let options = CallOptions::within(Duration::from_secs(10));
    let giving_up = async {
        tokio::time::sleep(Duration::from_millis(300)).await;
        options.cancel.cancel();
    };
    let ((code, took), ()) = tokio::join!(ended(&caller, "echo", &options), giving_up);
    assert_eq!(code, ErrorCode::Cancelled);
    assert!(took <= Duration::from_millis(310), "{took:?}");
}

#[tokio::test(start_paused = true)]
async fn that_one_worker_has_nothing_does_not_say_it_of_one_that_does_not_answer() {
    let network = FakeNetwork::new(FakeSettings::default());
    let mut servers = Vec::new();
    for node in ["empty", "silent"] {
        servers.push(session(&network, node).start(SERVICE, Arc::new(Oddities::default())).await.unwrap());
    }
    let caller = session(&network, "caller").caller(SERVICE).await.unwrap();
    caller.wait_for_workers(2, Duration::from_secs(10)).await.unwrap();
    let options = CallOptions::within(Duration::from_secs(3));
    assert_eq!(ended(&caller, "refuse", &options).await.0, ErrorCode::NotFound);
    network.stop("silent");
    assert_eq!(ended(&caller, "refuse", &options).await.0, ErrorCode::DeadlineExceeded);
}
