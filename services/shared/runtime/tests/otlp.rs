//! With the feature `otlp`, the spans of a call arrive at a collector, its caller's and its worker's in the caller's trace:
//! `cargo test -p repose-runtime --release --features otlp --test otlp`.
#![cfg(feature = "otlp")]

#[path = "runtime/common/mod.rs"]
mod common;

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::Bytes;
use axum::routing::post;
use common::{Network, Oddities, word};
use repose_runtime::{CallOptions, RuntimeConfig, start_logging};

const TRACE: [u8; 16] = [0x4b, 0xf9, 0x2f, 0x35, 0x77, 0xb3, 0x4d, 0xa6, 0xa3, 0xce, 0x92, 0x9d, 0x0e, 0x0e, 0x47, 0x36];

fn holds(body: &[u8], what: &[u8]) -> usize {
    body.windows(what.len()).filter(|window| *window == what).count()
}

#[test]
fn the_spans_of_a_call_arrive_at_a_collector_in_its_callers_trace() {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let (told, bodies) = std::sync::mpsc::channel::<Bytes>();
    let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).unwrap();
    let endpoint = format!("http://{}", listener.local_addr().unwrap());
    let collector = Router::new().route("/v1/traces", post(|body: Bytes| async move { drop(told.send(body)) }));
    runtime.spawn(async move { axum::serve(listener, collector).await });
    // SAFETY: no other thread of this process reads the environment yet but those that wait for connections.
    unsafe {
        std::env::set_var("OTEL_EXPORTER_OTLP_ENDPOINT", &endpoint);
        std::env::set_var("OTEL_BSP_SCHEDULE_DELAY", "50");
    }
    start_logging("warn");
    runtime.block_on(async {
        let network = Network::embedded(RuntimeConfig::default()).await;
        let (_session, _server) = network.worker(&Arc::new(Oddities::default())).await;
        let caller = network.caller(1).await;
        let traceparent = format!("00-{:032x}-00f067aa0ba902b7-01", u128::from_be_bytes(TRACE));
        let options = CallOptions { traceparent: Some(traceparent), ..CallOptions::within(Duration::from_secs(10)) };
        caller.call("echo", word("traced"), options).await.unwrap();
    });
    let (mut all, give_up) = (Vec::new(), Instant::now() + Duration::from_secs(20));
    while !(holds(&all, b"request") > 0 && holds(&all, b"\x04call") > 0 && holds(&all, &TRACE) >= 2) {
        let left = give_up.saturating_duration_since(Instant::now());
        let body = bodies.recv_timeout(left).unwrap_or_else(|e| panic!("{e}; so far: {}", String::from_utf8_lossy(&all)));
        all.extend_from_slice(&body);
    }
    assert!(holds(&all, b"echo") >= 2, "both say what was called: {}", String::from_utf8_lossy(&all));
}
