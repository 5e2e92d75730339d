//! Two routers, of which either may be killed: calls go on by the other, within their deadlines.

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use repose_proto::scoring::ModelsRequest;
use repose_proto::{Payload, Service};
use repose_runtime::{CallOptions, RuntimeConfig, Session, SessionMode};

use crate::common::{PATIENCE, Process, repose};

/// Calls made one after the other; at a quarter of them the first router is killed, at half it is back, at three quarters the other is killed.
const CALLS: usize = 40;
/// The deadline of each.
const DEADLINE: Duration = Duration::from_secs(20);

fn endpoint() -> String {
    format!("tcp/{}", TcpListener::bind("127.0.0.1:0").expect("a free port").local_addr().expect("its address"))
}

fn configured(folder: &Path, name: &str, session: &str) -> PathBuf {
    let file = folder.join(format!("{name}.toml"));
    std::fs::write(&file, format!("[session]\n{session}\n")).expect("written");
    file
}

fn serve(what: &str, config: &Path) -> Process {
    let mut command: Command = repose();
    command.args(["serve", what, "--config"]).arg(config).stdout(Stdio::null());
    Process(command.spawn().expect("it starts"))
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_routers_either_may_be_killed() {
    let folder = tempfile::tempdir().expect("a folder");
    let (a, b) = (endpoint(), endpoint());
    let router = |name: &str, own: &str, other: &str| {
        let config = configured(folder.path(), name, &format!("mode = \"router\"\nlisten = [\"{own}\"]\nconnect = [\"{other}\"]"));
        move || serve("router", &config)
    };
    let (first, second) = (router("a", &a, &b), router("b", &b, &a));
    let (mut running_a, mut running_b) = (Some(first()), Some(second()));
    let config = configured(folder.path(), "inference", &format!("mode = \"client\"\nconnect = [\"{a}\", \"{b}\"]"));
    let _inference = serve("inference", &config);
    let mut config = RuntimeConfig::default();
    config.session.mode = SessionMode::Client;
    config.session.connect = vec![b, a];
    let session = Session::open(config).await.expect("a session");
    let caller = session.caller(Service::Inference).await.expect("a caller");
    caller.wait_for_workers(1, PATIENCE).await.expect("a worker");
    let request = Payload::json(&ModelsRequest {}).expect("a request");
    for call in 0..CALLS {
        match call {
            _ if call == CALLS / 4 => running_a = None,
            _ if call == CALLS / 2 => running_a = Some(first()),
            _ if call == CALLS * 3 / 4 => running_b = None,
            _ => {}
        }
        let answered = caller.call("models", request.clone(), CallOptions::within(DEADLINE)).await;
        assert!(answered.is_ok(), "call {call}: {answered:?}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert!(running_a.is_some() && running_b.is_none());
    assert_eq!(caller.duplicates(), 0);
}
