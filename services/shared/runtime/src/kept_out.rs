//! A user whose call access control keeps from a worker is told that, and not that the worker were gone: the router drops such a call in silence.

use std::num::NonZeroUsize;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use lru::LruCache;
use repose_proto::{CallError, ErrorCode};

use crate::directory::Directory;
use crate::target::Target;
use crate::transport::{ConnectionStatus, Transport};

/// Keys of workers that are remembered as answered; the one that answered longest ago is forgotten first.
const MOST_KEYS: NonZeroUsize = NonZeroUsize::new(256).unwrap();

/// The keys at which a worker has answered this process, and the link over which it did. Access control goes by keys: a call to one of them that nothing
/// came of was lost, as by a worker that is too busy to take it in.
pub(crate) struct Answered(Mutex<LruCache<String, ConnectionStatus>>);

impl Default for Answered {
    fn default() -> Self {
        Self(Mutex::new(LruCache::new(MOST_KEYS)))
    }
}

impl Answered {
    fn keys(&self) -> MutexGuard<'_, LruCache<String, ConnectionStatus>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// An answer has come.
    pub(crate) fn note(&self, key: &str, link: ConnectionStatus) {
        let mut keys = self.keys();
        match keys.get_mut(key) {
            Some(known) => *known = link,
            None => {
                keys.put(key.to_owned(), link);
            }
        }
    }

    /// Whether one came over this link: a router that was started anew may have other rules.
    pub(crate) fn has(&self, key: &str, link: ConnectionStatus) -> bool {
        self.keys().get(key) == Some(&link)
    }
}

/// Whether a worker that answered nothing lives all the same, as its next load tells. Where nobody is a user, or the worker falls silent, it has died.
pub(crate) async fn is_kept_out(transport: &dyn Transport, directory: &Directory, worker: &str, within: Duration) -> bool {
    transport.is_user() && directory.hears_anew(worker, within).await
}

/// What the user is told.
pub(crate) fn refusal(target: &Target, worker: &str, method: &str) -> CallError {
    let message = format!(
        "{} worker {worker} is alive, and this user's call of {method} does not reach it: the user's role or cells in the roles file do not allow it",
        target.service
    );
    CallError::new(ErrorCode::FailedPrecondition, message)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::Arc;

    use async_trait::async_trait;
    use bytes::Bytes;
    use repose_proto::load::WorkerLoad;
    use repose_proto::scoring::ModelsRequest;
    use repose_proto::{CallAttachment, Cell, Payload, ReplyAttachment, ReplyKind, Service, limits};

    use super::*;
    use crate::fake::{FakeNetwork, FakeSettings};
    use crate::transport::{AliveWatch, Guard, IncomingQueries, OutgoingQuery, ReplyStream, Subscription, Traffic};
    use crate::{CallOptions, RuntimeConfig, RuntimeError, Session};

    /// A node's access to the network, let in as a user.
    struct AsUser(Arc<dyn Transport>);

    #[async_trait]
    impl Transport for AsUser {
        async fn query(&self, key: &str, query: OutgoingQuery) -> Result<ReplyStream, RuntimeError> {
            self.0.query(key, query).await
        }

        async fn serve(&self, key: &str, capacity: usize) -> Result<IncomingQueries, RuntimeError> {
            self.0.serve(key, capacity).await
        }

        async fn put(&self, key: &str, payload: Payload, traffic: Traffic) -> Result<(), RuntimeError> {
            self.0.put(key, payload, traffic).await
        }

        async fn subscribe(&self, key: &str, capacity: usize) -> Result<Subscription, RuntimeError> {
            self.0.subscribe(key, capacity).await
        }

        async fn declare_alive(&self, key: &str) -> Result<Guard, RuntimeError> {
            self.0.declare_alive(key).await
        }

        async fn watch_alive(&self, key: &str) -> Result<AliveWatch, RuntimeError> {
            self.0.watch_alive(key).await
        }

        fn is_user(&self) -> bool {
            true
        }

        fn connection(&self) -> ConnectionStatus {
            self.0.connection()
        }

        async fn locators(&self) -> Vec<String> {
            self.0.locators().await
        }

        async fn close(&self, bound: Duration) -> Result<(), RuntimeError> {
            self.0.close(bound).await
        }
    }

    /// A worker that lives and answers its second call; it lets the others go, as one does that has no room for them.
    async fn answering_the_second(transport: Arc<dyn Transport>) {
        let cell = Cell::new("cell").expect("a name");
        let mut queries = transport.serve(&cell.call(Service::Inference, "one"), 8).await.expect("served");
        let _alive = transport.declare_alive(&cell.live(Service::Inference, "one")).await.expect("declared");
        let (key, mut calls) = (cell.load(Service::Inference, "one"), 0);
        let mut period = tokio::time::interval(Duration::from_millis(100));
        loop {
            tokio::select! {
                _ = period.tick() => {
                    let load = WorkerLoad { v: limits::VERSION, ..WorkerLoad::default() };
                    transport.put(&key, Payload::json(&load).expect("encoded"), Traffic::Load).await.expect("put");
                }
                Some(query) = queries.next() => {
                    calls += 1;
                    if calls == 2 {
                        let id = CallAttachment::decode(&query.attachment).expect("a call").id;
                        let (v, kind) = (limits::VERSION, ReplyKind::Result);
                        let reply = ReplyAttachment { v, id, kind, n: None, worker: None, attempt: None, timing_ms: BTreeMap::new() };
                        query.replier.reply(query.payload, Bytes::from(reply.encode())).await.expect("sent");
                    }
                }
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_call_that_a_live_worker_loses_is_not_kept_out_where_another_was_answered() {
        let network = FakeNetwork::new(FakeSettings::default());
        tokio::spawn(answering_the_second(network.node("worker")));
        let session = Session::over(Arc::new(AsUser(network.node("user"))), RuntimeConfig::default()).expect("a session");
        let caller = session.caller(Service::Inference).await.expect("a caller");
        caller.wait_for_workers(1, Duration::from_secs(10)).await.expect("it is there");
        let mut ended = Vec::new();
        for _ in 0..3 {
            let options = CallOptions::at_most_once(Duration::from_secs(10));
            let answer = caller.call("models", Payload::json(&ModelsRequest {}).expect("encoded"), options).await;
            ended.push(answer.map_or_else(|error| Some(error.code), |_| None));
        }
        assert_eq!(ended, [Some(ErrorCode::FailedPrecondition), None, Some(ErrorCode::Unavailable)]);
    }
}
