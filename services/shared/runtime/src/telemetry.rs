//! What a process tells of itself: logs to standard error, metrics and health over HTTP, and, with the feature `otlp`, traces to a collector.
//!
//! Zenoh's own log is passed through a sieve: a line that holds a configuration, and so a password, never comes out, and a router says in
//! plain words whom it did not let in and what it refused.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::io::IsTerminal;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use lru::LruCache;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Metadata, Subscriber};
use tracing_subscriber::filter::FilterExt;
use tracing_subscriber::layer::{Context, Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, filter};

use crate::log_lines::EventWriter;

/// The environment variable with the filter, `info` or `repose_planner=debug,warn`.
pub const LOG_VARIABLE: &str = "REPOSE_LOG";
/// The environment variable that switches to one JSON document a line when it is `json`.
pub const FORMAT_VARIABLE: &str = "REPOSE_LOG_FORMAT";

/// Starts logging. The filter is `REPOSE_LOG` where it is set and valid, `default` otherwise. Later calls in the same process do nothing.
pub fn start_logging(default: &str) {
    let chosen = EnvFilter::try_from_env(LOG_VARIABLE).unwrap_or_else(|_| EnvFilter::new(default));
    // An error here means that a subscriber is set already, by an embedding program or a test.
    let _already_set = subscriber(chosen).try_init();
}

/// What hears of events and spans. Each layer's one filter says all that it wants: where a layer lets everything through and another filter comes
/// behind it, every trace line and span of Zenoh's is made for each message, and thrown away.
fn subscriber(chosen: EnvFilter) -> impl Subscriber + Send + Sync {
    // Color codes are for eyes: a file or a journal gets none.
    let colors = std::io::stderr().is_terminal();
    let json = std::env::var(FORMAT_VARIABLE).is_ok_and(|v| v == "json");
    // A log that nobody reads any more (`2>&1 | head`) is no reason to end: reporting that on standard error would panic.
    let lines =
        tracing_subscriber::fmt::layer().with_ansi(colors).with_writer(|| EventWriter(std::io::stderr())).log_internal_errors(false);
    let lines = match json {
        true => lines.json().boxed(),
        false => lines.boxed(),
    };
    let lines = lines.with_filter(chosen.and(filter::filter_fn(|metadata| !may_hold_secrets(metadata))));
    let refusals = Refusals::start().with_filter(filter::filter_fn(is_refusal));
    tracing_subscriber::registry().with(lines).with(refusals).with(spans())
}

/// Where spans go to: the collector that `OTEL_EXPORTER_OTLP_ENDPOINT` names.
#[cfg(feature = "otlp")]
fn spans<S: Subscriber + for<'a> tracing_subscriber::registry::LookupSpan<'a> + Send + Sync>() -> impl Layer<S> + Send + Sync {
    let collector = collector();
    let is_wanted = collector.is_some();
    collector.with_filter(filter::filter_fn(move |metadata| is_wanted && metadata.is_span() && metadata.target().starts_with("repose")))
}

/// The layer that sends spans there.
#[cfg(feature = "otlp")]
fn collector<S: Subscriber + for<'a> tracing_subscriber::registry::LookupSpan<'a> + Send + Sync>() -> Option<impl Layer<S> + Send + Sync> {
    use opentelemetry::trace::TracerProvider;
    std::env::var_os("OTEL_EXPORTER_OTLP_ENDPOINT")?;
    let exporter = match opentelemetry_otlp::SpanExporter::builder().with_http().build() {
        Ok(exporter) => exporter,
        Err(error) => {
            eprintln!("traces go nowhere: {error}");
            return None;
        }
    };
    let resource = opentelemetry_sdk::Resource::builder().with_service_name("repose").build();
    let provider = opentelemetry_sdk::trace::SdkTracerProvider::builder().with_batch_exporter(exporter).with_resource(resource).build();
    let layer = tracing_opentelemetry::layer().with_tracer(provider.tracer("repose"));
    opentelemetry::global::set_tracer_provider(provider);
    Some(layer)
}

/// Without the feature spans go nowhere. A layer without a filter would have them all made nevertheless.
#[cfg(not(feature = "otlp"))]
fn spans<S: Subscriber + for<'a> tracing_subscriber::registry::LookupSpan<'a>>() -> impl Layer<S> + Send + Sync {
    tracing_subscriber::layer::Identity::new().with_filter(filter::LevelFilter::OFF)
}

/// Zenoh prints a session's whole configuration when it opens, password and all.
fn may_hold_secrets(metadata: &Metadata<'_>) -> bool {
    metadata.target() == "zenoh::api::session" && *metadata.level() >= Level::DEBUG
}

/// Where Zenoh says who wants to be let in, and why not.
const ACCEPTING: &str = "zenoh_transport::unicast::establishment::accept";
/// Where it says whose certificate is no good.
const QUIC: &str = "zenoh_link_commons::quic";

/// What a router refuses, by the names in its log and its metrics.
pub(crate) const REFUSED_KINDS: [&str; 2] = [LOGIN_REFUSED, MESSAGE_REFUSED];
const LOGIN_REFUSED: &str = "login";
const MESSAGE_REFUSED: &str = "message";

/// Where Zenoh says that it refuses a message or a login: at levels that nobody reads.
fn is_refusal(metadata: &Metadata<'_>) -> bool {
    metadata.target().starts_with("zenoh::net::routing::interceptor::access_control")
        || metadata.target() == ACCEPTING
        || (metadata.target().starts_with(QUIC) && *metadata.level() <= Level::ERROR)
}

/// Says in our words, and once a day for each, what the router refuses.
struct Refusals {
    found: SyncSender<(&'static str, String)>,
    /// Which user a session is, by its id: a router that runs for long sees many, of which the last ones count.
    subjects: Mutex<LruCache<String, String>>,
}

thread_local! {
    /// The key that access control is working out every permission of, on this thread: what it finds there was not asked for by anybody.
    static CACHING: RefCell<Option<String>> = const { RefCell::new(None) };
    /// Where the login came from that is looked at on this thread.
    static LOGIN: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Refusals that may wait to be said; a flood is not worth more.
const MOST_WAITING: usize = 256;
/// Different refusals that are said; further ones are counted only, for nobody may fill a log from afar.
const MOST_SAID: usize = 1000;
/// How long one that was said is not said again. A router runs for months: the lines of its first days have long gone with their files, and a user who
/// is refused today is looked for in the log of today.
const SAID_FOR: Duration = Duration::from_secs(24 * 3600);
/// How long they are counted only; then all are said anew.
const SAYS_NO_MORE: Duration = Duration::from_secs(3600);
/// Sessions whose user is remembered; the one that was heard of least recently is forgotten first.
const MOST_SUBJECTS: usize = 4096;
/// The last of the permissions that access control works out together.
const LAST_CACHED: &str = "Declare Liveliness Subscriber (";

/// The refusals that were said lately.
struct Said {
    known: BTreeSet<String>,
    /// When the first may have been.
    since: Instant,
    /// When there were too many of them.
    full_since: Option<Instant>,
}

impl Said {
    fn none(since: Instant) -> Self {
        Self { known: BTreeSet::new(), since, full_since: None }
    }

    /// What is to be said of a refusal: itself, unless it was; or that further ones are not.
    fn news(&mut self, words: String, now: Instant) -> Option<String> {
        // Names are made up anew all the time: a router that runs for long has seen too many without anybody meaning it.
        let (since, anew_after) = self.full_since.map_or((self.since, SAID_FOR), |full_since| (full_since, SAYS_NO_MORE));
        if now.saturating_duration_since(since) >= anew_after {
            *self = Self::none(now);
        }
        if self.known.contains(&words) {
            return None;
        }
        if self.known.len() < MOST_SAID {
            self.known.insert(words.clone());
            return Some(words);
        }
        let is_first = self.full_since.is_none();
        self.full_since = self.full_since.or(Some(now));
        let minutes = SAYS_NO_MORE.as_secs() / 60;
        is_first.then(|| format!("{MOST_SAID} different refusals were said: for {minutes} minutes further ones are counted only"))
    }
}

impl Refusals {
    fn start() -> Self {
        let (found, said) = sync_channel::<(&'static str, String)>(MOST_WAITING);
        // A line must not be written while another is on its way through the layers: a thread of its own does it.
        let say = move || {
            let mut known = Said::none(Instant::now());
            while let Ok((kind, words)) = said.recv() {
                metrics::counter!("repose_router_refused_total", "kind" => kind).increment(1);
                if let Some(words) = known.news(words, Instant::now()) {
                    tracing::error!(kind, "{words}");
                }
            }
        };
        if let Err(error) = std::thread::Builder::new().name("refusals".to_owned()).spawn(say) {
            eprintln!("what the router refuses will not be said: {error}");
        }
        Self { found, subjects: Mutex::new(LruCache::unbounded()) }
    }

    /// A refusal in our words, if the line is one.
    fn refusal(&self, target: &str, line: &str) -> Option<(&'static str, String)> {
        if target == ACCEPTING || target.starts_with(QUIC) {
            return refused_login(line).map(|words| (LOGIN_REFUSED, words));
        }
        if let Some(key) = cached_in_advance(line) {
            CACHING.set(Some(key.to_owned()));
            return None;
        }
        let decision = Decision::read(line)?;
        let subject = self.subject(&decision);
        let is_caching = !decision.is_cached && CACHING.with_borrow(|key| key.as_deref() == Some(decision.key));
        if !is_caching || decision.action.starts_with(LAST_CACHED) {
            CACHING.set(None);
        }
        // What the router does not pass on to a user is as it should be; what a user sends and may not is a mistake, or worse.
        if decision.is_allowed || is_caching || !decision.action.contains("(ingress)") {
            return None;
        }
        let Decision { action, key, .. } = decision;
        let action = action.trim_end_matches("(ingress)").trim();
        let broad =
            if action.contains("Subscriber") && key.contains('*') { "; a subscription must lie within what is allowed" } else { "" };
        // Whoever was refused chose the key, line ends and all.
        Some((MESSAGE_REFUSED, format!("refused: {subject} may not {action} at {}{broad}", key.escape_debug())))
    }

    /// Who a decision is about: only those that are not from the cache name the user.
    fn subject(&self, decision: &Decision<'_>) -> String {
        let mut subjects = self.subjects.lock().unwrap_or_else(PoisonError::into_inner);
        match decision.subject {
            Some(subject) => {
                subjects.put(decision.session.to_owned(), subject.to_owned());
                if subjects.len() > MOST_SUBJECTS {
                    subjects.pop_lru();
                }
                subject.to_owned()
            }
            None => subjects.get(decision.session).cloned().unwrap_or_else(|| format!("session {}", decision.session)),
        }
    }
}

/// The key whose permissions access control begins to work out, where a line says so at its beginning. A key that is refused may say the same,
/// further on.
fn cached_in_advance(line: &str) -> Option<&str> {
    let (_, rest) = line.strip_prefix("ACL (")?.split_once("): caching permissions for `")?;
    Some(rest.rsplit_once('`').map_or(rest, |(key, _)| key))
}

/// A login that is refused, in our words. Zenoh says first whose it looks at, `Establishment Accept OpenSyn: <ours> => <theirs>. Received: …`, and
/// then what is wrong with it, `UsrPwd extension - Recv OpenSyn. Invalid password.`
fn refused_login(line: &str) -> Option<String> {
    if let Some((link, _)) = line.strip_prefix("Establishment Accept OpenSyn: ").and_then(|rest| rest.split_once(". Received")) {
        LOGIN.set(link.rsplit("=> ").next().map(str::to_owned));
        return None;
    }
    let why = match line {
        _ if line.contains("Invalid user.") => "the router does not know that user",
        _ if line.contains("Invalid password.") => "the password is wrong",
        _ if line.contains("UsrPwd extension") && line.contains("Expected extension") => "it names no user",
        _ if line.contains("Cannot accept QUIC") && line.contains("ertificate") => {
            return Some(format!("refused a login: {}", crate::error::without_source_lines(line)));
        }
        _ => return None,
    };
    let from = LOGIN.take().map_or_else(String::new, |from| format!(" from {}", host_of(&from)));
    Some(format!("refused a login{from}: {why}"))
}

/// The host of an endpoint: whoever tries again comes from another port, and a log has one line of each.
fn host_of(endpoint: &str) -> &str {
    let address = endpoint.split_once('/').map_or(endpoint, |(_, address)| address);
    address.rsplit_once(':').map_or(address, |(host, _)| host)
}

/// A decision of access control: `<session> on <subject> is unauthorized to <action> on <key>`, or
/// `Using cached result: <session> is unauthorized to <action> on <key>`.
#[derive(Debug, PartialEq, Eq)]
struct Decision<'a> {
    session: &'a str,
    subject: Option<&'a str>,
    is_allowed: bool,
    is_cached: bool,
    action: &'a str,
    key: &'a str,
}

impl<'a> Decision<'a> {
    /// Reads a line from its front: its end is a key, which may say anything.
    fn read(line: &'a str) -> Option<Self> {
        let verbs = [(" is unauthorized to ", false), (" is authorized to ", true)];
        let first = verbs.into_iter().filter_map(|(verb, is_allowed)| Some((line.find(verb)?, verb, is_allowed))).min();
        let (at, verb, is_allowed) = first?;
        let (who, what) = (&line[..at], &line[at + verb.len()..]);
        let (action, key) = what.split_once(" on ")?;
        let cached = who.strip_prefix("Using cached result: ");
        let (session, subject) = match (cached, who.split_once(" on ")) {
            (Some(session), _) => (session, None),
            (None, Some((session, subject))) => (session, Some(subject)),
            (None, None) => (who, None),
        };
        Some(Self { session, subject, is_allowed, is_cached: cached.is_some(), action, key })
    }
}

impl<S: Subscriber> Layer<S> for Refusals {
    fn on_event(&self, event: &Event<'_>, _context: Context<'_, S>) {
        let mut message = Message(String::new());
        event.record(&mut message);
        if let Some(refusal) = self.refusal(event.metadata().target(), &message.0) {
            // Where too many wait already, this one is like them.
            drop(self.found.try_send(refusal));
        }
    }
}

/// An event's message.
struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        use std::fmt::Write as _;
        if field.name() == "message" {
            // Writing to a string does not fail.
            let _infallible = write!(self.0, "{value:?}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ACCESS: &str = "zenoh::net::routing::interceptor::access_control";

    #[test]
    fn what_nobody_reads_is_not_made() {
        tracing::subscriber::with_default(subscriber(EnvFilter::new("warn,zenoh=error,repose=info")), || {
            let lines = [
                tracing::enabled!(target: "zenoh_transport::unicast::universal::rx", Level::TRACE),
                tracing::enabled!(target: "zenoh::api::session", Level::DEBUG),
                tracing::enabled!(target: "tokio_tungstenite", Level::INFO),
                tracing::enabled!(target: "zenoh_transport", Level::ERROR),
                tracing::enabled!(target: "repose_perception", Level::INFO),
                tracing::enabled!(target: ACCESS, Level::TRACE),
            ];
            assert_eq!(lines, [false, false, false, true, true, true]);
            assert!(tracing::trace_span!(target: "zenoh_transport", "a message").is_disabled());
            assert!(tracing::info_span!(target: "zenoh_transport", "a link").is_disabled());
        });
    }

    #[test]
    fn what_a_user_sends_and_may_not_is_said_with_user_verb_and_key() {
        let refusals = Refusals::start();
        let line = "3f on lo+anna+quic is unauthorized to Declare Subscriber (ingress) on repose/v1/**";
        let (kind, words) = refusals.refusal(ACCESS, line).expect("a refusal");
        assert_eq!(kind, "message");
        assert!(words.contains("lo+anna+quic may not Declare Subscriber at repose/v1/**; a subscription"), "{words}");
        assert_eq!(refusals.refusal(ACCESS, "3f on lo is authorized to Put (ingress) on repose/v1/lab/scene/front"), None);
        assert_eq!(refusals.refusal(ACCESS, "3f on lo is unauthorized to Put (egress) on repose/v1/lab/scene/front"), None);
    }

    #[test]
    fn what_is_worked_out_in_advance_is_nobodys_attempt_and_what_is_tried_later_is() {
        let refusals = Refusals::start();
        let key = "repose/v1/lab/robot/panda/command";
        assert_eq!(refusals.refusal(ACCESS, &format!("ACL (ingress): caching permissions for `{key}` ...")), None);
        for action in ["Query", "Put", "Declare/Undeclare Subscriber", "Declare Liveliness Subscriber"] {
            assert_eq!(
                refusals.refusal(ACCESS, &format!("3f on lo+anna is unauthorized to {action} (ingress) on {key}")),
                None,
                "{action}"
            );
        }
        let tried = format!("Using cached result: 3f is unauthorized to Put (ingress) on {key}");
        let (_, words) = refusals.refusal(ACCESS, &tried).expect("a refusal");
        assert!(words.contains("lo+anna may not Put at"), "the user is known from before: {words}");
    }

    #[test]
    fn a_flood_of_refusals_is_said_up_to_a_bound_and_the_log_is_not_deaf_for_good() {
        let began = Instant::now();
        let mut said = Said::none(began);
        let mut news = |words: &str, s: u64| said.news(words.to_owned(), began + Duration::from_secs(s));
        for i in 0..MOST_SAID {
            assert!(news(&format!("refusal {i}"), 0).is_some());
        }
        assert_eq!(news("refusal 0", 0), None, "each is said once");
        assert!(news("one more", 0).is_some_and(|words| words.contains("counted only")), "that it falls silent is said");
        let silent = SAYS_NO_MORE.as_secs() - 1;
        assert_eq!((news("one more", 1), news("refused a login", silent)), (None, None));
        assert_eq!(news("refused a login", silent + 1).as_deref(), Some("refused a login"));
    }

    #[test]
    fn no_key_hides_a_refusal_or_makes_one_up() {
        let refusals = Refusals::start();
        let (session, command) = ("3f on lo+anna", "repose/v1/lab/robot/panda/command");
        let said = |line: &str| refusals.refusal(ACCESS, line).map(|(_, words)| words);
        let hidden = said(&format!("{session} is unauthorized to Put (ingress) on x caching permissions for `{command}` ..."));
        assert!(hidden.is_some_and(|words| words.contains("lo+anna may not Put at x caching")));
        assert!(said(&format!("{session} is unauthorized to Put (ingress) on {command}")).is_some(), "nobody works it out in advance");
        let allowed = "repose/v1/lab/robot/4e on lo+bert is unauthorized to Put (ingress) on x/@estop";
        assert_eq!(said(&format!("{session} is authorized to Put (ingress) on {allowed}")), None);
        let words =
            said(&format!("{session} is unauthorized to Put (ingress) on a on b\n2026-11-27 ERROR refused a login")).expect("a refusal");
        assert_eq!(words, "refused: lo+anna may not Put at a on b\\n2026-11-27 ERROR refused a login");
    }

    #[test]
    fn the_user_of_a_session_is_known_however_many_came_before() {
        let refusals = Refusals::start();
        let (last, key) = (MOST_SUBJECTS + 1, "repose/v1/lab/scene/front");
        for i in 0..=last {
            assert_eq!(refusals.refusal(ACCESS, &format!("{i:x} on lo+user-{i} is authorized to Put (ingress) on {key}")), None);
        }
        let said = |session: usize| {
            let tried = format!("Using cached result: {session:x} is unauthorized to Put (ingress) on {key}");
            refusals.refusal(ACCESS, &tried).expect("a refusal").1
        };
        assert!(said(last).contains(&format!("lo+user-{last} may not Put")), "{}", said(last));
        assert!(said(0).contains("session 0 may not Put"), "{}", said(0));
    }

    #[test]
    fn a_refusal_is_said_once_a_day_however_long_the_router_runs() {
        let start = Instant::now();
        let mut said = Said::none(start);
        let mut is_said = |words: &str, at: Instant| said.news(words.to_owned(), at).is_some();
        assert!(is_said("the password is wrong", start) && !is_said("the password is wrong", start + SAID_FOR / 2));
        let tomorrow = start + SAID_FOR;
        assert!(is_said("the password is wrong", tomorrow) && is_said("something new", tomorrow));
        assert!(!is_said("something new", tomorrow + SAID_FOR / 2));
    }

    #[test]
    fn what_is_wrong_with_a_login_is_said_and_other_trouble_of_links_is_not() {
        let refusals = Refusals::start();
        let said = |line: &str| refusals.refusal(ACCEPTING, line);
        assert_eq!(said("Establishment Accept OpenSyn: quic/10.0.0.1:7447 => quic/10.0.0.9:51234. Received: TransportMessage {}"), None);
        let (kind, words) = said("UsrPwd extension - Recv OpenSyn. Invalid password. at file.rs:424.").expect("a refusal");
        assert_eq!((kind, words.as_str()), ("login", "refused a login from 10.0.0.9: the password is wrong"));
        let (_, words) = said("UsrPwd extension - Recv OpenSyn. Invalid user.").expect("a refusal");
        assert_eq!(words, "refused a login: the router does not know that user", "where that one came from is not known");
        assert_eq!(said("Received an unexpected message"), None);
        assert!(
            refusals.refusal("zenoh_link_commons::quic::unicast", "Cannot accept QUIC connection: peer sent no certificates").is_some()
        );
    }
}
