//! What `deploy/` promises: every field of the runtime's sections with its default, and access control that lets the right users do
//! the right things through a real router, `@estop` and `@cancel` among them.

mod common;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use bytes::Bytes;
use common::{Oddities, SERVICE, read, word};
use repose_proto::Priority;
use repose_runtime::transport::OutgoingQuery;
use repose_runtime::{CallOptions, RuntimeConfig, Session, SessionMode, Traffic, load_config};

fn deploy() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../deploy")
}

#[test]
fn the_example_has_every_field_with_its_default() {
    let file = deploy().join("repose.toml");
    let loaded = RuntimeConfig::load(Some(&file)).unwrap();
    let mut expected = RuntimeConfig::default();
    expected.session.mode = SessionMode::Client;
    expected.session.connect = vec!["tcp/127.0.0.1:7447".to_owned()];
    assert_eq!(loaded, expected);
    let text = std::fs::read_to_string(&file).unwrap();
    let fields = |value: serde_json::Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    let sections = [serde_json::to_value(&loaded.session), serde_json::to_value(&loaded.caller), serde_json::to_value(&loaded.worker)];
    for field in sections.into_iter().flat_map(|s| fields(s.unwrap())) {
        assert!(text.lines().any(|l| l.trim_start_matches("# ").starts_with(&format!("{field} ="))), "{field} is missing");
    }
}

#[test]
fn the_routers_configurations_can_be_read() {
    for file in ["one-machine/router.toml", "several-machines/router.toml", "several-machines/service.toml", "several-machines/client.toml"]
    {
        RuntimeConfig::load(Some(&deploy().join(file))).unwrap_or_else(|e| panic!("{file}: {e}"));
    }
    assert!(load_config::<serde_json::Value>("planner", Some(&deploy().join("repose.toml"))).unwrap()["threads"].is_number());
}

/// A file that a process is let in with, and its user and password.
fn credentials(file: &str) -> (String, String) {
    let text = std::fs::read_to_string(deploy().join("several-machines").join(file)).unwrap();
    let config = zenoh::Config::from_json5(&text).unwrap_or_else(|e| panic!("{file}: {e}"));
    let field = |name| serde_json::from_str(&config.get_json(&format!("transport/auth/usrpwd/{name}")).unwrap()).unwrap();
    (field("user"), field("password"))
}

/// The router of several machines, on TCP so that the test needs no certificates, and its users.
struct Guarded {
    folder: tempfile::TempDir,
    router: Session,
}

impl Guarded {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let users = folder.path().join("users.txt");
        std::fs::copy(deploy().join("several-machines/users.txt"), &users).unwrap();
        let text = std::fs::read_to_string(deploy().join("several-machines/router.json5")).unwrap();
        let (tls_start, tls_end) = (text.find("    link: {").unwrap(), text.find("    auth: {").unwrap());
        let text = (text[..tls_start].to_owned() + &text[tls_end..]).replace("/etc/repose/users.txt", users.to_str().unwrap());
        let file = folder.path().join("router.json5");
        std::fs::write(&file, text).unwrap();
        let mut config = RuntimeConfig::default();
        config.session.mode = SessionMode::Router;
        config.session.listen = vec!["tcp/127.0.0.1:0".to_owned()];
        config.session.zenoh_file = Some(file);
        Self { folder, router: Session::open(config).await.unwrap() }
    }

    /// Opens a session with the user and password of an example.
    async fn open_as(&self, file: &str, expected_user: &str) -> Session {
        let (user, password) = credentials(file);
        assert_eq!(user, expected_user, "{file}");
        self.open(&user, &password).await.unwrap()
    }

    async fn open(&self, user: &str, password: &str) -> Result<Session, repose_runtime::RuntimeError> {
        let file = self.folder.path().join(format!("{user}-{}.json5", password.len()));
        std::fs::write(&file, format!("{{transport: {{auth: {{usrpwd: {{user: {user:?}, password: {password:?}}}}}}}}}")).unwrap();
        let mut config = RuntimeConfig::default();
        config.session.mode = SessionMode::Client;
        config.session.connect = self.router.locators().await;
        config.session.connect_timeout_ms = 1000;
        config.session.zenoh_file = Some(file);
        Session::open(config).await
    }
}

/// Puts until one arrives, or for a while.
async fn arrives(from: &Session, to: &mut repose_runtime::Subscription, key: &str, traffic: Traffic) -> bool {
    for _ in 0..20 {
        from.put(key, word("x"), traffic).await.unwrap();
        if let Ok(Some(_)) = tokio::time::timeout(Duration::from_millis(50), to.recv()).await {
            return true;
        }
    }
    false
}

#[tokio::test(flavor = "multi_thread")]
async fn users_may_do_what_they_are_for_and_nothing_else() {
    let network = Guarded::start().await;
    let Err(refused) = network.open("clients", "wrong").await else { panic!("a wrong password was let in") };
    let refused = refused.to_string();
    assert!(refused.contains("does it know this user?") && !refused.contains(".rs:"), "{refused}");
    let services = network.open_as("service.json5", "services").await;
    let robots = network.open_as("robot.json5", "robots").await;
    let clients = network.open_as("client.json5", "clients").await;

    // A client finds a worker, calls it, and its cancel arrives.
    let handler = Arc::new(Oddities::default());
    let _server = services.start(SERVICE, handler.clone()).await.unwrap();
    let caller = clients.caller(SERVICE).await.unwrap();
    caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    let answer = caller.call("echo", word("hello"), CallOptions::within(Duration::from_secs(5))).await.unwrap();
    assert_eq!(read(&answer.payload), "hello");
    let cancel = repose_runtime::CancellationToken::new();
    let call = tokio::spawn({
        let (caller, cancel) = (caller.clone(), cancel.clone());
        async move { caller.call("patient", word(""), CallOptions { cancel, ..CallOptions::default() }).await }
    });
    handler.wait_for(&handler.started, 2).await;
    cancel.cancel();
    handler.wait_for(&handler.cancelled, 1).await;
    assert!(call.await.unwrap().is_err());

    // A client is no worker: its token is not seen, and a query to what it serves ends without a reply.
    let impostor_handler = Arc::new(Oddities::default());
    let impostor = clients.start(SERVICE, impostor_handler.clone()).await.unwrap();
    let caller = services.caller(SERVICE).await.unwrap();
    caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    assert!(caller.wait_for_workers(2, Duration::from_millis(500)).await.is_err());
    let query =
        OutgoingQuery { payload: word("hello"), attachment: Bytes::new(), priority: Priority::Batch, timeout: Duration::from_secs(1) };
    let mut replies = services.transport().query(&services.cell().call(SERVICE, impostor.worker()), query).await.unwrap();
    assert!(replies.next().await.is_none());
    assert_eq!(impostor_handler.started.load(Ordering::SeqCst), 0);

    // Commands reach the robot from services and from nobody else; stops from everyone; states reach everyone.
    let cell = services.cell();
    let mut commands = robots.subscribe_queue(&cell.robot_command("arm"), 64).await.unwrap();
    let mut stops = robots.subscribe_queue(&cell.robot_estop("arm"), 64).await.unwrap();
    let mut states = clients.subscribe_queue(&cell.robot_state("arm"), 64).await.unwrap();
    assert!(arrives(&services, &mut commands, &cell.robot_command("arm"), Traffic::RobotCommand).await);
    assert!(arrives(&services, &mut stops, &cell.robot_estop("arm"), Traffic::EmergencyStop).await);
    assert!(arrives(&clients, &mut stops, &cell.robot_estop("arm"), Traffic::EmergencyStop).await);
    assert!(arrives(&robots, &mut states, &cell.robot_state("arm"), Traffic::RobotState).await);
    while commands.try_recv().is_some() {}
    assert!(!arrives(&clients, &mut commands, &cell.robot_command("arm"), Traffic::RobotCommand).await);
    assert!(!arrives(&robots, &mut commands, &cell.load(SERVICE, "w"), Traffic::Call(Priority::Batch)).await);
}
