//! The console over real sockets, in a cell whose robot is a few lines here.

mod serving;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use futures::{SinkExt, StreamExt};
use repose_console::{Console, ConsoleConfig};
use repose_proto::arrange::{Conflict, ObjectGoal, Proof};
use repose_proto::place::Outcome;
use repose_proto::{ArrangeRequest, ArrangeResult, CallError, Payload, Service};
use repose_runtime::{Call, Handler, Traffic};
use serde_json::{Value, json};
use serving::{WITHIN, ask, heard, robot, robot_named, socket, start};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::{Error, Message};

/// Sends a request over a socket of its own; status, headers and body.
async fn http(address: SocketAddr, method: &str, path: &str, headers: &[(&str, &str)], body: &str) -> (u16, String, String) {
    let stream = TcpStream::connect(address).await.expect("a connection");
    http_over(stream, address, method, path, headers, body).await
}

async fn http_over<S: AsyncRead + AsyncWrite + Unpin>(
    mut stream: S,
    address: SocketAddr,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: &str,
) -> (u16, String, String) {
    let mut text = format!("{method} {path} HTTP/1.1\r\nConnection: close\r\nContent-Length: {}\r\n", body.len());
    if !headers.iter().any(|(name, _)| *name == "Host") {
        text.push_str(&format!("Host: {address}\r\n"));
    }
    headers.iter().for_each(|(name, value)| text.push_str(&format!("{name}: {value}\r\n")));
    stream.write_all(format!("{text}\r\n{body}").as_bytes()).await.expect("sent");
    let mut answer = Vec::new();
    tokio::time::timeout(WITHIN, stream.read_to_end(&mut answer)).await.expect("in time").expect("received");
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let (head, body) = answer.split_once("\r\n\r\n").expect("a head");
    let status = head.split(' ').nth(1).and_then(|s| s.parse().ok()).expect("a status");
    (status, head.to_ascii_lowercase(), body.to_owned())
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_and_its_files_are_served_and_nothing_else() {
    let console = start(ConsoleConfig::default()).await;
    let (status, head, page) = http(console.address, "GET", "/", &[], "").await;
    assert!(status == 200 && head.contains("content-security-policy: default-src 'none'"), "{head}");
    let nonce = head.split("'nonce-").nth(1).and_then(|rest| rest.split('\'').next()).expect("a nonce");
    assert!(page.contains(&format!("nonce=\"{nonce}\"")) && !page.contains("NONCE"));
    let (status, head, script) = http(console.address, "GET", "/js/main.js", &[], "").await;
    assert!(status == 200 && head.contains("text/javascript") && script.contains("Connection"));
    let tag = head.lines().find_map(|l| l.strip_prefix("etag: ")).expect("a tag").trim().to_owned();
    assert_eq!(http(console.address, "GET", "/js/main.js", &[("If-None-Match", &tag)], "").await.0, 304);
    assert_eq!(http(console.address, "GET", "/../Cargo.toml", &[], "").await.0, 404);
    assert_eq!(http(console.address, "GET", "/js/other.js", &[], "").await.0, 404);
}

/// A perception that tells what it is asked, and finds nothing.
struct Asked(mpsc::UnboundedSender<String>);

#[async_trait::async_trait]
impl Handler for Asked {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        drop(self.0.send(call.method));
        Err(CallError::not_found("camera", "nothing is seen"))
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_that_was_asked_for_finds_its_cell_followed() {
    let console = start(ConsoleConfig::default()).await;
    let (asked, mut methods) = mpsc::unbounded_channel();
    let _perception = console.session.start(Service::Perception, Arc::new(Asked(asked))).await.expect("a worker");
    let scenes = console.session.publisher(console.session.cell().scene("front"), Traffic::Scene);
    let telling = tokio::spawn(async move {
        let mut tick = tokio::time::interval(Duration::from_millis(10));
        loop {
            tick.tick().await;
            // Who is there is known by its key: nobody reads more of it here.
            scenes.put(Payload { encoding: String::new(), bytes: Vec::new().into() }).await.expect("put");
        }
    });
    assert_eq!(http(console.address, "GET", "/", &[], "").await.0, 200);
    // No socket has been opened: it is the page that was asked for whose camera's newest scene is.
    let method = tokio::time::timeout(WITHIN, methods.recv()).await.expect("asked in time");
    telling.abort();
    assert_eq!(method.as_deref(), Some("latest"));
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_other_sites_reach_nothing() {
    let console = start(ConsoleConfig::default()).await;
    let foreign = ("Origin", "http://evil.example");
    assert_eq!(http(console.address, "POST", "/stop", &[foreign], r#"{"cell":"cell","robot":"panda"}"#).await.0, 403);
    assert_eq!(http(console.address, "GET", "/", &[("Host", "evil.example")], "").await.0, 403);
    assert_eq!(http(console.address, "POST", "/sign-in", &[("Sec-Fetch-Site", "cross-site")], "token").await.0, 403);
    assert_eq!(http(console.address, "GET", "/", &[("Sec-Fetch-Site", "cross-site")], "").await.0, 200, "a link may lead to the page");
    let refused = socket(console.address, &[("origin", "http://evil.example")]).await;
    assert!(matches!(&refused, Err(Error::Http(response)) if response.status() == 403), "{refused:?}");
    let own = format!("http://{}", console.address);
    assert!(socket(console.address, &[("origin", own.as_str())]).await.is_ok());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_sees_the_robot_and_anybody_stops_it() {
    let console = start(ConsoleConfig::default()).await;
    robot(&console.session).await;
    let mut viewer = socket(console.address, &[]).await.expect("a socket");
    let welcome = heard(&mut viewer, |m| m["kind"] == "welcome").await;
    assert_eq!((&welcome["role"], &welcome["cell"]), (&json!("operator"), &json!("cell")));
    ask(&mut viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    let shown = heard(&mut viewer, |m| m["kind"] == "robot").await;
    assert_eq!((&shown["robot"], &shown["state"]["mode"]), (&json!("panda"), &json!("idle")));
    assert_eq!(shown["links"].as_array().map(Vec::len), Some(9));
    let stop = r#"{"cell": "cell", "robot": "panda", "reason": "a person is in the way"}"#;
    let (status, _, body) = http(console.address, "POST", "/stop", &[], stop).await;
    assert!(status == 200 && body.contains("a person is in the way"), "{status} {body}");
    let shown = heard(&mut viewer, |m| m["kind"] == "robot" && m["state"]["mode"] == "stopped").await;
    assert_eq!(shown["state"]["stop"]["reason"], "a person is in the way");
    // A page that was not let in has not heard of a cell.
    let (status, _, body) = http(console.address, "POST", "/stop", &[], r#"{"robot": "panda", "reason": "there is no room"}"#).await;
    assert!(status == 200, "{status} {body}");
    let (status, _, body) = http(console.address, "POST", "/stop", &[], r#"{"cell": "cell", "robot": "Not A Robot"}"#).await;
    assert!(status == 400 && body.contains("\"field\":\"robot\""), "{body}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_that_names_no_robot_stops_all_of_them_also_one_whose_hand_has_failed() {
    let console = start(ConsoleConfig::default()).await;
    robot_named(&console.session, "left", 0.04).await;
    robot_named(&console.session, "right", -1.0).await;
    let (status, _, body) = http(console.address, "POST", "/stop", &[], "{}").await;
    assert_eq!(status, 200, "{body}");
    let answer: Value = serde_json::from_str(&body).expect("JSON");
    for name in ["left", "right"] {
        assert_eq!(answer["stops"][name]["kind"], "estop", "{body}");
    }
    // Both are told to viewers, so that the page can stop either by its name; where the links of the second are, nobody knows.
    let mut viewer = socket(console.address, &[]).await.expect("a socket");
    ask(&mut viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    for (name, links) in [("left", Some(9)), ("right", None)] {
        let shown = heard(&mut viewer, |m| m["kind"] == "robot" && m["robot"] == name).await;
        assert_eq!((&shown["state"]["mode"], shown["links"].as_array().map(Vec::len)), (&json!("stopped"), links), "{shown}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_that_names_no_robot_reaches_those_that_tell_nothing_and_is_not_said_to_be_shown() {
    let console = start(ConsoleConfig::default()).await;
    let cell = console.session.cell();
    let mut mute = console.session.subscribe_queue(&cell.robot_estop("mute"), 256).await.expect("a subscription");
    let (status, _, body) = http(console.address, "POST", "/stop", &[], "{}").await;
    assert!(status == 504 && body.contains("no robot of cell cell tells its state"), "{status} {body}");
    assert!(mute.try_recv().is_some(), "it was put all the same");

    // Of two that tell their state, one latches nothing.
    robot(&console.session).await;
    let deaf = console.session.publisher(cell.robot_state("deaf"), Traffic::RobotState);
    let telling = tokio::spawn(async move {
        let mut tick = tokio::time::interval(Duration::from_millis(10));
        loop {
            tick.tick().await;
            // Who is there is known by its key, though nothing of what it tells can be read.
            deaf.put(Payload { encoding: String::new(), bytes: Vec::new().into() }).await.expect("put");
        }
    });
    let (status, _, body) = http(console.address, "POST", "/stop", &[], r#"{"cell": "cell"}"#).await;
    telling.abort();
    assert!(status == 504 && body.contains("robot deaf has not shown the stop") && !body.contains("panda"), "{status} {body}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_paced_viewer_is_told_more_as_it_says_that_what_was_told_has_come() {
    let console = start(ConsoleConfig { robot_period_ms: 10, ..ConsoleConfig::default() }).await;
    robot(&console.session).await;
    let address = format!("ws://{}/socket?paced", console.address);
    let mut viewer = connect_async(address).await.expect("a socket").0;
    ask(&mut viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    // Until the console has nothing on its way any more: pings are no messages.
    let (mut messages, mut bytes) = (0, 0);
    while let Ok(Some(Ok(message))) = tokio::time::timeout(Duration::from_secs(1), viewer.next()).await {
        if message.is_text() || message.is_binary() {
            (messages, bytes) = (messages + 1, bytes + message.len());
        }
    }
    assert!(messages > 3 && bytes < 40_000, "{messages} messages, {bytes} bytes");
    let stop = r#"{"cell": "cell", "robot": "panda", "reason": "a person is in the way"}"#;
    assert_eq!(http(console.address, "POST", "/stop", &[], stop).await.0, 200);
    for _ in 0..messages {
        ask(&mut viewer, json!({"id": 0, "ask": "received"})).await;
    }
    heard(&mut viewer, |m| m["kind"] == "robot" && m["state"]["mode"] == "stopped").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_goes_on_when_the_connection_that_asked_for_it_is_lost() {
    let console = start(ConsoleConfig::default()).await;
    let mut stops = console.session.subscribe_queue(&console.session.cell().robot_estop("panda"), 256).await.expect("a subscription");
    let body = r#"{"cell": "cell", "robot": "panda"}"#;
    let text = format!("POST /stop HTTP/1.1\r\nHost: {}\r\nContent-Length: {}\r\n\r\n{body}", console.address, body.len());
    let mut stream = TcpStream::connect(console.address).await.expect("a connection");
    stream.write_all(text.as_bytes()).await.expect("sent");
    assert!(tokio::time::timeout(WITHIN, stops.recv()).await.expect("in time").is_some(), "a first put");
    drop(stream);
    // Some of them may have been put before the console knew.
    for _ in 0..50 {
        let next = tokio::time::timeout(Duration::from_secs(2), stops.recv()).await;
        assert!(matches!(next, Ok(Some(_))), "the stop has ended with its connection");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn faulty_requests_are_answered_with_their_field_and_end_nothing() {
    let console = start(ConsoleConfig::default()).await;
    let mut viewer = socket(console.address, &[]).await.expect("a socket");
    ask(&mut viewer, json!({"id": 7, "ask": "dance"})).await;
    let refused = heard(&mut viewer, |m| m["kind"] == "refused").await;
    assert_eq!((&refused["id"], &refused["error"]["code"]), (&json!(7), &json!("invalid_argument")));
    viewer.send(Message::text("not JSON")).await.expect("sent");
    assert_eq!(heard(&mut viewer, |m| m["kind"] == "refused").await["id"], 0);
    ask(&mut viewer, json!({"id": 8, "ask": "watch", "cell": "No Cell", "camera": null})).await;
    assert_eq!(heard(&mut viewer, |m| m["id"] == 8).await["error"]["field"], "cell");
    let goal = json!([{"relation": "left_of", "anchor": 3, "holds": true}]);
    let request = json!({"scene": {"scene_id": "0".repeat(64)}, "query": 2, "goal": goal, "count": 1000});
    ask(&mut viewer, json!({"id": 9, "ask": "place", "request": request})).await;
    assert_eq!(heard(&mut viewer, |m| m["id"] == 9).await["error"]["field"], "count");
}

/// A planner that finds no arrangement for goals of more than one object, and says which they are.
struct Contradicted;

#[async_trait::async_trait]
impl Handler for Contradicted {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        let request: ArrangeRequest = call.payload.decode_json()?;
        let is_none = request.goals.len() > 1;
        let conflict = Conflict { goals: request.goals.clone(), proof: Proof::Contradiction, smallest: true };
        Payload::json(&ArrangeResult {
            outcome: if is_none { Outcome::None } else { Outcome::Found },
            moves: Vec::new(),
            satisfied: Vec::new(),
            open: Vec::new(),
            needs_view: Vec::new(),
            probability: None,
            conflict: is_none.then_some(conflict),
            searches: 0,
            weights_hash: String::new(),
            scene_id: request.scene.scene_id,
            view_yaw_rad: 0.0,
            goals: request.goals,
            seed: request.seed,
        })
    }
}

fn goals(texts: &[(u16, &str)]) -> Value {
    let goal = |(object, term): &(u16, &str)| ObjectGoal { object: *object, terms: vec![term.parse().expect("a term")] };
    json!(texts.iter().map(goal).collect::<Vec<_>>())
}

#[tokio::test(flavor = "multi_thread")]
async fn goals_that_shall_hold_together_are_asked_for_and_what_cannot_be_is_said() {
    let console = start(ConsoleConfig::default()).await;
    let planner = console.session.start(Service::Planner, Arc::new(Contradicted)).await.expect("a planner");
    let mut viewer = socket(console.address, &[]).await.expect("a socket");
    ask(&mut viewer, json!({"id": 1, "ask": "watch", "cell": "cell", "camera": "front"})).await;
    heard(&mut viewer, |m| m["kind"] == "answer" && m["id"] == 1).await;
    let request = |wanted: &[(u16, &str)]| json!({"scene": {"scene_id": "0".repeat(64)}, "goals": goals(wanted)});

    ask(&mut viewer, json!({"id": 2, "ask": "arrange", "request": request(&[(1, "left_of:2"), (1, "near:3")])})).await;
    let refused = heard(&mut viewer, |m| m["id"] == 2).await;
    assert_eq!((&refused["kind"], &refused["error"]["field"]), (&json!("refused"), &json!("goals[1].object")), "{refused}");

    ask(&mut viewer, json!({"id": 3, "ask": "arrange", "request": request(&[(1, "left_of:2"), (2, "left_of:1")])})).await;
    let none = heard(&mut viewer, |m| m["id"] == 3).await["result"]["arranged"].clone();
    assert_eq!((&none["outcome"], &none["conflict"]["proof"]), (&json!("none"), &json!("contradiction")), "{none}");
    assert_eq!((none["conflict"]["goals"].as_array().map(Vec::len), &none["conflict"]["smallest"]), (Some(2), &json!(true)), "{none}");

    // Nobody has the scene that this is about: nothing begins.
    ask(&mut viewer, json!({"id": 4, "ask": "bring_about", "robot": "panda", "request": request(&[(1, "left_of:2")])})).await;
    assert_eq!(heard(&mut viewer, |m| m["id"] == 4).await["kind"], "refused");
    planner.drain().await;
}

fn token_file(folder: &tempfile::TempDir, name: &str) -> Option<PathBuf> {
    let path = folder.path().join(name);
    std::fs::write(&path, format!("a-token-for-the-{name}")).expect("written");
    Some(path)
}

#[tokio::test(flavor = "multi_thread")]
async fn with_tokens_only_those_who_show_one_look_and_each_does_what_its_role_may() {
    let folder = tempfile::tempdir().expect("a folder");
    let (viewer_token, operator_token) = (token_file(&folder, "viewer"), token_file(&folder, "operator"));
    let console = start(ConsoleConfig { viewer_token, operator_token, ..ConsoleConfig::default() }).await;
    robot(&console.session).await;
    let mut nobody = socket(console.address, &[]).await.expect("a socket");
    let closed = tokio::time::timeout(WITHIN, nobody.next()).await.expect("in time");
    assert!(matches!(&closed, Some(Ok(Message::Close(Some(frame)))) if u16::from(frame.code) == 4401), "{closed:?}");
    let stop = r#"{"cell": "cell", "robot": "panda"}"#;
    assert_eq!(http(console.address, "POST", "/stop", &[], stop).await.0, 401);
    assert_eq!(http(console.address, "POST", "/sign-in", &[], "a-wrong-token-of-length").await.0, 401);
    let (status, head, body) = http(console.address, "POST", "/sign-in", &[], "a-token-for-the-viewer").await;
    assert!(status == 200 && body.contains("viewer"), "{body}");
    let cookie = head.lines().find_map(|l| l.strip_prefix("set-cookie: ")).expect("a cookie").to_owned();
    assert!(cookie.contains("httponly") && cookie.contains("samesite=strict"), "{cookie}");
    let cookie = cookie.split(';').next().expect("a value").to_owned();
    let mut viewer = socket(console.address, &[("cookie", cookie.as_str())]).await.expect("a socket");
    assert_eq!(heard(&mut viewer, |m| m["kind"] == "welcome").await["role"], "viewer");
    ask(&mut viewer, json!({"id": 1, "ask": "reset", "robot": "panda"})).await;
    let refused = heard(&mut viewer, |m| m["id"] == 1).await;
    assert!(refused["error"]["message"].as_str().is_some_and(|m| m.contains("operator")), "{refused}");
    let request = json!({"scene": {"scene_id": "0".repeat(64)}, "goals": goals(&[(1, "left_of:2")])});
    ask(&mut viewer, json!({"id": 2, "ask": "bring_about", "robot": "panda", "request": request})).await;
    let refused = heard(&mut viewer, |m| m["id"] == 2).await;
    assert!(refused["error"]["message"].as_str().is_some_and(|m| m.contains("operator")), "{refused}");
    assert_eq!(http(console.address, "POST", "/stop", &[("Cookie", &cookie)], stop).await.0, 200, "everybody may stop");
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_are_let_go_when_the_console_ends_and_counted_while_it_runs() {
    let mut console = start(ConsoleConfig { max_viewers: 1, ..ConsoleConfig::default() }).await;
    let mut first = socket(console.address, &[]).await.expect("a socket");
    heard(&mut first, |m| m["kind"] == "welcome").await;
    // Not by the status of the upgrade, which browsers keep from the page.
    let mut second = socket(console.address, &[]).await.expect("a socket");
    let full = tokio::time::timeout(WITHIN, second.next()).await.expect("in time");
    let Some(Ok(Message::Close(Some(frame)))) = &full else { panic!("expected to be let go with a word, got {full:?}") };
    assert!(u16::from(frame.code) == 4503 && frame.reason.contains("1 pages at once"), "{frame:?}");
    console.shutdown.trigger();
    let last = async {
        while let Some(Ok(message)) = first.next().await {
            if message.is_close() {
                return true;
            }
        }
        false
    };
    assert!(tokio::time::timeout(WITHIN, last).await.expect("in time"), "the socket is closed with a word");
    console.ended().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn with_a_certificate_the_page_is_served_over_tls_and_the_token_never_leaves_it() {
    // A certificate for localhost that signs itself, made for this test.
    let tls = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/tls"));
    let (certificate, private_key) = (tls.join("localhost.pem"), tls.join("localhost.key"));
    let folder = tempfile::tempdir().expect("a folder");
    let operator_token = token_file(&folder, "operator");
    let console = start(ConsoleConfig {
        certificate: Some(certificate.clone()),
        private_key: Some(private_key),
        operator_token,
        ..ConsoleConfig::default()
    })
    .await;
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(&certificate).expect("a certificate")).expect("a root");
    let client = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_root_certificates(roots)
        .with_no_client_auth();
    // A connection that never shakes hands keeps nobody waiting.
    let _silent = TcpStream::connect(console.address).await.expect("a connection");
    let connector = TlsConnector::from(Arc::new(client));
    let stream = TcpStream::connect(console.address).await.expect("a connection");
    let stream = connector.connect(ServerName::try_from("localhost").expect("a name"), stream).await.expect("a handshake");
    let (status, head, body) = http_over(stream, console.address, "POST", "/sign-in", &[], "a-token-for-the-operator").await;
    assert!(status == 200 && body.contains("operator") && head.contains("; secure"), "{status} {head} {body}");
    let missing = ConsoleConfig { certificate: Some("none.pem".into()), private_key: Some("none.key".into()), ..ConsoleConfig::default() };
    let refused = Console::open(console.session.clone(), missing).await.err().expect("there is no such file");
    assert!(refused.to_string().contains("certificate: none.pem"), "{refused}");
}
