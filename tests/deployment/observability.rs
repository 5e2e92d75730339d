//! Health and metrics of real processes, asked for over HTTP as an orchestrator and Prometheus ask.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use repose_proto::scoring::ModelsRequest;
use repose_proto::{Payload, Service};
use repose_runtime::{CallOptions, RuntimeConfig, Session, SessionMode};

use crate::common::{PATIENCE, repose};
use crate::processes::Logged;

/// A page's status and text.
fn page(address: &str, path: &str) -> (u16, String) {
    let mut stream = TcpStream::connect(address).expect("it listens");
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").expect("sent");
    let mut reply = String::new();
    stream.read_to_string(&mut reply).expect("a reply");
    let status = reply.split(' ').nth(1).and_then(|code| code.parse().ok()).expect("a status");
    (status, reply.split_once("\r\n\r\n").expect("a body").1.to_owned())
}

fn becomes(address: &str, path: &str, status: u16) -> String {
    let give_up = Instant::now() + PATIENCE;
    loop {
        let (got, text) = page(address, path);
        if got == status {
            return text;
        }
        assert!(Instant::now() < give_up, "{path} stays at {got}: {text}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Starts a process that tells its health on a port of its own, and returns where.
fn start(what: &str, endpoint: &str) -> (Logged, String) {
    start_with(what, endpoint, &[])
}

/// The same with these settings.
fn start_with(what: &str, endpoint: &str, settings: &[(&str, &str)]) -> (Logged, String) {
    let mut command = repose();
    command.args(["serve", what, "--connect", endpoint]).env("REPOSE_TELEMETRY__LISTEN", "127.0.0.1:0").envs(settings.iter().copied());
    let process = Logged::start(command);
    let line = process.line("health and metrics");
    let address = line.split("address=").nth(1).expect("where").split_whitespace().next().expect("an address").to_owned();
    (process, address)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_process_is_ready_while_it_serves_behind_a_router_and_counts_what_it_does() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port").local_addr().expect("its address").port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let (router, at_router) = start("router", &endpoint);
    assert_eq!(page(&at_router, "/live"), (200, "live\n".to_owned()));
    assert!(page(&at_router, "/metrics").1.contains("repose_router_refused_total{kind=\"login\"} 0"), "the first refusal is a rise");
    let (_inference, at) = start("inference", &endpoint);
    assert_eq!(page(&at, "/live").0, 200);
    becomes(&at, "/ready", 200);

    let mut config = RuntimeConfig::default();
    config.session.mode = SessionMode::Client;
    config.session.connect = vec![endpoint.clone()];
    config.session.name = Some("the-test".to_owned());
    let session = Session::open(config).await.expect("a session");
    let caller = session.caller(Service::Inference).await.expect("a caller");
    caller.wait_for_workers(1, PATIENCE).await.expect("a worker");
    let models = Payload::json(&ModelsRequest {}).expect("a request");
    for _ in 0..3 {
        caller.call("models", models.clone(), CallOptions::default()).await.expect("an answer");
    }
    assert!(caller.call("made-up-by-a-client", models, CallOptions::default()).await.is_err());

    let text = page(&at, "/metrics").1;
    let value = |start: &str| {
        let line = text.lines().find(|line| line.starts_with(start)).unwrap_or_else(|| panic!("no {start} in\n{text}"));
        line.rsplit(' ').next().and_then(|number| number.parse::<f64>().ok()).expect("a number")
    };
    assert_eq!(value("repose_requests_total{service=\"inference\",method=\"models\",code=\"result\"}"), 3.0);
    assert_eq!(value("repose_requests_total{service=\"inference\",method=\"unknown\",code=\"invalid_argument\"}"), 1.0);
    assert!(!text.contains("made-up-by-a-client"), "a client's words are no label");
    assert_eq!(value("repose_request_seconds_count{service=\"inference\",method=\"models\"}"), 3.0);
    assert!(text.contains("repose_worker_info{service=\"inference\"") && text.contains("weights=\""));
    assert!(value("process_resident_memory_bytes") > 1e6 && value("process_open_fds") > 3.0);
    assert!(page(&at_router, "/metrics").1.contains("repose_links 2"), "{}", page(&at_router, "/metrics").1);

    drop(router);
    let said = becomes(&at, "/ready", 503);
    assert!(said.contains("the router is away"), "{said}");
    assert_eq!(page(&at, "/live").0, 200, "a process whose router is away is not restarted for it");
    let (_router, _) = start("router", &endpoint);
    becomes(&at, "/ready", 200);
}

#[test]
fn the_page_and_the_bridge_tell_their_health_and_metrics_too() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port").local_addr().expect("its address").port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let (_router, _) = start("router", &endpoint);
    // The bridge's own router is ours, too: what matters is that the process runs.
    let page_at = [("REPOSE_CONSOLE__LISTEN", "127.0.0.1:0")];
    let ros_router = [("REPOSE_ROS2__SESSION__CONNECT", endpoint.as_str()), ("REPOSE_ROS2__SESSION__MODE", "client")];
    for (what, settings) in [("console", &page_at[..]), ("ros2", &ros_router)] {
        let (_process, at) = start_with(what, &endpoint, settings);
        assert_eq!(page(&at, "/live").0, 200, "{what}");
        becomes(&at, "/ready", 200);
        assert!(page(&at, "/metrics").1.contains("process_open_fds"), "{what}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failed_call_is_in_the_log_with_its_id_and_its_caller() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port").local_addr().expect("its address").port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let (_router, _) = start("router", &endpoint);
    let (inference, _) = start("inference", &endpoint);
    let mut config = RuntimeConfig::default();
    config.session.mode = SessionMode::Client;
    config.session.connect = vec![endpoint];
    config.session.name = Some("the-test".to_owned());
    let session = Session::open(config).await.expect("a session");
    let caller = session.caller(Service::Inference).await.expect("a caller");
    let options = CallOptions { id: Some("id-of-the-call".to_owned()), ..CallOptions::within(PATIENCE) };
    caller.wait_for_workers(1, PATIENCE).await.expect("a worker");
    let request = Payload::json(&ModelsRequest {}).expect("a request");
    assert!(caller.call("dance", request, options).await.is_err());
    let line = inference.line("id-of-the-call");
    assert!(line.contains("the-test") && line.contains("dance") && line.contains("inference"), "{line}");
}
