//! The router goes away and comes back, at the same address: calls wait for it within their deadline.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::common::{Oddities, SERVICE, read, within, word};
use repose_proto::ErrorCode;
use repose_runtime::{CallOptions, RuntimeConfig, Session, SessionMode};

async fn router(endpoint: &str) -> Session {
    let mut config = RuntimeConfig::default();
    config.session.mode = SessionMode::Router;
    config.session.listen = vec![endpoint.to_owned()];
    loop {
        // The port is free a moment after its last owner has closed.
        if let Ok(router) = Session::open(config.clone()).await {
            return router;
        }
        tokio::task::yield_now().await;
    }
}

async fn client(endpoints: &[String]) -> Session {
    let mut config = RuntimeConfig::default();
    config.session.mode = SessionMode::Client;
    config.session.connect = endpoints.to_vec();
    Session::open(config).await.unwrap()
}

/// A free port, until somebody takes it.
fn endpoint() -> String {
    format!("tcp/{}", std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap())
}

async fn rides_out(outage: Duration) {
    let endpoint = endpoint();
    let first = router(&endpoint).await;
    let (worker, asking) = (client(std::slice::from_ref(&endpoint)).await, client(std::slice::from_ref(&endpoint)).await);
    let handler = Arc::new(Oddities { work_ms: 200, ..Oddities::default() });
    let _server = worker.start(SERVICE, handler.clone()).await.unwrap();
    let caller = asking.caller(SERVICE).await.unwrap();
    caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    // Some are under way when the router goes, some begin without it, one at a time that it is back.
    let call = |text: String| {
        let (caller, deadline) = (caller.clone(), outage + Duration::from_secs(15));
        tokio::spawn(async move { caller.call("work", word(&text), CallOptions::within(deadline)).await })
    };
    let mut calls: Vec<_> = (0..4).map(|i| call(format!("under way {i}"))).collect();
    handler.wait_for(&handler.started, 1).await;
    first.close().await.unwrap();
    // Forty in all, fewer than a worker lets be open at once: they all come when the router is back.
    let period = (outage + Duration::from_secs(2)) / 40;
    let (gone, mut n) = (Instant::now(), 0);
    let mut second = None;
    while gone.elapsed() < outage + Duration::from_secs(2) {
        calls.push(call(format!("call {n}")));
        n += 1;
        tokio::time::sleep(period).await;
        if second.is_none() && gone.elapsed() >= outage {
            second = Some(router(&endpoint).await);
        }
    }
    for (i, call) in calls.into_iter().enumerate() {
        let answered = call.await.unwrap();
        assert!(answered.is_ok(), "call {i}: {}", answered.unwrap_err());
    }
    assert_eq!(caller.duplicates(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_ride_out_an_outage_of_one_second() {
    rides_out(Duration::from_secs(1)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_ride_out_an_outage_of_five_seconds() {
    rides_out(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_ride_out_an_outage_of_twenty_seconds() {
    rides_out(Duration::from_secs(20)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_call_whose_deadline_lies_within_the_outage_ends_by_it_and_says_that_the_router_is_away() {
    let endpoint = endpoint();
    let router = router(&endpoint).await;
    let (worker, asking) = (client(std::slice::from_ref(&endpoint)).await, client(std::slice::from_ref(&endpoint)).await);
    let _server = worker.start(SERVICE, Arc::new(Oddities::default())).await.unwrap();
    let caller = asking.caller(SERVICE).await.unwrap();
    caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    router.close().await.unwrap();
    let took = within(Duration::from_secs(3), async || {
        let ended = caller.call("echo", word(""), CallOptions::within(Duration::from_secs(2))).await.unwrap_err();
        assert_eq!(ended.code, ErrorCode::Unavailable, "{ended}");
        assert!(ended.message.contains("the router was away"), "{ended}");
    })
    .await;
    assert!(took.as_secs_f64() >= 1.9, "{took:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn where_the_router_is_there_a_missing_service_is_said_within_a_second_or_so() {
    let endpoint = endpoint();
    let _router = router(&endpoint).await;
    let asking = client(std::slice::from_ref(&endpoint)).await;
    let caller = asking.caller(SERVICE).await.unwrap();
    within(Duration::from_secs(2), async || {
        let ended = caller.call("echo", word(""), CallOptions::within(Duration::from_secs(10))).await.unwrap_err();
        assert_eq!(ended.code, ErrorCode::Unavailable);
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_routers_either_may_go() {
    let (a, b) = (endpoint(), endpoint());
    for first_to_go in [0, 1] {
        let mut routers = Vec::new();
        for (own, other) in [(&a, &b), (&b, &a)] {
            let mut config = RuntimeConfig::default();
            config.session.mode = SessionMode::Router;
            config.session.listen = vec![own.clone()];
            config.session.connect = vec![other.clone()];
            routers.push(Some(Session::open(config).await.unwrap()));
        }
        let both = [a.clone(), b.clone()];
        let (worker, asking) = (client(&both).await, client(&[b.clone(), a.clone()]).await);
        let handler = Arc::new(Oddities { work_ms: 1, ..Oddities::default() });
        let _server = worker.start(SERVICE, handler.clone()).await.unwrap();
        let caller = asking.caller(SERVICE).await.unwrap();
        caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
        for round in 0..30 {
            if round == 10
                && let Some(router) = routers[first_to_go].take()
            {
                router.close().await.unwrap();
            }
            let answer = caller.call("work", word("x"), CallOptions::within(Duration::from_secs(15))).await;
            assert_eq!(read(&answer.unwrap_or_else(|e| panic!("without router {first_to_go}, round {round}: {e}")).payload), "x");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        for session in [worker, asking].into_iter().chain(routers.into_iter().flatten()) {
            session.close().await.unwrap();
        }
    }
}
