//! `repose deploy` and what it makes: users are let in as who they are, by processes of the program, and the log says whom it kept out.

use std::net::UdpSocket;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use repose_proto::scoring::ModelsRequest;
use repose_proto::{ErrorCode, Payload, Service};
use repose_runtime::{CallOptions, RuntimeConfig, Session};
use serde_json::{Value, json};

use crate::common::{PATIENCE, repose};
use crate::processes::Logged;

/// Writes the deployment that the README points to, with its router on a free port of this machine.
fn deploy(folder: &Path) {
    deploy_as(folder, |port| {
        let example = include_str!("../../deploy/roles.toml").replace("router.example:7447", &format!("127.0.0.1:{port}"));
        // And somebody of another cell.
        example + "[users.elsewhere]\nrole = \"operator\"\ncells = [\"hall\"]\n"
    });
}

/// Writes the deployment of a roles file, which is told the router's port.
fn deploy_as(folder: &Path, text: impl FnOnce(u16) -> String) {
    let port = UdpSocket::bind("127.0.0.1:0").expect("a free port").local_addr().expect("its address").port();
    let roles = folder.join("roles.toml");
    std::fs::write(&roles, text(port)).expect("written");
    let out = folder.join("out");
    let written = repose().arg("deploy").args([&roles, Path::new("--out"), &out]).output().expect("it runs");
    assert!(written.status.success(), "{}", String::from_utf8_lossy(&written.stderr));
}

fn serve(folder: &Path, what: &str, config: &str) -> Command {
    let mut command = repose();
    command.args(["serve", what, "--config"]).arg(folder.join("out").join(config));
    // Who may do what is asked here, and not who is lost.
    command.env("REPOSE_SESSION__LEASE_MS", "10000");
    command
}

async fn session(folder: &Path, user: &str) -> Session {
    let file = folder.join("out/users").join(user).join("repose.toml");
    Session::open(RuntimeConfig::load(Some(&file)).expect("its configuration")).await.expect("it is let in")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deployment_made_of_a_roles_file_works_and_keeps_everyone_to_their_role() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    deploy(folder);
    let router = Logged::start(serve(folder, "router", "router/router.toml"));
    router.line("routing");
    let inference = Logged::start(serve(folder, "inference", "users/inference/repose.toml"));
    inference.line("serving");
    let asker = session(folder, "task-planner").await.caller(Service::Inference).await.expect("a caller");
    asker.wait_for_workers(1, PATIENCE).await.expect("it is seen");
    let request = Payload::json(&ModelsRequest {}).expect("a request");
    let answer = asker.call("models", request.clone(), CallOptions::within(Duration::from_secs(20))).await.expect("an answer");
    assert!(!answer.worker.is_empty());
    let display = session(folder, "wall-display").await;
    let looking = display.caller(Service::Inference).await.expect("a caller");
    looking.wait_for_workers(1, PATIENCE).await.expect("a viewer sees workers");
    let refused = looking.call("models", request, CallOptions::within(PATIENCE)).await.expect_err("and calls none");
    assert!(refused.message.contains("role") && refused.code == ErrorCode::FailedPrecondition, "{refused:?}");

    // What the program itself asks on a user's behalf is within what the user may see.
    let status =
        repose().args(["status", "--json", "--config"]).arg(folder.join("out/users/wall-display/repose.toml")).output().expect("it runs");
    let status: Value = serde_json::from_slice(&status.stdout).expect("one JSON document");
    assert_eq!((&status["cells"], &status["workers"][0]["service"]), (&json!(["cell"]), &json!("inference")), "{status:#}");

    // A subscription wider than what is allowed is dropped by access control; the log says so.
    let _wide = display.subscribe_queue("repose/v1/**", 1).await.expect("nobody tells the subscriber");
    let refused = router.line("a subscription must lie within");
    assert!(refused.contains("wall-display") && refused.contains("repose/v1/**") && refused.contains("ERROR"), "{refused}");
}

/// What `deploy check` reports of a deployment, and whether it found all of it right.
fn checked(folder: &Path, more: &[&str]) -> (bool, Value) {
    let checked = repose().args(["deploy", "check", "--json"]).args(more).arg(folder.join("out")).output().expect("it runs");
    let said = || format!("{}{}", String::from_utf8_lossy(&checked.stdout), String::from_utf8_lossy(&checked.stderr));
    (checked.status.success(), serde_json::from_slice(&checked.stdout).unwrap_or_else(|_| panic!("no report: {}", said())))
}

#[test]
fn the_trial_of_a_deployment_finds_nothing_wrong() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    deploy(folder);
    let router = Logged::start(serve(folder, "router", "router/router.toml"));
    router.line("routing");
    let (is_right, report) = checked(folder, &[]);
    assert!(is_right && report["wrong"] == json!([]) && report["unanswered"] == json!([]), "{report:#}");
    assert!(report["tried"].as_u64() > Some(500) && report["allowed"].as_u64() > Some(100), "{report}");
    assert!(!folder.join("out/.check").exists(), "the trial leaves no secrets behind");
    // What was refused on the way is in the router's log, with user and key.
    router.line("may not Put");
}

#[test]
fn a_hole_in_the_routers_rules_is_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    deploy(folder);
    let file = folder.join("out/router/router.json5");
    let text = std::fs::read_to_string(&file).expect("the router's file");
    // The viewer may stop robots; now it may also pose as one, and the operator may operate no more.
    let holed = text.replace("\"repose/v1/cell/robot/*/@estop\"", "\"repose/v1/cell/robot/*/@estop\", \"repose/v1/cell/robot/*/state\"");
    let holed = holed.replace("repose/v1/cell/service/motion/*/operate", "repose/v1/cell/service/motion/nobody/operate");
    assert_ne!(holed, text);
    std::fs::write(&file, holed).expect("written");
    let router = Logged::start(serve(folder, "router", "router/router.toml"));
    router.line("routing");
    let (is_right, report) = checked(folder, &[]);
    let of = |list: &str, user: &str, key: &str| {
        let trials = report[list].as_array().into_iter().flatten();
        let mut of_it = trials.filter(|trial| trial["user"] == user && trial["key"].as_str().is_some_and(|k| k.ends_with(key)));
        of_it.next().map(|trial| trial["outcome"].clone())
    };
    assert!(!is_right);
    assert_eq!(of("wrong", "wall-display", "robot/panda/state"), Some(json!("came_through")), "{report:#}");
    let operate = "service/motion/motion-1/operate";
    assert_eq!(of("wrong", "anna", operate), Some(json!("refused")), "{report:#}");
    // Where nobody comes through who may, that others do not says nothing.
    assert_eq!(of("unanswered", "task-planner", operate), Some(json!("none")), "{report:#}");
}

#[tokio::test(flavor = "multi_thread")]
async fn certificates_and_passwords_together_keep_out_whoever_has_one_of_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    deploy_as(folder, |port| {
        format!(
            "router = \"127.0.0.1:{port}\"\ncells = [\"cell\"]\nlogin = \"both\"\n[users.asker]\nrole = \"planner\"\n\
             [users.inference]\nrole = \"service\"\nservice = \"inference\"\n[users.router]\nrole = \"viewer\"\n"
        )
    });
    // On a router of its own, which nobody has to start, and which is not the user of that name.
    let (is_right, report) = checked(folder, &["--apart"]);
    assert!(is_right && report["allowed"].as_u64() > Some(5), "{report:#}");
    let router = Logged::start(serve(folder, "router", "router/router.toml"));
    router.line("routing");
    let inference = Logged::start(serve(folder, "inference", "users/inference/repose.toml"));
    inference.line("serving");
    let asker = session(folder, "asker").await.caller(Service::Inference).await.expect("a caller");
    asker.wait_for_workers(1, PATIENCE).await.expect("it is seen");

    // With the certificate of one user and the password of the other, nobody is let do anything.
    let file = folder.join("out/users/asker/zenoh.json5");
    let mixed = std::fs::read_to_string(&file).expect("the user's file");
    let mixed = ["certificate.pem", "key.pem"]
        .iter()
        .fold(mixed, |text, name| text.replace(&format!("users/asker/{name}"), &format!("users/inference/{name}")));
    std::fs::write(&file, mixed).expect("written");
    let neither = session(folder, "asker").await.caller(Service::Inference).await.expect("a caller");
    assert!(neither.wait_for_workers(1, Duration::from_secs(1)).await.is_err());
}

#[test]
fn a_cell_in_operation_is_not_tried() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    deploy(folder);
    let router = Logged::start(serve(folder, "router", "router/router.toml"));
    router.line("routing");
    let inference = Logged::start(serve(folder, "inference", "users/inference/repose.toml"));
    // It says first that it begins to, and this once its token is there.
    inference.line("repose_runtime::server: serving");
    let (is_right, report) = checked(folder, &[]);
    let said = report["error"]["message"].as_str().unwrap_or_default();
    assert!(!is_right && said.contains("live/inference/") && said.contains("alive"), "{report}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_router_says_whom_it_did_not_let_in_and_from_where() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    deploy(folder);
    let router = Logged::start(serve(folder, "router", "router/router.toml"));
    router.line("routing");
    let file = folder.join("out/users/wall-display/zenoh.json5");
    let right = std::fs::read_to_string(&file).expect("the user's file");
    for (wrong, why) in [
        (right.replace("\"password\": \"", "\"password\": \"x"), "the password is wrong"),
        (right.replace("\"wall-display\"", "\"nobody\""), "the router does not know that user"),
    ] {
        std::fs::write(&file, wrong).expect("written");
        let config = RuntimeConfig::load(Some(&folder.join("out/users/wall-display/repose.toml"))).expect("its configuration");
        assert!(Session::open(config).await.is_err(), "{why}");
        let said = router.line(why);
        assert!(said.contains("refused a login from 127.0.0.1") && said.contains("ERROR"), "{said}");
    }
}

#[test]
fn a_password_is_in_no_log_however_much_is_logged() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    deploy(folder);
    let mut router = serve(folder, "router", "router/router.toml");
    router.env("REPOSE_LOG", "trace");
    let router = Logged::start(router);
    router.line("routing");
    let mut inference = serve(folder, "inference", "users/inference/repose.toml");
    inference.env("REPOSE_LOG", "trace");
    let inference = Logged::start(inference);
    inference.line("serving");
    let passwords = std::fs::read_to_string(folder.join("out/router/users.txt")).expect("the passwords");
    for (user, password) in passwords.lines().filter_map(|line| line.split_once(':')) {
        for log in [router.log(), inference.log()] {
            assert!(!log.contains(password), "{user}'s password is in a log");
        }
    }
}

#[test]
fn a_routers_certificates_are_not_silently_replaced_by_plain_tcp() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    deploy(folder);
    let mut command = serve(folder, "router", "router/router.toml");
    let ended = command.env("REPOSE_CONNECT", "tcp/127.0.0.1:7447").output().expect("it ends");
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(2), "{said}");
    assert!(said.contains("REPOSE_CONNECT") && said.contains("quic/"), "{said}");
}

#[test]
fn the_units_run_commands_that_exist_and_set_no_endpoint() {
    let folder = tempfile::tempdir().expect("a folder");
    deploy(folder.path());
    let units = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/systemd");
    let mut seen = 0;
    for entry in [units, folder.path().join("out/units")].iter().flat_map(|folder| std::fs::read_dir(folder).expect("units")) {
        let path = entry.expect("a unit").path();
        if path.extension().is_none_or(|kind| kind != "service") {
            continue;
        }
        let text = std::fs::read_to_string(&path).expect("its text");
        assert!(!text.lines().any(|line| line.starts_with("Environment=REPOSE_CONNECT")), "{}", path.display());
        // What cannot begin yet, as before the network has its addresses, ends within a moment: systemd gives up after five of them.
        assert!(!text.contains("Restart=always") || text.contains("\nStartLimitIntervalSec=0\n"), "{} gives up", path.display());
        let run = text.lines().find_map(|line| line.strip_prefix("ExecStart=")).unwrap_or_else(|| panic!("{}", path.display()));
        if let Some(args) = run.strip_prefix("/usr/bin/repose ") {
            let (what, config) = args.split_once(" --config ").expect("a configuration");
            assert!(Path::new(config).exists() || config.starts_with("/etc/repose"), "{}: {config}", path.display());
            assert!(repose().args(what.split(' ')).arg("--help").output().expect("it runs").status.success(), "{what}");
            seen += 1;
        }
    }
    assert!(seen >= 2, "{seen}");
}
