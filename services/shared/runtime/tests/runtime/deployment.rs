//! Deployments with users, through real routers with certificates: who may do what, and what is said to whoever is not let in.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::common::{Oddities, SERVICE, read, word};
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};
use repose_proto::load::WorkerLoad;
use repose_proto::{ErrorCode, Payload, Service};
use repose_runtime::deployment::{Group, Roles, write};
use repose_runtime::{CallOptions, HealthServer, RuntimeConfig, RuntimeError, Session, SessionMode, Traffic, certificates_in_use};

/// The example that the README points to, for a router of this machine, and somebody of another cell.
fn roles_text(login: &str) -> String {
    let example = include_str!("../../../../../deploy/roles.toml");
    let text = example.replace("router.example:7447", "127.0.0.1:7447").replace("login = \"password\"", &format!("login = \"{login}\""));
    assert!(text.contains("127.0.0.1:7447") && text.contains(&format!("login = \"{login}\"")));
    text + "[users.elsewhere]\nrole = \"operator\"\ncells = [\"hall\"]\n"
}

fn roles(login: &str) -> Roles {
    Roles::parse(&roles_text(login)).unwrap()
}

async fn open(mode: SessionMode, endpoint: &str, file: Option<&Path>) -> Result<Session, RuntimeError> {
    let mut config = RuntimeConfig::default();
    config.session.mode = mode;
    config.session.cell = "cell".to_owned();
    config.session.connect_timeout_ms = 8000;
    config.session.zenoh_file = file.map(Path::to_owned);
    match mode {
        SessionMode::Router => config.session.listen = vec![endpoint.to_owned()],
        _ => config.session.connect = vec![endpoint.to_owned()],
    }
    Session::open(config).await
}

/// A router of a deployment on a port of its own, and where it is.
async fn router(folder: &Path) -> (Session, String) {
    let router = open(SessionMode::Router, "quic/127.0.0.1:0", Some(&folder.join("router/router.json5"))).await.unwrap();
    let endpoint = router.locators().await[0].clone();
    (router, endpoint)
}

#[tokio::test(flavor = "multi_thread")]
async fn writing_again_keeps_passwords_and_certificates_and_adds_users() {
    let folder = tempfile::tempdir().unwrap();
    write(&roles("both"), folder.path(), folder.path()).unwrap();
    let secrets =
        ["router/users.txt", "authority/authority-key.pem", "router/router.pem", "users/arm/zenoh.json5", "users/arm/certificate.pem"];
    let read = |file: &str| std::fs::read_to_string(folder.path().join(file)).unwrap();
    let before = secrets.map(read);
    // The motion service reads no other file.
    let motion = folder.path().join("users/motion/repose.toml");
    let own = "\n[motion]\n# The door opens inwards.\nkeep_out = [{ name = \"door\", min_m = [0.2, 0.5, 0.0], max_m = [1.0, 1.5, 2.0] }]\n";
    let with_own = std::fs::read_to_string(&motion).unwrap() + own;
    std::fs::write(&motion, &with_own).unwrap();
    let more = roles_text("both") + "[users.newcomer]\nrole = \"viewer\"\n";
    write(&Roles::parse(&more).unwrap(), folder.path(), folder.path()).unwrap();
    let after = secrets.map(read);
    assert_eq!(before[1..], after[1..]);
    assert!(before[0].lines().all(|line| after[0].lines().any(|l| l == line)), "every earlier user keeps its password");
    assert!(after[0].contains("newcomer:"));
    assert_eq!(std::fs::read_to_string(&motion).unwrap(), with_own, "what an arm must keep out of is not forgotten with a new user");
    #[cfg(unix)]
    for secret in ["router/users.txt", "authority/authority-key.pem", "router/router-key.pem", "users/arm/zenoh.json5", "users/arm/key.pem"]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = std::fs::metadata(folder.path().join(secret)).unwrap().permissions().mode();
        assert_eq!(mode & 0o077, 0, "{secret} is for its owner only");
    }
}

#[test]
fn an_authority_whose_key_lies_elsewhere_stays_and_signs_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let with_newcomer = |login: &str| Roles::parse(&(roles_text(login) + "[users.newcomer]\nrole = \"viewer\"\n")).unwrap();
    let read = |file: &str| std::fs::read_to_string(folder.path().join(file)).unwrap();
    write(&roles("both"), folder.path(), folder.path()).unwrap();
    let authority = read("authority/authority.pem");
    std::fs::remove_file(folder.path().join("authority/authority-key.pem")).unwrap();
    write(&roles("both"), folder.path(), folder.path()).expect("everybody has a certificate");
    let refused = write(&with_newcomer("both"), folder.path(), folder.path()).unwrap_err();
    assert!(refused.path.ends_with("authority/authority-key.pem") && refused.message.contains("newcomer"), "{refused}");
    write(&with_newcomer("password"), folder.path(), folder.path()).expect("a password is not signed");
    assert_eq!([read("authority/authority.pem"), read("users/newcomer/authority.pem")], [authority.clone(), authority]);
    assert!(!folder.path().join("authority/authority-key.pem").exists());
}

#[cfg(unix)]
#[test]
fn a_group_reads_the_secrets_that_it_is_given_and_never_the_authoritys() {
    use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
    let folder = tempfile::tempdir().unwrap();
    let found = |file: &str| std::fs::metadata(folder.path().join(file)).unwrap();
    let mode = |file: &str| found(file).permissions().mode() & 0o777;
    std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(0o700)).unwrap();
    // Root may give files to any group; anybody else to one of their own.
    let id = if found("").uid() == 0 { 4711 } else { found("").gid() };
    let group = Group::named(&id.to_string()).unwrap();
    let written = write(&roles("both"), folder.path(), folder.path()).unwrap();
    group.may_read(&written, folder.path()).unwrap();
    let secrets = ["router/users.txt", "router/router-key.pem", "users/arm/zenoh.json5", "users/arm/key.pem"];
    for secret in secrets {
        assert_eq!((mode(secret), found(secret).gid()), (0o640, id), "{secret}");
    }
    assert_eq!(mode("authority/authority-key.pem"), 0o600, "whoever has the authority's key makes users");
    // The folder was its maker's alone.
    assert_eq!((mode(""), found("").gid(), mode("router/router.pem")), (0o750, id, 0o644));

    let more = roles_text("both") + "[users.newcomer]\nrole = \"viewer\"\n";
    let written = write(&Roles::parse(&more).unwrap(), folder.path(), folder.path()).unwrap();
    assert_eq!(secrets.map(mode), [0o640; 4], "writing again takes nothing from whoever runs with them");
    assert_eq!(mode("users/newcomer/key.pem"), 0o600);
    // A secret that nobody may read but its owner has stayed so: it is given with the rest.
    group.may_read(&written, folder.path()).unwrap();
    assert_eq!((mode("users/newcomer/key.pem"), mode("authority/authority-key.pem")), (0o640, 0o600));
}

#[tokio::test(flavor = "multi_thread")]
async fn cameras_of_one_session_that_see_at_the_same_time_are_all_passed_on() {
    let folder = tempfile::tempdir().unwrap();
    let text = roles_text("password") + "[users.pair]\nrole = \"driver\"\ncameras = [\"left\", \"right\"]\n";
    write(&Roles::parse(&text).unwrap(), folder.path(), folder.path()).unwrap();
    let (_router, endpoint) = router(folder.path()).await;
    let session = async |user: &str| {
        let file = folder.path().join(format!("users/{user}/zenoh.json5"));
        open(SessionMode::Client, &endpoint, Some(&file)).await.unwrap()
    };
    let (pair, anna) = (session("pair").await, session("anna").await);
    let keys = ["left", "right"].map(|camera| pair.cell().camera_frame(camera));
    let [mut left, mut right] = [anna.subscribe_queue(&keys[0], 64).await.unwrap(), anna.subscribe_queue(&keys[1], 64).await.unwrap()];
    let both = async {
        let mut came = [0, 0];
        while came.iter().any(|frames| *frames < 5) {
            for key in &keys {
                pair.put(key, word("a frame"), Traffic::Frame).await.unwrap();
            }
            // Ten frames a second of each.
            tokio::time::sleep(Duration::from_millis(100)).await;
            for (heard, frames) in [&mut left, &mut right].into_iter().zip(&mut came) {
                while heard.try_recv().is_some() {
                    *frames += 1;
                }
            }
        }
    };
    tokio::time::timeout(Duration::from_secs(20), both).await.expect("both are heard");
}

/// Replaces the router's certificate by one for `host`, valid until `days` from now, of another authority where one is named.
fn replace_certificate(folder: &Path, host: &str, days: i64, foreign: Option<&str>) {
    let read = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
    let authority_key = KeyPair::from_pem(&read("authority/authority-key.pem")).unwrap();
    let issuer = match foreign {
        None => Issuer::from_ca_cert_pem(&read("authority/authority.pem"), authority_key).unwrap(),
        Some(name) => {
            let mut params = CertificateParams::new(Vec::new()).unwrap();
            params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
            params.distinguished_name.push(DnType::CommonName, name);
            Issuer::new(params, KeyPair::generate().unwrap())
        }
    };
    let mut params = CertificateParams::new(vec![host.to_owned()]).unwrap();
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs();
    let epoch = rcgen::date_time_ymd(1970, 1, 1);
    params.not_before = epoch + Duration::from_secs(now - 10 * 86_400);
    params.not_after = epoch + Duration::from_secs(now.checked_add_signed(days * 86_400).unwrap());
    let key = KeyPair::generate().unwrap();
    std::fs::write(folder.join("router/router.pem"), params.signed_by(&key, &issuer).unwrap().pem()).unwrap();
    std::fs::write(folder.join("router/router-key.pem"), key.serialize_pem()).unwrap();
}

/// What somebody with the viewer's file, changed by `edit`, is told by a router with the certificate that `certificate` puts there.
async fn told(certificate: impl FnOnce(&Path), edit: impl FnOnce(String) -> String) -> (String, Duration) {
    let folder = tempfile::tempdir().unwrap();
    write(&roles("password"), folder.path(), folder.path()).unwrap();
    certificate(folder.path());
    let (_router, endpoint) = router(folder.path()).await;
    let file = folder.path().join("edited.json5");
    std::fs::write(&file, edit(std::fs::read_to_string(folder.path().join("users/wall-display/zenoh.json5")).unwrap())).unwrap();
    let started = Instant::now();
    let Err(error) = open(SessionMode::Client, &endpoint, Some(&file)).await else { panic!("let in") };
    (error.to_string(), started.elapsed())
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_is_not_let_in_is_told_why_and_soon() {
    let unchanged = |text: String| text;
    let wrong_password = |text: String| {
        let at = text.find("\"password\": \"").unwrap() + "\"password\": \"".len();
        text[..at].to_owned() + "x" + &text[at..]
    };
    let cases = [
        (told(|folder| replace_certificate(folder, "127.0.0.1", -1, None), unchanged).await, "has expired"),
        (told(|folder| replace_certificate(folder, "127.0.0.1", 1, Some("a foreign one")), unchanged).await, "another authority"),
        (told(|folder| replace_certificate(folder, "127.0.0.1", 1, Some("Repose trial authority")), unchanged).await, "another authority"),
        (told(|folder| replace_certificate(folder, "router.example", 1, None), unchanged).await, "another name"),
        (told(|_| (), wrong_password).await, "the password is wrong"),
        (told(|_| (), |text| text.replace("\"wall-display\"", "\"nobody\"")).await, "does not know that user"),
        (told(|_| (), |text| text.replace("authority.pem", "missing.pem")).await, "missing.pem"),
    ];
    for ((said, took), expected) in cases {
        assert!(said.contains(expected), "expected {expected:?}: {said}");
        assert!(!said.contains(".rs:"), "{said}");
        assert!(took < Duration::from_secs(7), "{expected} after {took:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_process_tells_when_the_certificates_that_its_links_use_expire() {
    let folder = tempfile::tempdir().unwrap();
    write(&roles("certificate"), folder.path(), folder.path()).unwrap();
    replace_certificate(folder.path(), "127.0.0.1", 5, None);
    let (_router, endpoint) = router(folder.path()).await;
    let file = folder.path().join("users/wall-display/zenoh.json5");
    let client = open(SessionMode::Client, &endpoint, Some(&file)).await.unwrap();
    // Days that have begun count: they are made for so many, a moment ago or some seconds.
    let days_left = |file: &str| {
        let file = folder.path().join(file);
        certificates_in_use().into_iter().find(|expiry| expiry.file == file).map(|expiry| (expiry.left_s() + 86_399) / 86_400)
    };
    assert_eq!(days_left("router/router.pem"), Some(5));
    assert_eq!(days_left("users/wall-display/certificate.pem"), Some(365));
    assert_eq!(days_left("users/wall-display/authority.pem"), Some(3650));
    assert_eq!(days_left("users/anna/certificate.pem"), None, "that one is somebody else's");

    let health = HealthServer::start("127.0.0.1:0", client, false).await.unwrap();
    let address = health.address();
    let page = tokio::task::spawn_blocking(move || {
        use std::io::{Read as _, Write as _};
        let mut stream = std::net::TcpStream::connect(address).unwrap();
        stream.write_all(b"GET /metrics HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n").unwrap();
        let mut page = String::new();
        stream.read_to_string(&mut page).unwrap();
        page
    });
    let page = page.await.unwrap();
    let start = format!("repose_certificate_expires_in_seconds{{file=\"{}\"}} ", folder.path().join("router/router.pem").display());
    let left_s = page.lines().find_map(|line| line.strip_prefix(start.as_str())?.parse::<f64>().ok());
    assert!(left_s.is_some_and(|left_s| (4.0 * 86_400.0..=5.0 * 86_400.0).contains(&left_s)), "{left_s:?} in {page}");
}

#[tokio::test(flavor = "multi_thread")]
async fn addresses_that_lead_nowhere_each_have_their_message() {
    let folder = tempfile::tempdir().unwrap();
    write(&roles("password"), folder.path(), folder.path()).unwrap();
    let file = folder.path().join("users/wall-display/zenoh.json5");
    let said = async |endpoint: &str, file: Option<&Path>| {
        let mut config = RuntimeConfig::default();
        config.session.mode = SessionMode::Client;
        config.session.connect = vec![endpoint.to_owned()];
        config.session.connect_timeout_ms = 500;
        config.session.zenoh_file = file.map(Path::to_owned);
        Session::open(config).await.map(drop).unwrap_err().to_string()
    };
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let nobody = said(&format!("tcp/{free}"), None).await;
    assert!(nobody.contains("nothing listens") && nobody.contains("quic/"), "{nobody}");
    let nobody = said(&format!("quic/{free}"), Some(&file)).await;
    assert!(nobody.contains("nothing answers") && nobody.contains("UDP"), "{nobody}");
    let plain = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let without = said(&format!("quic/{}", plain.local_addr().unwrap()), Some(&file)).await;
    assert!(without.contains("without certificates"), "{without}");
    let unknown = said("tcp/no-such-host.invalid:7447", None).await;
    assert!(unknown.contains("the address cannot be used"), "{unknown}");
    let tls = said("tls/127.0.0.1:7447", None).await;
    assert!(tls.contains("quic/ takes the same certificates"), "{tls}");
}

/// Checks that a worker of a configuration takes operations by their own key, and by no other.
async fn operates_by_its_own_key_only(config: RuntimeConfig) {
    let session = Session::open(config).await.unwrap();
    let handler = Arc::new(Oddities { work_ms: 1, ..Oddities::default() });
    let server = session.start(Service::Motion, handler.clone()).await.unwrap();
    let caller = session.caller(Service::Motion).await.unwrap();
    let options = || CallOptions::at_most_once(Duration::from_secs(5));
    assert_eq!(read(&caller.call("execute", word("moved"), options()).await.unwrap().payload), "moved");
    assert_eq!(read(&caller.call("echo", word("looked"), options()).await.unwrap().payload), "looked");
    // What a client of release 1 sends, and what somebody without the right to operate would.
    let cell = session.cell();
    let by = async |key: String, method: &str| crate::common::raw_call(&session, &key, method).await;
    let refused = by(cell.call(Service::Motion, server.worker()), "execute").await.unwrap_err();
    assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::FailedPrecondition, Some("method")));
    let refused = by(cell.operate(Service::Motion, server.worker()), "echo").await.unwrap_err();
    assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::InvalidArgument, Some("method")));
    assert_eq!(read(&by(cell.operate(Service::Motion, server.worker()), "execute").await.unwrap()), "raw");
}

#[tokio::test(flavor = "multi_thread")]
async fn operations_come_by_their_own_key_and_by_no_other_where_that_is_asked_for() {
    let mut config = RuntimeConfig::default();
    config.worker.operate_only = true;
    operates_by_its_own_key_only(config).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_is_a_user_takes_operations_by_their_own_key_though_its_configuration_does_not_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("zenoh.json5");
    // As somebody's own configuration that took over where to connect and who it is, and nothing else.
    std::fs::write(&file, r#"{listen: {endpoints: []}, transport: {auth: {usrpwd: {user: "motion", password: "its password"}}}}"#).unwrap();
    let mut config = RuntimeConfig::default();
    config.session.zenoh_file = Some(file);
    operates_by_its_own_key_only(config).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_belongs_to_one_worker() {
    let mut config = RuntimeConfig::default();
    config.worker.name = Some("only-one".to_owned());
    config.worker.name_wait_ms = 300;
    let session = Session::open(config).await.unwrap();
    let first = session.start(SERVICE, Arc::new(Oddities::default())).await.unwrap();
    let Err(refused) = session.start(SERVICE, Arc::new(Oddities::default())).await else { panic!("two under one name") };
    assert!(matches!(refused, RuntimeError::NameTaken { .. }), "{refused}");
    first.drain().await;
    session.start(SERVICE, Arc::new(Oddities::default())).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_stops_for_an_older_one_of_its_name_and_not_for_a_younger_one() {
    let mut config = RuntimeConfig::default();
    config.worker.name = Some("twin".to_owned());
    let session = Session::open(config).await.unwrap();
    let server = session.start(SERVICE, Arc::new(Oddities::default())).await.unwrap();
    // What another process under this name tells, of which neither saw the other's token.
    let tells = async |seq| {
        let load = Payload::json(&WorkerLoad { v: 1, seq, ..WorkerLoad::default() }).unwrap();
        session.put(&session.cell().load(SERVICE, "twin"), load, Traffic::Load).await.unwrap();
    };
    tells(0).await;
    assert!(tokio::time::timeout(Duration::from_millis(500), server.name_taken()).await.is_err(), "the older goes on");
    tells(1 << 40).await;
    let taken = tokio::time::timeout(Duration::from_secs(5), server.name_taken()).await.expect("the younger stops");
    assert!(matches!(taken, RuntimeError::NameTaken { .. }), "{taken}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_comes_while_its_predecessor_drains_waits_for_its_end_and_takes_the_name_over() {
    let mut config = RuntimeConfig::default();
    config.worker.name = Some("heir".to_owned());
    config.worker.name_wait_ms = 300;
    let session = Session::open(config).await.unwrap();
    let handler = Arc::new(Oddities::default());
    let first = session.start(SERVICE, handler.clone()).await.unwrap();
    let caller = session.caller(SERVICE).await.unwrap();
    caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    let held = tokio::spawn({
        let caller = caller.clone();
        async move { caller.call("held", word(""), CallOptions::within(Duration::from_secs(30))).await }
    });
    handler.wait_for(&handler.started, 1).await;
    let draining = tokio::spawn(first.drain());
    while !caller.workers().is_empty() {
        tokio::task::yield_now().await;
    }
    let mut starting = std::pin::pin!(session.start(SERVICE, Arc::new(Oddities::default())));
    assert!(tokio::time::timeout(Duration::from_secs(1), &mut starting).await.is_err(), "calls to its name would be refused");
    handler.release.notify_one();
    let heir = starting.await.unwrap();
    assert_eq!(read(&held.await.unwrap().unwrap().payload), "released");
    draining.await.unwrap();
    caller.wait_for_workers(1, Duration::from_secs(10)).await.unwrap();
    assert_eq!(read(&caller.call("echo", word("anew"), CallOptions::default()).await.unwrap().payload), "anew");
    assert!(tokio::time::timeout(Duration::from_millis(500), heir.name_taken()).await.is_err(), "nobody else has the name");
}
