//! How Zenoh is set up for a session of ours, and opened.

use std::path::Path;
use std::time::Duration;

use crate::RuntimeError;
use crate::config::{SessionConfig, SessionMode};
use crate::diagnosis::Credentials;
use crate::expiry::{CertificateReading, watch_certificate};
use crate::opening::{RouterEntry, open_apart};

/// The least time of an attempt at a link, milliseconds: a few round trips between busy machines.
const LEAST_ATTEMPT_MS: u64 = 1000;

/// Parts, of 64 KiB, of copies of calls that may wait on a link, which nothing else of ours shares its priority with. As many as Zenoh allows: copies come
/// several together, and are dropped where they find no room.
const COPY_PARTS_WAITING: usize = 16;
/// How long a message that may be dropped waits for room, once: on a link that stands still, what comes after it is dropped at once. Longer than a busy
/// machine takes to run the thread that sends; Zenoh's own millisecond is not, and loses copies where nobody is slow.
const MESSAGE_WAIT: Duration = Duration::from_millis(50);
/// How long a large message that may be dropped is given to find room, from its first part to its last: copies of two megabytes get through links of
/// 100 Mbit/s. Higher: who reads slowly holds up a router's receiving threads for longer, by which all else comes.
const LARGE_MESSAGE_WAIT: Duration = Duration::from_millis(100);

/// Opens a session; its errors are those of [`crate::zenoh_transport::ZenohTransport::open`].
pub(crate) async fn open_session(config: &SessionConfig, zenoh_config: zenoh::Config) -> Result<zenoh::Session, RuntimeError> {
    let endpoints = match config.mode {
        SessionMode::Client => connect_endpoints(&zenoh_config),
        _ => Vec::new(),
    };
    if let Some(tls) = endpoints.iter().find(|endpoint| endpoint.starts_with("tls/")) {
        return Err(RuntimeError::transport(
            "opening the session",
            format!("{tls}: tls/ is not built in; quic/ takes the same certificates"),
        ));
    }
    let opened = match endpoints.is_empty() {
        true => open_apart(zenoh_config).await.map_err(|why| ("opening the session".to_owned(), why)),
        false => {
            let operation = format!("opening the session (connecting to {})", endpoints.join(", "));
            let (credentials, bound) = (Credentials::of(&zenoh_config), Duration::from_millis(config.connect_timeout_ms));
            let opening = RouterEntry { config: zenoh_config, endpoints, credentials, attempt: attempt_time(config), bound };
            opening.run().await.map_err(|why| (operation, why))
        }
    };
    opened.map_err(|(operation, why)| RuntimeError::transport(operation, why))
}

/// Our settings over Zenoh's defaults, or over the file that the configuration names.
pub(crate) fn zenoh_config(config: &SessionConfig) -> Result<zenoh::Config, RuntimeError> {
    let unusable = |key: &str, e: &dyn std::fmt::Display| RuntimeError::Config {
        section: "session".to_owned(),
        file: config.zenoh_file.clone(),
        message: format!("{key}: {e}"),
    };
    let mut zenoh_config = match &config.zenoh_file {
        Some(file) => zenoh::Config::from_file(file).map_err(|e| unusable("zenoh_file", &e))?,
        None => zenoh::Config::default(),
    };
    let mode = match config.mode {
        SessionMode::Embedded | SessionMode::Peer => "peer",
        SessionMode::Client => "client",
        SessionMode::Router => "router",
    };
    // A router comes up whether or not its companions are there, and goes on trying; a client's attempts are ours to repeat.
    let connect_timeout_ms = match config.mode {
        SessionMode::Router => -1,
        SessionMode::Client => 0,
        SessionMode::Embedded | SessionMode::Peer => i64::try_from(config.connect_timeout_ms).unwrap_or(i64::MAX),
    };
    let is_router = config.mode == SessionMode::Router;
    let mut values = vec![
        ("mode", serde_json::json!(mode)),
        ("scouting/multicast/enabled", serde_json::json!(false)),
        ("scouting/gossip/enabled", serde_json::json!(false)),
        ("transport/link/tx/lease", serde_json::json!(config.lease_ms)),
        ("transport/link/rx/max_message_size", serde_json::json!(config.max_receive_bytes)),
        ("transport/unicast/max_sessions", serde_json::json!(config.max_sessions)),
        // When a hall is switched on all of them come at once.
        ("transport/unicast/accept_pending", serde_json::json!(config.max_sessions)),
        ("connect/timeout_ms", serde_json::json!(connect_timeout_ms)),
        ("connect/exit_on_failure", serde_json::json!(!is_router)),
        // A router that comes back is found within half a second, and not hammered.
        ("connect/retry", serde_json::json!({"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5})),
        ("transport/unicast/open_timeout", serde_json::json!(attempt_time(config).as_millis() as u64)),
        ("transport/link/tx/queue/size/data", serde_json::json!(COPY_PARTS_WAITING)),
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", serde_json::json!(MESSAGE_WAIT.as_micros() as u64)),
        (
            "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments",
            serde_json::json!(LARGE_MESSAGE_WAIT.as_micros() as u64),
        ),
        // Nothing here reads a message's time of sending; a router that puts one on complains of every message from a host whose clock is ahead of its own.
        ("timestamping/enabled", serde_json::json!(false)),
        ("queries_default_timeout", serde_json::json!(config.query_timeout_ms)),
    ];
    // A file may name the endpoints; ours stand over them where there are any.
    if !config.connect.is_empty() || config.zenoh_file.is_none() {
        values.push(("connect/endpoints", serde_json::json!(config.connect)));
    }
    if !config.listen.is_empty() || config.zenoh_file.is_none() {
        values.push(("listen/endpoints", serde_json::json!(config.listen)));
    }
    for (key, value) in values {
        zenoh_config.insert_json5(key, &value.to_string()).map_err(|e| unusable(key, &e))?;
    }
    Ok(zenoh_config)
}

/// Has the certificates of a session's links looked after.
///
/// # Errors
/// When the configuration is unusable.
pub(crate) fn watch_certificates(config: &SessionConfig) -> Result<(), RuntimeError> {
    // Nothing else names any.
    if config.zenoh_file.is_none() {
        return Ok(());
    }
    let zenoh_config = zenoh_config(config)?;
    let said = |key: &str| zenoh_config.get_json(key).ok();
    let has_secured_links = ["connect/endpoints", "listen/endpoints"].map(said).into_iter().flatten().any(|json| json.contains("\"quic"));
    if !has_secured_links {
        return Ok(());
    }
    let listens = config.mode != SessionMode::Client;
    let is_mutual = said("transport/link/tls/enable_mtls").is_some_and(|json| json == "true");
    // What a listener has read stays until the process starts again; for a link to somewhere else it is read when that link is made.
    let of_both = if listens { CertificateReading::Once } else { CertificateReading::Again };
    let files = [
        ("listen_certificate", listens, CertificateReading::Once),
        ("connect_certificate", is_mutual, CertificateReading::Again),
        ("root_ca_certificate", true, of_both),
    ];
    for (key, is_used, reading) in files {
        let file = said(&format!("transport/link/tls/{key}")).and_then(|json| serde_json::from_str::<Option<String>>(&json).ok()?);
        if let Some(file) = file.filter(|_| is_used) {
            watch_certificate(Path::new(&file), reading);
        }
    }
    Ok(())
}

/// How long one attempt at a link may take: what a dying router has left unanswered is tried again within the time for all.
fn attempt_time(config: &SessionConfig) -> Duration {
    Duration::from_millis((config.connect_timeout_ms / 2).max(LEAST_ATTEMPT_MS))
}

/// Where a client connects to, as its configuration and its file say together.
fn connect_endpoints(config: &zenoh::Config) -> Vec<String> {
    let endpoints = config.get_json("connect/endpoints").ok().and_then(|json| serde_json::from_str::<serde_json::Value>(&json).ok());
    let list = endpoints.map(|value| value.get("client").cloned().unwrap_or(value));
    let texts = list.as_ref().and_then(serde_json::Value::as_array).into_iter().flatten().filter_map(serde_json::Value::as_str);
    texts.map(str::to_owned).collect()
}
