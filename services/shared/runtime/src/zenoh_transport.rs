//! The transport over Zenoh: with `raw`, the places that import it.
//!
//! Zenoh's callbacks run on its receiving threads, so they only push into bounded mailboxes. Its puts, queries and replies complete
//! synchronously and may wait for room, or for a large one of the same priority that is being sent: such sends have threads that may block.

use std::collections::BTreeSet;
use std::future::IntoFuture;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use futures::FutureExt;
use repose_proto::{Payload, Priority, message};
use tokio::sync::{oneshot, watch};
use tokio::time::Instant;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::qos::{CongestionControl, Priority as Urgency};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::SampleKind;

use crate::RuntimeError;
use crate::alive::Told;
use crate::config::{SessionConfig, SessionMode};
use crate::diagnosis::Credentials;
use crate::frame_link::FrameLink;
use crate::mailbox::mailbox;
use crate::transport::{
    AliveWatch, ConnectionStatus, Guard, IncomingQueries, IncomingQuery, OutgoingQuery, Replier, ReplyEvent, ReplyStream, Sample,
    Subscription, Traffic, Transport,
};
use crate::zenoh_session::{open_session, zenoh_config};

/// Replies of one query that may wait to be read. Progress goes first when it is exceeded.
const REPLY_CAPACITY: usize = 256;
/// How long the tokens declared before may take to arrive when a watch begins.
const HISTORY_TIMEOUT: Duration = Duration::from_secs(2);

/// A Zenoh session as a [`Transport`].
pub struct ZenohTransport {
    pub(crate) session: zenoh::Session,
    is_user: bool,
    frames: Option<FrameLink>,
    connection: Arc<Mutex<Links>>,
}

/// The links to other processes, as Zenoh's events tell them.
struct Links {
    /// Whether a session without links can carry nothing: a client's.
    needs_router: bool,
    open: BTreeSet<String>,
    connection: ConnectionStatus,
}

impl Links {
    fn take(&mut self, other: String, kind: SampleKind) {
        match kind {
            SampleKind::Put => self.open.insert(other),
            SampleKind::Delete => self.open.remove(&other),
        };
        metrics::gauge!("repose_links").set(self.open.len() as f64);
        let is_up = !self.needs_router || !self.open.is_empty();
        if is_up != self.connection.is_up {
            let number = self.connection.number + u64::from(is_up);
            self.connection = ConnectionStatus { is_up, since: Instant::now(), number };
            match is_up {
                true => tracing::info!("the router is there"),
                false => tracing::warn!("the router is gone; trying to reach it again"),
            }
        }
    }
}

impl ZenohTransport {
    /// The session by which messages of a kind go, and how they go there.
    async fn way_of(&self, traffic: Traffic) -> Result<(zenoh::Session, Delivery), RuntimeError> {
        let delivery = delivery_of(traffic);
        Ok(match &self.frames {
            Some(frames) if traffic == Traffic::Frame => {
                (frames.session().await?.clone(), Delivery { congestion: CongestionControl::Drop, ..delivery })
            }
            _ => (self.session.clone(), delivery),
        })
    }

    /// Opens a session.
    ///
    /// # Errors
    /// When the configuration is unusable, nothing can be reached within `connect_timeout_ms`, or the router lets nobody in: at once then,
    /// with what is wrong of the address, the certificates or the user.
    pub async fn open(config: &SessionConfig) -> Result<Self, RuntimeError> {
        let zenoh_config = zenoh_config(config)?;
        let is_user = Credentials::of(&zenoh_config).name_user();
        let session = open_session(config, zenoh_config).await?;
        let connection = ConnectionStatus { is_up: true, since: Instant::now(), number: 1 };
        let links = Links { needs_router: config.mode == SessionMode::Client, open: BTreeSet::new(), connection };
        let links = Arc::new(Mutex::new(links));
        let told = links.clone();
        session
            .info()
            .transport_events_listener()
            .history(true)
            .callback(move |event| {
                let other = event.transport().zid().to_string();
                told.lock().unwrap_or_else(PoisonError::into_inner).take(other, event.kind());
            })
            .background()
            .await
            .map_err(|e| RuntimeError::transport("following the session's links", e))?;
        Ok(Self { session, is_user, frames: FrameLink::of(config), connection: links })
    }
}

fn urgency_of(priority: Priority) -> Urgency {
    match priority {
        Priority::Interactive => Urgency::InteractiveLow,
        Priority::Batch => Urgency::Background,
    }
}

/// How messages of one kind go.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Delivery {
    pub(crate) priority: Urgency,
    pub(crate) congestion: CongestionControl,
    /// Whether they wait for no others to share a packet with.
    pub(crate) is_express: bool,
}

fn delivery_of(traffic: Traffic) -> Delivery {
    let (priority, congestion, is_express) = match traffic {
        Traffic::EmergencyStop => (Urgency::RealTime, CongestionControl::Block, true),
        Traffic::RobotCommand => (Urgency::RealTime, CongestionControl::Drop, true),
        Traffic::RobotState => (Urgency::InteractiveHigh, CongestionControl::Drop, false),
        Traffic::Frame => (Urgency::DataLow, CongestionControl::BlockFirst, false),
        Traffic::Scene => (Urgency::DataHigh, CongestionControl::Block, false),
        Traffic::Call(priority) => (urgency_of(priority), CongestionControl::Block, false),
        Traffic::Journal => (Urgency::Data, CongestionControl::Drop, false),
        Traffic::Load => (Urgency::Background, CongestionControl::Drop, false),
    };
    Delivery { priority, congestion, is_express }
}

pub(crate) fn bytes_of(bytes: &ZBytes) -> Bytes {
    Bytes::from(bytes.to_bytes().into_owned())
}

fn payload_of(bytes: Option<&ZBytes>, encoding: Option<&Encoding>) -> Payload {
    Payload { encoding: encoding.map(ToString::to_string).unwrap_or_default(), bytes: bytes.map(bytes_of).unwrap_or_default() }
}

/// Runs a synchronous send: on a thread that may block if it can have to wait, however small it is.
pub(crate) async fn send<T: Send + 'static>(
    operation: &'static str,
    waits: bool,
    send: impl FnOnce() -> zenoh::Result<T> + Send + 'static,
) -> Result<T, RuntimeError> {
    let sent = if waits { tokio::task::spawn_blocking(send).await.map_err(|e| RuntimeError::transport(operation, e))? } else { send() };
    sent.map_err(|e| RuntimeError::transport(operation, e))
}

/// Lets Zenoh forget a query whose stream was dropped.
pub(crate) struct CancelOnDrop(pub zenoh::cancellation::CancellationToken);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        // Its first step forgets the query; the rest waits for a callback under way, which may push into a mailbox that nobody reads any more.
        // Waiting here would block, and on a thread that itself waits for a task (`Runtime::block_on`) take the wake-up that was meant for it.
        if let Some(Err(error)) = self.0.cancel().into_future().now_or_never() {
            tracing::debug!(%error, "a query could not be forgotten");
        }
    }
}

/// What a watch hears of live tokens.
#[derive(Default)]
struct Heard {
    told: Told,
    /// The tokens that there were when the watch began and whose end was not told since; emptied once it has caught up, or has given that up.
    listed: BTreeSet<String>,
    /// The same where it was not told of each in time, until it is.
    late: BTreeSet<String>,
}

impl Heard {
    /// Something is told of a token; `alive` are those that there are.
    fn take(&mut self, key: String, kind: SampleKind, alive: &mut BTreeSet<String>) {
        match kind {
            SampleKind::Put if self.told.came(&key) => {
                alive.insert(key);
            }
            SampleKind::Put => {}
            SampleKind::Delete => {
                self.told.went(&key);
                self.listed.remove(&key);
                alive.remove(&key);
            }
        }
        if !self.late.is_empty() && self.told.catch_up(&self.late) {
            self.late.clear();
        }
    }

    /// Whether something was told of every token that is listed.
    fn has_caught_up(&mut self) -> bool {
        let has_caught_up = self.told.catch_up(&self.listed);
        if has_caught_up {
            self.listed.clear();
        }
        has_caught_up
    }

    /// The time for that is over: what is listed is there, told or not. That it was there may still be told, even after its end.
    fn give_up(&mut self, alive: &mut BTreeSet<String>) {
        self.late = std::mem::take(&mut self.listed);
        alive.extend(self.late.iter().cloned());
    }
}

fn locked(heard: &Mutex<Heard>) -> MutexGuard<'_, Heard> {
    heard.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Waits until a watch was told of every token that is listed, or until the time for that is over.
async fn catch_up(
    key: &str,
    heard: &Mutex<Heard>,
    alive: &Weak<watch::Sender<BTreeSet<String>>>,
    keys: &mut watch::Receiver<BTreeSet<String>>,
) -> Result<(), RuntimeError> {
    let told = tokio::time::timeout(HISTORY_TIMEOUT, keys.wait_for(|_| locked(heard).has_caught_up())).await.map(|told| told.is_ok());
    match (told, alive.upgrade()) {
        (Ok(true), _) => Ok(()),
        (Err(_), Some(alive)) => {
            tracing::warn!(key, "not all tokens were told in time");
            alive.send_modify(|alive| locked(heard).give_up(alive));
            Ok(())
        }
        (Ok(false), _) | (Err(_), None) => Err(RuntimeError::transport(format!("watching {key}"), "the session has closed")),
    }
}

struct QueryReplier(Arc<zenoh::query::Query>);

#[async_trait]
impl Replier for QueryReplier {
    async fn reply(&self, payload: Payload, attachment: Bytes) -> Result<(), RuntimeError> {
        let query = self.0.clone();
        send("replying", true, move || {
            let key = query.key_expr().clone();
            query.reply(key, payload.bytes).encoding(payload.encoding).attachment(attachment).wait()
        })
        .await
    }
}

#[async_trait]
impl Transport for ZenohTransport {
    async fn query(&self, key: &str, query: OutgoingQuery) -> Result<ReplyStream, RuntimeError> {
        let (sender, replies) = mailbox(REPLY_CAPACITY);
        let token = zenoh::cancellation::CancellationToken::default();
        // From here on: one that is given up while it waits for room is not sent, or is forgotten.
        let forgetting = CancelOnDrop(token.clone());
        let (session, key, cancel) = (self.session.clone(), key.to_owned(), token);
        // A router gives a query up as well as the session: whichever is later has nothing to add.
        let given_up = AtomicBool::new(false);
        send("querying", true, move || {
            session
                .get(key)
                .target(QueryTarget::BestMatching)
                .consolidation(ConsolidationMode::None)
                .congestion_control(CongestionControl::Block)
                .priority(urgency_of(query.priority))
                .timeout(query.timeout)
                .payload(query.payload.bytes)
                .encoding(query.payload.encoding)
                .attachment(query.attachment)
                .cancellation_token(cancel)
                .callback(move |reply| {
                    match reply.result() {
                        Ok(sample) => sender.push(ReplyEvent::Reply {
                            payload: payload_of(Some(sample.payload()), Some(sample.encoding())),
                            attachment: sample.attachment().map(bytes_of).unwrap_or_default(),
                        }),
                        // Workers never send error replies: this is Zenoh's own timeout.
                        Err(_) if !given_up.swap(true, Ordering::Relaxed) => sender.push(ReplyEvent::TimedOut),
                        Err(_) => {}
                    }
                })
                .wait()
        })
        .await?;
        Ok(ReplyStream { replies, _query: Box::new(forgetting) })
    }

    async fn serve(&self, key: &str, capacity: usize) -> Result<IncomingQueries, RuntimeError> {
        let (sender, queries) = mailbox(capacity);
        let queryable = self
            .session
            .declare_queryable(key.to_owned())
            .complete(true)
            .callback(move |query| {
                let incoming = IncomingQuery {
                    key: query.key_expr().to_string(),
                    payload: payload_of(query.payload(), query.encoding()),
                    attachment: query.attachment().map(bytes_of).unwrap_or_default(),
                    replier: Box::new(QueryReplier(Arc::new(query))),
                };
                // Without room the query is dropped: its caller sees an empty stream and goes elsewhere.
                drop(sender.try_push(incoming));
            })
            .await
            .map_err(|e| RuntimeError::transport(format!("serving {key}"), e))?;
        Ok(IncomingQueries { queries, _declaration: Box::new(queryable) })
    }

    async fn put(&self, key: &str, payload: Payload, traffic: Traffic) -> Result<(), RuntimeError> {
        self.put_all(key, vec![payload], traffic).await
    }

    async fn put_all(&self, key: &str, payloads: Vec<Payload>, traffic: Traffic) -> Result<(), RuntimeError> {
        if payloads.is_empty() {
            return Ok(());
        }
        let sizes = payloads.iter().map(|payload| message::check_size(payload.bytes.len()));
        sizes.collect::<Result<(), _>>().map_err(|e| RuntimeError::transport(format!("putting to {key}"), e))?;
        let (session, delivery) = self.way_of(traffic).await?;
        let key = key.to_owned();
        // Stops and commands have a priority of their own, with nothing large in it, and must not wait for a thread.
        let waits = matches!(traffic, Traffic::Frame | Traffic::Scene | Traffic::Journal | Traffic::Call(_));
        // One thread takes all of them: what goes at once goes in one packet.
        send("putting", waits, move || {
            payloads.into_iter().try_for_each(|payload| {
                session
                    .put(&key, payload.bytes)
                    .encoding(payload.encoding)
                    .priority(delivery.priority)
                    .congestion_control(delivery.congestion)
                    .express(delivery.is_express)
                    .wait()
            })
        })
        .await
    }

    async fn subscribe(&self, key: &str, capacity: usize) -> Result<Subscription, RuntimeError> {
        let (sender, samples) = mailbox(capacity);
        let subscriber = self
            .session
            .declare_subscriber(key.to_owned())
            .callback(move |sample| {
                if sample.kind() == SampleKind::Put {
                    let payload = payload_of(Some(sample.payload()), Some(sample.encoding()));
                    sender.push(Sample { key: sample.key_expr().to_string(), payload });
                }
            })
            .await
            .map_err(|e| RuntimeError::transport(format!("subscribing to {key}"), e))?;
        Ok(Subscription { samples, _declaration: Box::new(subscriber) })
    }

    async fn declare_alive(&self, key: &str) -> Result<Guard, RuntimeError> {
        let token = self.session.liveliness().declare_token(key.to_owned()).await;
        Ok(Box::new(token.map_err(|e| RuntimeError::transport(format!("declaring {key} alive"), e))?))
    }

    async fn watch_alive(&self, key: &str) -> Result<AliveWatch, RuntimeError> {
        let refused = |e| RuntimeError::transport(format!("watching {key}"), e);
        let (sender, mut keys) = watch::channel(BTreeSet::new());
        let (sender, heard) = (Arc::new(sender), Arc::new(Mutex::new(Heard::default())));
        // The callback alone keeps the sender: the watch ends with the session.
        let (alive, hears, lists) = (Arc::downgrade(&sender), heard.clone(), heard.clone());
        let subscriber = self.session.liveliness().declare_subscriber(key.to_owned()).history(true).callback(move |sample| {
            let key = sample.key_expr().to_string();
            sender.send_modify(|alive: &mut BTreeSet<String>| locked(&hears).take(key, sample.kind(), alive));
        });
        let subscriber = subscriber.await.map_err(refused)?;
        // The history says nothing when it is complete; a query behind it on the same path tells which there are.
        let (listing, listed) = oneshot::channel::<()>();
        let history = self.session.liveliness().get(key.to_owned()).timeout(HISTORY_TIMEOUT).callback(move |reply| {
            // Dropped with this callback, after the last reply.
            let _listing = &listing;
            if let Ok(sample) = reply.result() {
                locked(&lists).listed.insert(sample.key_expr().to_string());
            }
        });
        history.await.map_err(refused)?;
        let _dropped = listed.await;
        catch_up(key, &heard, &alive, &mut keys).await?;
        Ok(AliveWatch { keys, _declaration: Box::new(subscriber) })
    }

    fn is_user(&self) -> bool {
        self.is_user
    }

    fn connection(&self) -> ConnectionStatus {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner).connection
    }

    async fn locators(&self) -> Vec<String> {
        self.session.info().locators().await.iter().map(ToString::to_string).collect()
    }

    async fn close(&self, bound: Duration) -> Result<(), RuntimeError> {
        let closing = "closing the session";
        let all = async {
            if let Some(frames) = self.frames.as_ref().and_then(FrameLink::opened) {
                frames.close().await?;
            }
            self.session.close().await
        };
        match tokio::time::timeout(bound, all).await {
            Ok(closed) => closed.map_err(|e| RuntimeError::transport(closing, e)),
            Err(_) => Err(RuntimeError::transport(closing, format!("took longer than {} ms", bound.as_millis()))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "repose/v1/cell/asked";

    fn query(text: &'static str) -> OutgoingQuery {
        let payload = Payload { encoding: String::new(), bytes: Bytes::from_static(text.as_bytes()) };
        OutgoingQuery { payload, attachment: Bytes::new(), priority: Priority::Interactive, timeout: Duration::from_secs(10) }
    }

    async fn a_query_is_given_up_before_it_is_sent() {
        let transport = ZenohTransport::open(&SessionConfig::default()).await.unwrap();
        let mut queries = transport.serve(KEY, 4).await.unwrap();
        // The one thread that may block is taken: what is to be sent waits for it.
        let (release, taken) = std::sync::mpsc::channel::<()>();
        let blocked = tokio::task::spawn_blocking(move || taken.recv().is_err());
        let mut given_up = transport.query(KEY, query("given up"));
        assert!((&mut given_up).now_or_never().is_none());
        drop(given_up);
        drop(release);
        assert!(blocked.await.unwrap());
        let _replies = transport.query(KEY, query("asked")).await.unwrap();
        assert_eq!(queries.next().await.map(|query| query.payload.bytes), Some(Bytes::from_static(b"asked")));
    }

    #[tokio::test(start_paused = true)]
    async fn a_token_that_is_listed_and_not_told_of_in_time_is_there_until_its_end() {
        let (sender, mut keys) = watch::channel(BTreeSet::new());
        let (sender, heard) = (Arc::new(sender), Mutex::new(Heard::default()));
        let tell = |key: &str, kind| sender.send_modify(|alive| locked(&heard).take(key.to_owned(), kind, alive));
        locked(&heard).listed = ["a", "b", "c"].map(str::to_owned).into();
        tell("b", SampleKind::Delete);
        catch_up(KEY, &heard, &Arc::downgrade(&sender), &mut keys).await.unwrap();
        let is_there = |key: &str| sender.borrow().contains(key);
        assert_eq!(["a", "b", "c"].map(is_there), [true, false, true], "b has ended since");
        tell("a", SampleKind::Delete);
        assert!(!is_there("a"));
        for key in ["a", "b", "c"] {
            tell(key, SampleKind::Put);
        }
        assert_eq!(["a", "b", "c"].map(is_there), [false, false, true], "this tells of the time before");
        tell("a", SampleKind::Put);
        tell("c", SampleKind::Delete);
        assert_eq!((["a", "c"].map(is_there), locked(&heard).late.is_empty()), ([true, false], true));
    }

    #[tokio::test(start_paused = true)]
    async fn a_watch_whose_session_closes_before_it_was_told_of_all_tokens_ends() {
        let (sender, mut keys) = watch::channel(BTreeSet::new());
        let (sender, heard) = (Arc::new(sender), Mutex::new(Heard::default()));
        locked(&heard).listed.insert("a".to_owned());
        let alive = Arc::downgrade(&sender);
        drop(sender);
        assert!(catch_up(KEY, &heard, &alive, &mut keys).await.is_err());
    }

    #[test]
    fn what_cells_go_on_without_waits_for_no_room_on_a_link() {
        for traffic in [Traffic::RobotCommand, Traffic::RobotState, Traffic::Journal, Traffic::Load] {
            assert_eq!(delivery_of(traffic).congestion, CongestionControl::Drop, "{traffic:?}");
        }
    }

    #[test]
    fn a_query_that_is_given_up_while_it_waits_to_be_sent_is_not_sent() {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).max_blocking_threads(1).enable_all().build().unwrap();
        runtime.block_on(a_query_is_given_up_before_it_is_sent());
    }
}
