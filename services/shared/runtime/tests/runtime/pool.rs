//! A pool that serves other cells: each is served as itself, none is starved by another, and a pool that is not there is said.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::common::{Network, read, within, word};
use repose_proto::load::WorkerLoad;
use repose_proto::{CallError, ErrorCode, Payload, Service};
use repose_runtime::{Answer, Call, CallOptions, Caller, ComputeQueue, Handler, QueueSettings, RuntimeConfig, Server, Session, load_of};

/// What a call of `work` takes.
const WORK: Duration = Duration::from_millis(20);
/// What it may take to say that a pool is not there: a second, and more on a busy machine.
const SAID_WITHIN: Duration = Duration::from_secs(2);

/// Says for which cell it is called, and computes for cells in turn.
struct Pooled {
    queue: ComputeQueue,
    /// The cells that were computed for, in that order.
    order: Arc<Mutex<Vec<String>>>,
    /// Whom `through` asks.
    next: Option<Caller>,
}

impl Pooled {
    fn new(session: &Session, next: Option<Caller>) -> Arc<Self> {
        let settings = QueueSettings { capacity: 64, shares: session.cell_shares(), ..QueueSettings::default() };
        Arc::new(Self { queue: ComputeQueue::start(settings).unwrap(), order: Arc::default(), next })
    }

    fn computed_for(&self, cell: &str) -> usize {
        self.order.lock().unwrap().iter().filter(|name| *name == cell).count()
    }
}

#[async_trait::async_trait]
impl Handler for Pooled {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        let cell = call.cell.as_deref().unwrap_or("its own").to_owned();
        match (call.method.as_str(), &self.next) {
            ("cell", _) => Ok(word(&cell)),
            ("through", Some(next)) => Ok(next.call("cell", word(""), CallOptions::for_call(&call)).await?.payload),
            ("work", _) => {
                let order = self.order.clone();
                let work = move |_: &_| {
                    std::thread::sleep(WORK);
                    order.lock().unwrap().push(cell);
                    Ok(word("done"))
                };
                self.queue.run(call.context(), work).await
            }
            _ => Err(call.unknown_method()),
        }
    }

    fn load(&self) -> WorkerLoad {
        load_of(&self.queue.gauge(), self.queue.capacity())
    }
}

/// A network whose cells have the pool `rack`.
async fn network(edit: impl FnOnce(&mut RuntimeConfig)) -> Network {
    let mut config = RuntimeConfig::default();
    config.caller.pool = Some("rack".to_owned());
    edit(&mut config);
    Network::routed(config).await
}

/// A worker of the pool.
async fn worker(network: &Network, service: Service) -> (Arc<Pooled>, Server) {
    let rack = network.session().await.in_cell("rack").unwrap();
    let next = if service == Service::Planner { Some(rack.caller(Service::Inference).await.unwrap()) } else { None };
    let handler = Pooled::new(&rack, next);
    let server = rack.start(service, handler.clone()).await.unwrap();
    (handler, server)
}

async fn caller(network: &Network, cell: &str) -> Caller {
    let caller = network.caller.in_cell(cell).unwrap().caller(Service::Planner).await.unwrap();
    caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    caller
}

fn options() -> CallOptions {
    CallOptions::within(Duration::from_secs(60))
}

#[tokio::test(flavor = "multi_thread")]
async fn every_cell_is_served_as_itself_and_so_is_what_is_asked_on_its_behalf() {
    let network = network(|_| ()).await;
    let (_inference, _serving) = worker(&network, Service::Inference).await;
    let (_planner, server) = worker(&network, Service::Planner).await;
    for (cell, served_as) in [("line-1", "line-1"), ("line-2", "line-2"), ("rack", "its own")] {
        let caller = caller(&network, cell).await;
        let answer = caller.call("cell", word(""), options()).await.unwrap();
        assert_eq!((read(&answer.payload).as_str(), answer.worker.as_str()), (served_as, server.worker()));
        assert_eq!(read(&caller.call("through", word(""), options()).await.unwrap().payload), served_as);
    }
    // What no pool serves is the cell's own.
    let motion = network.caller.in_cell("line-1").unwrap().caller(Service::Motion).await.unwrap();
    let nobody = motion.call("plan", word(""), options()).await.unwrap_err();
    assert!(nobody.code == ErrorCode::Unavailable && nobody.message.contains("the cell line-1"), "{nobody}");
}

/// Calls `work` from so many clients at once until the returned guard is dropped.
fn flood(caller: &Caller, clients: usize) -> Vec<tokio_util::task::AbortOnDropHandle<()>> {
    let client = |caller: Caller| async move {
        loop {
            // Refusals are part of a flood.
            let _ended = caller.call("work", word(""), options()).await;
        }
    };
    (0..clients).map(|_| tokio_util::task::AbortOnDropHandle::new(tokio::spawn(client(caller.clone())))).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cell_that_floods_makes_another_wait_no_longer_than_its_share() {
    let network = network(|_| ()).await;
    let (handler, _server) = worker(&network, Service::Planner).await;
    let (flooding, quiet) = (caller(&network, "line-1").await, caller(&network, "line-2").await);
    let _flood = flood(&flooding, 24);
    while handler.computed_for("line-1") < 5 {
        tokio::time::sleep(WORK).await;
    }
    let before = handler.computed_for("line-1");
    let _quiet = flood(&quiet, 4);
    while handler.computed_for("line-2") < 20 {
        tokio::time::sleep(WORK).await;
    }
    // First come, first served, it would be six times as many: 24 clients against 4.
    let meanwhile = handler.computed_for("line-1") - before;
    assert!(meanwhile <= 2 * handler.computed_for("line-2"), "{meanwhile} against {}", handler.computed_for("line-2"));
}

/// Six calls at once.
async fn six_calls(caller: &Caller) -> Vec<Result<Answer, CallError>> {
    futures::future::join_all((0..6).map(|_| caller.call("work", word(""), options()))).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cell_over_its_limit_is_refused_by_name_and_another_is_not() {
    let network = network(|config| {
        let limit = repose_runtime::CellShare { max_waiting: Some(1), max_running: Some(1), ..Default::default() };
        config.worker.shares = BTreeMap::from([("line-1".to_owned(), limit)]);
    })
    .await;
    let (_handler, _server) = worker(&network, Service::Planner).await;
    let (limited, other) = (caller(&network, "line-1").await, caller(&network, "line-2").await);
    let (limited, other) = tokio::join!(six_calls(&limited), six_calls(&other));
    let refused: Vec<CallError> = limited.into_iter().filter_map(Result::err).collect();
    assert!((1..6).contains(&refused.len()), "{refused:?}");
    for error in refused {
        assert_eq!((error.code, error.field.as_deref()), (ErrorCode::ResourceExhausted, Some("cell")));
        assert!(error.message.contains("cell line-1"), "{error}");
    }
    assert!(other.into_iter().all(|answer| answer.is_ok()));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pool_that_is_not_there_is_said_soon_with_those_that_are() {
    let network = network(|config| config.caller.pool = Some("rakc".to_owned())).await;
    let rack = network.session().await.in_cell("rack").unwrap();
    let _server = rack.start(Service::Planner, Pooled::new(&rack, None)).await.unwrap();
    let caller = network.caller.in_cell("line-1").unwrap().caller(Service::Planner).await.unwrap();
    within(SAID_WITHIN, async || {
        let error = caller.call("cell", word(""), options()).await.unwrap_err();
        assert_eq!((error.code, error.field.as_deref()), (ErrorCode::Unavailable, Some("pool")));
        assert!(error.message.contains("the pool rakc") && error.message.ends_with("have one: rack"), "{error}");
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_that_is_no_cell_is_refused() {
    let network = network(|_| ()).await;
    let (_handler, server) = worker(&network, Service::Planner).await;
    caller(&network, "line-1").await;
    let rack = network.caller.in_cell("rack").unwrap();
    let refused = crate::common::raw_call(&network.caller, &rack.cell().call_for(Service::Planner, server.worker(), "Line"), "cell").await;
    let refused = refused.unwrap_err();
    assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::InvalidArgument, Some("cell")));
}
