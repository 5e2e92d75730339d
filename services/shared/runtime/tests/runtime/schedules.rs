//! Thousands of seeded schedules over the fake network: whatever is lost, delayed, repeated, killed or stopped, every call ends in
//! exactly one terminal outcome within its deadline, and nothing that must happen at most once happens twice.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::common::{Oddities, SERVICE, word};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use repose_proto::{CallError, ErrorCode, Payload};
use repose_runtime::fake::{FakeNetwork, FakeSettings};
use repose_runtime::{Answer, Call, CallOptions, Handler, RuntimeConfig, Session};
use tokio::time::Instant;

/// What one schedule did.
#[derive(Default)]
struct Tally {
    results: usize,
    codes: BTreeMap<ErrorCode, usize>,
}

/// Counts how often each request is executed, across workers.
struct Counting {
    inner: Oddities,
    executions: Arc<Mutex<BTreeMap<String, usize>>>,
}

#[async_trait::async_trait]
impl Handler for Counting {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        if call.method == "execute" {
            *self.executions.lock().unwrap().entry(call.id.clone()).or_default() += 1;
        }
        self.inner.call(call).await
    }

    fn at_most_once(&self, method: &str) -> bool {
        self.inner.at_most_once(method)
    }
}

fn config(seed: u64) -> RuntimeConfig {
    let mut config = RuntimeConfig::default();
    config.caller.seed = Some(seed);
    config
}

/// Runs three workers, 20 calls and some misfortune.
async fn schedule(seed: u64, settings: FakeSettings, misfortune: bool) -> Tally {
    let mut random = Pcg64::seed_from_u64(seed);
    let network = FakeNetwork::new(FakeSettings { seed, ..settings });
    let executions = Arc::new(Mutex::new(BTreeMap::new()));
    let mut servers = Vec::new();
    for i in 0..3 {
        let mut config = config(seed);
        config.worker.name = Some(format!("w{i}"));
        config.worker.max_open_calls = 4;
        let session = Session::over(network.node(&format!("node{i}")), config).unwrap();
        let work_ms = random.random_range(1..100);
        let handler = Counting { inner: Oddities { work_ms, ..Oddities::default() }, executions: executions.clone() };
        servers.push(session.start(SERVICE, Arc::new(handler)).await.unwrap());
    }
    let session = Session::over(network.node("caller"), config(seed)).unwrap();
    let caller = session.caller(SERVICE).await.unwrap();
    let calls = (0..20).map(|i| {
        let (start, deadline) = (random.random_range(0..1500), Duration::from_millis(random.random_range(200..4000)));
        let (caller, executed) = (caller.clone(), i % 5 == 0);
        async move {
            tokio::time::sleep(Duration::from_millis(start)).await;
            let options = if executed { CallOptions::at_most_once(deadline) } else { CallOptions::within(deadline) };
            let started = Instant::now();
            let ended = caller.call(if executed { "execute" } else { "work" }, word("w"), options).await;
            assert!(started.elapsed() <= deadline + Duration::from_millis(2), "seed {seed}: {:?} of {deadline:?}", started.elapsed());
            ended
        }
    });
    let mut calls: Vec<_> = calls.map(|call| Box::pin(call) as futures::future::BoxFuture<'_, Result<Answer, CallError>>).collect();
    let fate = async {
        if misfortune {
            tokio::time::sleep(Duration::from_millis(random.random_range(100..1200))).await;
            network.kill("node0");
            network.stop("node1");
            tokio::time::sleep(Duration::from_millis(random.random_range(100..5000))).await;
            network.resume("node1");
        }
    };
    let (ended, ()) = tokio::join!(futures::future::join_all(calls.drain(..)), fate);
    assert!(executions.lock().unwrap().values().all(|n| *n <= 1), "seed {seed}: executed twice");
    let mut tally = Tally::default();
    for outcome in ended {
        match outcome {
            Ok(_) => tally.results += 1,
            Err(error) => *tally.codes.entry(error.code).or_default() += 1,
        }
    }
    tally
}

/// Runs many schedules, each on a runtime of its own whose clock jumps, and adds their tallies up.
fn schedules(seeds: std::ops::Range<u64>, settings: &FakeSettings, misfortune: bool) -> Tally {
    let mut sum = Tally::default();
    for seed in seeds {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap();
        let tally = runtime.block_on(schedule(seed, settings.clone(), misfortune));
        sum.results += tally.results;
        tally.codes.into_iter().for_each(|(code, n)| *sum.codes.entry(code).or_default() += n);
    }
    println!("{} results, {:?}", sum.results, sum.codes);
    sum
}

#[test]
fn a_healthy_network_loses_nothing() {
    let sum = schedules(0..200, &FakeSettings::default(), false);
    assert_eq!((sum.results, sum.codes), (200 * 20, BTreeMap::new()));
}

#[test]
fn every_call_ends_once_and_in_time_whatever_is_killed_and_stopped() {
    let sum = schedules(1000..2500, &FakeSettings::default(), true);
    assert_eq!(sum.results + sum.codes.values().sum::<usize>(), 1500 * 20);
    assert!(sum.codes.keys().all(|c| matches!(c, ErrorCode::Unavailable | ErrorCode::DeadlineExceeded | ErrorCode::ResourceExhausted)));
    assert!(sum.results > 1500 * 20 * 8 / 10, "only {} results", sum.results);
}

#[test]
fn every_call_ends_once_and_in_time_on_a_network_that_loses_repeats_and_delays() {
    let settings = FakeSettings { loss: 0.05, duplication: 0.05, max_delay: Duration::from_millis(60), ..FakeSettings::default() };
    let sum = schedules(5000..6500, &settings, true);
    assert_eq!(sum.results + sum.codes.values().sum::<usize>(), 1500 * 20);
    assert!(sum.results > 1500 * 20 * 6 / 10, "only {} results", sum.results);
}

#[test]
fn the_same_seed_gives_the_same_outcomes() {
    let settings = FakeSettings { loss: 0.05, duplication: 0.05, max_delay: Duration::from_millis(60), ..FakeSettings::default() };
    let run = || {
        let sum = schedules(42..52, &settings, true);
        (sum.results, sum.codes)
    };
    assert_eq!(run(), run());
}
