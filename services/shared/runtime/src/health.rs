//! Health and metrics over HTTP, for orchestrators and Prometheus: `/live`, `/ready` and `/metrics`.

use std::net::SocketAddr;
use std::sync::OnceLock;
use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::http::StatusCode;
use axum::routing::get;
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use tokio_util::sync::DropGuard;

use crate::{RuntimeError, Session, Shutdown, expiry, serve_http};

/// Every metric that a process tells: its name, and what it counts. Boards and alerts name these and no others.
pub const METRICS: [(&str, &str); 23] = [
    ("repose_requests_total", "Calls that ended, by service, method and code (`result` or an error's)"),
    ("repose_request_seconds", "From a call's arrival to its end, seconds"),
    ("repose_queue_seconds", "From a job's submission to the moment that a thread took it, seconds"),
    ("repose_compute_seconds", "Computing what a thread took at once, seconds"),
    ("repose_batch_jobs", "Jobs that a thread took at once"),
    ("repose_refused_total", "Calls and jobs refused or displaced for lack of room or time"),
    ("repose_refusals_heeded_total", "Batch calls that were not sent, by the service whose workers had just refused others like them"),
    ("repose_queue_waiting", "Jobs that wait"),
    ("repose_calls_running", "Calls being computed"),
    ("repose_draining", "1 while a worker takes no new calls"),
    ("repose_worker_info", "1 for what a worker serves, 0 for what it served before; its labels say weights, kernel and version"),
    ("repose_messages_dropped_total", "Messages that were dropped because nobody took them in time"),
    ("repose_journal_dropped_total", "Copies of calls that a recorder did not get, because they were not taken in time"),
    ("repose_links", "Links to other processes: a router's sessions"),
    ("repose_router_refused_total", "Logins and messages that the router refused"),
    ("repose_certificate_expires_in_seconds", "Seconds until a certificate in use expires, by its file; negative afterwards"),
    ("repose_perception_frames_total", "Frames by what they became"),
    ("repose_perception_frame_to_scene_seconds", "From a frame's arrival to its scene, seconds"),
    ("repose_ros2_pictures_total", "Pictures of a ROS 2 camera by what they became"),
    ("repose_ros2_picture_to_frame_seconds", "From the arrival of a frame's last picture to the frame on the wire, seconds"),
    ("repose_scenes_held", "Scenes that a worker holds by id"),
    ("process_resident_memory_bytes", "Memory of the process"),
    ("process_open_fds", "Open file descriptors of the process"),
];

/// Bounds of histograms of times, seconds.
const SECONDS: [f64; 14] = [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0];
/// Bounds of the histogram of batch sizes.
const JOBS: [f64; 6] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
/// How often the exporter counts what histograms were given. Until then it keeps every value; a process whose metrics nobody asks for would keep them
/// all.
const UPKEEP: Duration = Duration::from_secs(5);

/// The process's metrics: one recorder, however many sessions it has.
fn recorder() -> Result<PrometheusHandle, String> {
    static RECORDER: OnceLock<Result<PrometheusHandle, String>> = OnceLock::new();
    let install = || {
        let builder = PrometheusBuilder::new()
            .set_buckets_for_metric(Matcher::Suffix("_seconds".to_owned()), &SECONDS)
            .and_then(|builder| builder.set_buckets_for_metric(Matcher::Suffix("_jobs".to_owned()), &JOBS));
        let recorder = builder.and_then(PrometheusBuilder::install_recorder).map_err(|e| e.to_string())?;
        for (name, help) in METRICS {
            // The exporter files helps by the name alone, whatever kind they are given for.
            metrics::describe_gauge!(name, help);
        }
        let kept = recorder.clone();
        std::thread::Builder::new().name("metrics".to_owned()).spawn(move || keep_up(&kept)).map_err(|e| e.to_string())?;
        Ok(recorder)
    };
    RECORDER.get_or_init(install).clone()
}

/// Counts what histograms were given, for as long as the process runs.
fn keep_up(recorder: &PrometheusHandle) {
    loop {
        std::thread::sleep(UPKEEP);
        recorder.run_upkeep();
    }
}

/// Starts to count metrics in this process; what was counted before is lost, so this comes first. [`HealthServer::of`] serves them.
///
/// # Errors
/// When another recorder is installed.
pub fn start_metrics() -> Result<(), RuntimeError> {
    recorder().map(drop).map_err(|e| RuntimeError::transport("counting metrics", e))
}

/// Serves health and metrics until it is dropped.
pub struct HealthServer {
    address: SocketAddr,
    _stop: DropGuard,
}

#[derive(Clone)]
struct Told {
    session: Session,
    serves: bool,
    metrics: PrometheusHandle,
}

impl HealthServer {
    /// Listens at `listen`, `127.0.0.1:9464`; port 0 picks one. With `serves`, the process is ready once a worker serves and the router is there.
    ///
    /// # Errors
    /// When the address cannot be listened at.
    pub async fn start(listen: &str, session: Session, serves: bool) -> Result<Self, RuntimeError> {
        let fail = |source| RuntimeError::System { operation: format!("listening for health and metrics at {listen}"), source };
        let metrics = recorder().map_err(|e| RuntimeError::transport("counting metrics", e))?;
        let listener = tokio::net::TcpListener::bind(listen).await.map_err(fail)?;
        let address = listener.local_addr().map_err(fail)?;
        let told = Told { session, serves, metrics };
        let pages = Router::new()
            .route("/live", get(|| async { "live\n" }))
            .route("/ready", get(ready))
            .route("/metrics", get(metrics_page))
            .with_state(told);
        let stop = Shutdown::new();
        let stopped = stop.clone();
        tokio::spawn(async move { serve_http(listener, pages, &stopped).await });
        tracing::info!(%address, "health and metrics");
        Ok(Self { address, _stop: stop.on_drop() })
    }

    /// The server that a session's configuration asks for, section `[telemetry]`; none where it asks for none.
    ///
    /// # Errors
    /// As [`HealthServer::start`].
    pub async fn of(session: &Session, serves: bool) -> Result<Option<Self>, RuntimeError> {
        match session.telemetry().listen.as_deref() {
            Some(listen) => Self::start(listen, session.clone(), serves).await.map(Some),
            None => Ok(None),
        }
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

async fn ready(State(told): State<Told>) -> (StatusCode, &'static str) {
    match (told.session.transport().connection().is_up, told.session.serving() > 0 || !told.serves) {
        (false, _) => (StatusCode::SERVICE_UNAVAILABLE, "the router is away\n"),
        (true, false) => (StatusCode::SERVICE_UNAVAILABLE, "not serving yet, or draining\n"),
        (true, true) => (StatusCode::OK, "ready\n"),
    }
}

async fn metrics_page(State(told): State<Told>) -> String {
    process_metrics();
    expiry::tell_metric();
    told.metrics.render()
}

/// What the operating system knows of the process.
#[cfg(target_os = "linux")]
fn process_metrics() {
    if let Some(bytes) = std::fs::read_to_string("/proc/self/status").ok().and_then(|status| resident_bytes(&status)) {
        metrics::gauge!("process_resident_memory_bytes").set(bytes);
    }
    if let Ok(open) = std::fs::read_dir("/proc/self/fd") {
        metrics::gauge!("process_open_fds").set(open.count() as f64);
    }
}

/// The memory in use, of the lines of `/proc/self/status`. These count in KiB on every machine; `statm` counts in pages, of which some have 16 or 64 KiB.
#[cfg(target_os = "linux")]
fn resident_bytes(status: &str) -> Option<f64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(line.trim().strip_suffix(" kB")?.parse::<f64>().ok()? * 1024.0)
}

#[cfg(not(target_os = "linux"))]
fn process_metrics() {}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn resident_memory_is_read_in_its_unit_whatever_a_page_has() {
        let status = "Name:\trepose\nVmHWM:\t  300000 kB\nVmRSS:\t  123456 kB\nRssAnon:\t   99 kB\n";
        assert_eq!(resident_bytes(status), Some(126_418_944.0));
        let ours = std::fs::read_to_string("/proc/self/status").expect("Linux tells it");
        assert!(resident_bytes(&ours).is_some_and(|bytes| bytes > 1e5), "{ours}");
        assert_eq!(resident_bytes("Name:\tkernel thread\n"), None);
    }
}
