//! Measures calls: round-trip times by payload size, in one process and through a router over TCP, and calls per second.
//!
//! `cargo run --release -p repose-runtime --example round_trip`

use std::sync::Arc;
use std::time::{Duration, Instant};

use repose_proto::{CallError, Payload, Service};
use repose_runtime::{Call, CallOptions, Handler, RuntimeConfig, Session, SessionMode};

struct Echo;

#[async_trait::async_trait]
impl Handler for Echo {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        Ok(call.payload)
    }
}

async fn measure(name: &str, worker: &Session, client: &Session) -> Result<(), Box<dyn std::error::Error>> {
    let server = worker.start(Service::Inference, Arc::new(Echo)).await?;
    let caller = client.caller(Service::Inference).await?;
    caller.wait_for_workers(1, Duration::from_secs(5)).await?;
    let payload = |bytes: usize| Payload { encoding: "application/octet-stream".to_owned(), bytes: vec![7; bytes].into() };
    for (bytes, rounds) in [(64, 2000), (64 << 10, 1000), (1 << 20, 200), (8 << 20, 40)] {
        let mut times: Vec<Duration> = Vec::new();
        for _ in 0..rounds {
            let started = Instant::now();
            caller.call("echo", payload(bytes), CallOptions::default()).await?;
            times.push(started.elapsed());
        }
        times.sort_unstable();
        println!("{name}: {bytes:>8} bytes  p50 {:>8.1?}  p99 {:>8.1?}", times[rounds / 2], times[rounds * 99 / 100]);
    }
    let (started, calls) = (Instant::now(), 5000);
    for _ in 0..calls / 50 {
        let round = (0..50).map(|_| caller.call("echo", payload(64), CallOptions::default()));
        for answer in futures::future::join_all(round).await {
            answer?;
        }
    }
    println!("{name}: {:.0} calls per second, 50 at once", f64::from(calls) / started.elapsed().as_secs_f64());
    server.drain().await;
    Ok(())
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let session = Session::embedded().await?;
    measure("one process", &session, &session).await?;
    let mut config = RuntimeConfig::default();
    config.session.mode = SessionMode::Router;
    config.session.listen = vec!["tcp/127.0.0.1:0".to_owned()];
    let router = Session::open(config).await?;
    let mut config = RuntimeConfig::default();
    config.session.mode = SessionMode::Client;
    config.session.connect = router.locators().await;
    let (worker, client) = (Session::open(config.clone()).await?, Session::open(config).await?);
    measure("router", &worker, &client).await?;
    Ok(())
}
