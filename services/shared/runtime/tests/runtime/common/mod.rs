//! A service whose methods misbehave on request, and networks to put it on.

#![allow(dead_code, reason = "the test of traces uses a part")]

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use repose_proto::load::WorkerLoad;
use repose_proto::{CallAttachment, CallError, ErrorCode, Message, Payload, Priority, ReplyAttachment, ReplyKind, Service, limits};
use repose_runtime::transport::{OutgoingQuery, ReplyEvent};
use repose_runtime::{Call, Caller, Handler, RuntimeConfig, Server, Session, SessionMode};
use serde::{Deserialize, Serialize};
use tokio::sync::Notify;

/// The service that the tests serve.
pub const SERVICE: Service = Service::Planner;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Word {
    pub text: String,
}

impl Message for Word {
    const SCHEMA: &'static str = "Word.v1";
}

pub fn word(text: &str) -> Payload {
    Payload::json(&Word { text: text.to_owned() }).unwrap()
}

pub fn read(payload: &Payload) -> String {
    payload.decode_json::<Word>().unwrap().text
}

/// What the tests serve.
#[derive(Default)]
pub struct Oddities {
    /// Handlers entered.
    pub started: AtomicU64,
    /// Handlers whose cancel token was triggered.
    pub cancelled: AtomicU64,
    /// Told whenever one of the counts changes.
    pub changed: Notify,
    /// Told by the test to let `held` go on.
    pub release: Notify,
    /// Milliseconds that `work` takes.
    pub work_ms: u64,
    /// The load's weights.
    pub weights: String,
    /// The load's time for a job, milliseconds.
    pub service_ms: f64,
}

impl Oddities {
    /// Waits until a count has a value.
    pub async fn wait_for(&self, count: &AtomicU64, value: u64) {
        loop {
            let changed = self.changed.notified();
            if count.load(Ordering::SeqCst) >= value {
                return;
            }
            changed.await;
        }
    }

    fn count(&self, count: &AtomicU64) {
        count.fetch_add(1, Ordering::SeqCst);
        self.changed.notify_waiters();
    }
}

#[async_trait::async_trait]
impl Handler for Oddities {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        self.count(&self.started);
        match call.method.as_str() {
            "echo" => Ok(word(&read(&call.payload))),
            "strict" => Ok(Payload::json(&call.payload.decode_json::<Word>()?)?),
            "count" => {
                for i in 0..5 {
                    call.progress(word(&i.to_string()));
                }
                call.stage("counting", 1.5);
                Ok(word("5"))
            }
            "refuse" => Err(CallError::not_found("text", "no such word")),
            "panic" => panic!("on purpose"),
            "large" => Ok(Payload { encoding: String::new(), bytes: vec![0; 33 << 20].into() }),
            "work" | "execute" => {
                tokio::time::sleep(Duration::from_millis(self.work_ms)).await;
                Ok(word(&read(&call.payload)))
            }
            "execute-later" if self.started.load(Ordering::SeqCst) == 1 => Err(CallError::new(ErrorCode::Unavailable, "not yet")),
            "execute-later" => Ok(word(&read(&call.payload))),
            "held" => {
                self.release.notified().await;
                Ok(word("released"))
            }
            "obedient" | "execute-obedient" => {
                call.cancelled.cancelled().await;
                Err(CallError::new(ErrorCode::Cancelled, "the caller cancelled"))
            }
            "patient" => {
                call.cancelled.cancelled().await;
                self.count(&self.cancelled);
                Ok(word("stopped"))
            }
            _ => Err(call.unknown_method()),
        }
    }

    fn at_most_once(&self, method: &str) -> bool {
        method.starts_with("execute")
    }

    fn load(&self) -> WorkerLoad {
        WorkerLoad { weights_hash: self.weights.clone(), service_ms: self.service_ms, ..WorkerLoad::default() }
    }
}

/// Asserts that something takes less than a bound, one of three times at least: a machine that stands still for a while is late once, and what waits where
/// it should not always. How long it took, the shortest time.
pub async fn within(bound: Duration, mut attempt: impl AsyncFnMut()) -> Duration {
    let mut soonest = Duration::MAX;
    for _ in 0..3 {
        let began = Instant::now();
        attempt().await;
        soonest = soonest.min(began.elapsed());
        if soonest < bound {
            return soonest;
        }
    }
    panic!("it took {soonest:?}, and {bound:?} at most was expected");
}

/// Sessions of one network: the callers', and one for each worker.
pub struct Network {
    /// Keeps the router running.
    router: Option<Session>,
    pub caller: Session,
    config: RuntimeConfig,
}

impl Network {
    /// Everything in one session.
    pub async fn embedded(config: RuntimeConfig) -> Self {
        Self { router: None, caller: Session::open(config.clone()).await.unwrap(), config }
    }

    /// A router on a port of its own and a client for everyone.
    pub async fn routed(config: RuntimeConfig) -> Self {
        let mut router = config.clone();
        router.session.mode = SessionMode::Router;
        router.session.listen = vec!["tcp/127.0.0.1:0".to_owned()];
        let router = Session::open(router).await.unwrap();
        let mut config = config;
        config.session.mode = SessionMode::Client;
        config.session.connect = router.locators().await;
        Self { caller: Session::open(config.clone()).await.unwrap(), router: Some(router), config }
    }

    /// A session for a worker.
    pub async fn session(&self) -> Session {
        match self.router {
            Some(_) => Session::open(self.config.clone()).await.unwrap(),
            None => self.caller.clone(),
        }
    }

    /// Starts a worker in a session of its own.
    pub async fn worker(&self, handler: &Arc<Oddities>) -> (Session, Server) {
        let session = self.session().await;
        let server = session.start(SERVICE, handler.clone()).await.unwrap();
        (session, server)
    }

    /// A caller that has seen `workers` workers.
    pub async fn caller(&self, workers: usize) -> Caller {
        let caller = self.caller.caller(SERVICE).await.unwrap();
        caller.wait_for_workers(workers, Duration::from_secs(10)).await.unwrap();
        caller
    }
}

/// A call by hand to a key, and its terminal reply: what any client could send.
pub async fn raw_call(session: &Session, key: &str, method: &str) -> Result<Payload, CallError> {
    let attachment = CallAttachment {
        v: limits::VERSION,
        id: format!("raw-{method}"),
        method: method.to_owned(),
        remaining_ms: 5000,
        priority: Priority::Interactive,
        attempt: 0,
        traceparent: None,
        caller: None,
    };
    let attachment = Bytes::from(attachment.encode());
    let query = OutgoingQuery { payload: word("raw"), attachment, priority: Priority::Interactive, timeout: Duration::from_secs(5) };
    let mut replies = session.transport().query(key, query).await.unwrap();
    let Some(ReplyEvent::Reply { payload, attachment }) = replies.next().await else { panic!("no reply") };
    match ReplyAttachment::decode(&attachment).unwrap().kind {
        ReplyKind::Result => Ok(payload),
        _ => Err(payload.decode_json().unwrap()),
    }
}
