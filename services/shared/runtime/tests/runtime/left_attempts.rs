//! Attempts that are left, and those that a link does not take: on the fake network, whose clock jumps.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::common::{Oddities, SERVICE, read, word};
use repose_proto::load::WorkerLoad;
use repose_proto::{CallError, ErrorCode, Payload};
use repose_runtime::fake::{FakeNetwork, FakeSettings};
use repose_runtime::transport::{
    AliveWatch, ConnectionStatus, Guard, IncomingQueries, OutgoingQuery, ReplyStream, Subscription, Transport,
};
use repose_runtime::{Call, CallOptions, Caller, Handler, RuntimeConfig, RuntimeError, Server, Session, Traffic};

/// A link that does not take the first query: it refuses it, or does not come to it.
struct FirstQueryLost {
    link: Arc<dyn Transport>,
    was_asked: AtomicBool,
    refuses: bool,
}

impl FirstQueryLost {
    fn on(link: Arc<dyn Transport>, refuses: bool) -> Arc<Self> {
        Arc::new(Self { link, was_asked: AtomicBool::new(false), refuses })
    }
}

#[async_trait::async_trait]
impl Transport for FirstQueryLost {
    async fn query(&self, key: &str, query: OutgoingQuery) -> Result<ReplyStream, RuntimeError> {
        if self.was_asked.swap(true, Ordering::SeqCst) {
            return self.link.query(key, query).await;
        }
        if !self.refuses {
            std::future::pending::<()>().await;
        }
        Err(RuntimeError::Transport { operation: "querying".to_owned(), message: "refused on purpose".to_owned() })
    }

    async fn serve(&self, key: &str, capacity: usize) -> Result<IncomingQueries, RuntimeError> {
        self.link.serve(key, capacity).await
    }

    async fn put(&self, key: &str, payload: Payload, traffic: Traffic) -> Result<(), RuntimeError> {
        self.link.put(key, payload, traffic).await
    }

    async fn subscribe(&self, key: &str, capacity: usize) -> Result<Subscription, RuntimeError> {
        self.link.subscribe(key, capacity).await
    }

    async fn declare_alive(&self, key: &str) -> Result<Guard, RuntimeError> {
        self.link.declare_alive(key).await
    }

    async fn watch_alive(&self, key: &str) -> Result<AliveWatch, RuntimeError> {
        self.link.watch_alive(key).await
    }

    fn connection(&self) -> ConnectionStatus {
        self.link.connection()
    }

    async fn locators(&self) -> Vec<String> {
        self.link.locators().await
    }

    async fn close(&self, bound: Duration) -> Result<(), RuntimeError> {
        self.link.close(bound).await
    }
}

/// A worker that tells of many calls that wait.
struct Busy(Arc<Oddities>);

#[async_trait::async_trait]
impl Handler for Busy {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        self.0.call(call).await
    }

    fn load(&self) -> WorkerLoad {
        WorkerLoad { queue_depth: 5, service_ms: 10.0, ..WorkerLoad::default() }
    }
}

/// A worker that refuses its first call.
#[derive(Default)]
struct RefusesFirst(AtomicBool);

#[async_trait::async_trait]
impl Handler for RefusesFirst {
    async fn call(&self, _call: Call) -> Result<Payload, CallError> {
        match self.0.swap(true, Ordering::SeqCst) {
            true => Ok(word("done")),
            false => Err(CallError::new(ErrorCode::Unavailable, "not yet")),
        }
    }

    fn load(&self) -> WorkerLoad {
        WorkerLoad { service_ms: 10.0, ..WorkerLoad::default() }
    }
}

async fn worker(network: &FakeNetwork, name: &str, handler: Arc<dyn Handler>) -> Server {
    let mut config = RuntimeConfig::default();
    config.worker.name = Some(name.to_owned());
    Session::over(network.node(name), config).unwrap().start(SERVICE, handler).await.unwrap()
}

async fn caller(link: Arc<dyn Transport>, workers: usize) -> Caller {
    let caller = Session::over(link, RuntimeConfig::default()).unwrap().caller(SERVICE).await.unwrap();
    caller.wait_for_workers(workers, Duration::from_secs(10)).await.unwrap();
    caller
}

fn options() -> CallOptions {
    CallOptions::within(Duration::from_secs(10))
}

#[tokio::test(start_paused = true)]
async fn a_worker_that_is_left_for_one_that_was_asked_before_is_told() {
    let network = FakeNetwork::new(FakeSettings::default());
    let left = Arc::new(Oddities::default());
    let _left = worker(&network, "busy", Arc::new(Busy(left.clone()))).await;
    let _other = worker(&network, "idle", Arc::new(RefusesFirst::default())).await;
    let caller = caller(network.node("caller"), 2).await;
    let answer = caller.call("patient", word(""), options()).await.unwrap();
    assert_eq!((answer.worker.as_str(), answer.attempts, read(&answer.payload)), ("idle", 3, "done".to_owned()));
    // Long before its deadline, at which it would end by itself.
    let told = tokio::time::timeout(Duration::from_secs(1), left.wait_for(&left.cancelled, 1)).await;
    assert!(told.is_ok(), "it goes on with what nobody waits for");
}

#[tokio::test(start_paused = true)]
async fn a_call_that_a_link_has_refused_is_let_in_when_it_comes() {
    let network = FakeNetwork::new(FakeSettings::default());
    let _worker = worker(&network, "worker", Arc::new(Oddities::default())).await;
    let caller = caller(FirstQueryLost::on(network.node("caller"), true), 1).await;
    let answer = caller.call("echo", word("hello"), options()).await.unwrap();
    assert_eq!((read(&answer.payload), answer.attempts), ("hello".to_owned(), 2));
}

#[tokio::test(start_paused = true)]
async fn a_cancel_is_heard_while_a_link_takes_no_call() {
    let network = FakeNetwork::new(FakeSettings::default());
    let _worker = worker(&network, "worker", Arc::new(Oddities::default())).await;
    for idempotent in [true, false] {
        let caller = caller(FirstQueryLost::on(network.node("caller"), false), 1).await;
        let options = CallOptions { idempotent, ..options() };
        let cancel = options.cancel.clone();
        let giving_up = async {
            tokio::time::sleep(Duration::from_millis(300)).await;
            cancel.cancel();
        };
        let began = tokio::time::Instant::now();
        let (ended, ()) = tokio::join!(caller.call("echo", word(""), options), giving_up);
        assert_eq!(ended.unwrap_err().code, ErrorCode::Cancelled);
        // What must not be repeated may have been sent after all, and is waited for a little.
        let most = Duration::from_millis(if idempotent { 310 } else { 1310 });
        assert!(began.elapsed() <= most, "{:?}", began.elapsed());
    }
}

#[tokio::test(start_paused = true)]
async fn a_call_that_was_given_up_before_it_is_sent_is_not_sent() {
    let network = FakeNetwork::new(FakeSettings::default());
    let asked = Arc::new(Oddities::default());
    let _worker = worker(&network, "worker", asked.clone()).await;
    let caller = caller(network.node("caller"), 1).await;
    let given_up = options();
    given_up.cancel.cancel();
    assert_eq!(caller.call("echo", word(""), given_up).await.unwrap_err().code, ErrorCode::Cancelled);
    caller.call("echo", word(""), options()).await.unwrap();
    assert_eq!(asked.started.load(Ordering::SeqCst), 1, "the second alone");
}
