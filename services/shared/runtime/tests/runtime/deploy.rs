//! What the examples in `deploy/` promise: every field of the runtime's sections with its default, and files that can be read. And what is written of
//! a roles file: certificates that fit their hosts and keys, and a unit for every process.

use std::path::{Path, PathBuf};

use rcgen::KeyPair;
use repose_proto::Service;
use repose_runtime::deployment::{Failed, Roles, TrialFiles, write};
use repose_runtime::{METRICS, RuntimeConfig, SessionMode, load_config};

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
    let sections = serde_json::json!({"session": loaded.session, "caller": loaded.caller, "worker": loaded.worker});
    let missing = fields("", &sections).into_iter().find(|line| !text.lines().any(|l| l.trim_start_matches("# ").starts_with(line)));
    assert_eq!(missing, None);
}

/// How the lines begin that a file of tables has for every field of a document.
fn fields(table: &str, document: &serde_json::Value) -> Vec<String> {
    let of_field = |(name, value): (&String, &serde_json::Value)| match value {
        serde_json::Value::Object(_) => {
            let table = format!("{table}{name}");
            [vec![format!("[{table}]")], fields(&format!("{table}."), value)].concat()
        }
        _ => vec![format!("{name} =")],
    };
    document.as_object().into_iter().flatten().flat_map(of_field).collect()
}

#[test]
fn the_examples_can_be_read() {
    RuntimeConfig::load(Some(&deploy().join("one-machine/router.toml"))).unwrap();
    let roles = std::fs::read_to_string(deploy().join("roles.toml")).unwrap();
    assert!(!Roles::parse(&roles).unwrap().users.is_empty());
    assert!(load_config::<serde_json::Value>("planner", Some(&deploy().join("repose.toml"))).unwrap()["threads"].is_number());
}

#[test]
fn every_method_that_a_service_answers_is_known_by_its_name() {
    for service in Service::ALL {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../{service}/src/endpoints.rs"));
        let text = std::fs::read_to_string(file).unwrap();
        let arms = text.lines().filter_map(|line| line.trim_start().strip_prefix('"')?.split_once("\" => ").map(|(method, _)| method));
        assert_eq!(arms.collect::<Vec<_>>(), service.methods(), "{service}");
    }
}

/// The names in a text that look like metrics of ours, without what Prometheus adds to histograms.
fn metrics_named(text: &str) -> std::collections::BTreeSet<String> {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    let ours = words.filter(|word| word.starts_with("repose_") || word.starts_with("process_"));
    ours.map(|word| ["_bucket", "_sum", "_count"].iter().find_map(|end| word.strip_suffix(end)).unwrap_or(word).to_owned()).collect()
}

#[test]
fn every_metric_that_the_board_and_the_alerts_name_exists() {
    let known: Vec<&str> = METRICS.iter().map(|(name, _)| *name).collect();
    for file in ["grafana/repose.json", "prometheus/alerts.yml"] {
        let text = std::fs::read_to_string(deploy().join(file)).unwrap();
        let named = metrics_named(&text);
        assert!(named.len() >= 5, "{file} names {named:?}");
        for name in named {
            assert!(known.contains(&name.as_str()), "{file} names {name}, which no process tells");
        }
    }
}

#[test]
fn the_board_looks_as_often_as_prometheus_does_and_at_our_processes_alone() {
    let text = std::fs::read_to_string(deploy().join("grafana/repose.json")).unwrap();
    // Prometheus looks once a minute unless it is told otherwise: over one minute there is no rate then.
    assert_eq!(text.matches("rate(").count(), text.matches("[$__rate_interval]").count());
    // Programs of every kind tell metrics with these names.
    for name in ["process_resident_memory_bytes", "process_open_fds"] {
        assert_eq!(text.matches(name).count(), text.matches(&format!("{name}{{job=\\\"repose\\\"}}")).count(), "{name}");
    }
}

#[test]
fn every_metric_in_the_table_is_told_by_some_source_and_every_one_told_is_in_the_table() {
    let services = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut folders = vec![services];
    let mut told = std::collections::BTreeSet::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") && path.components().any(|c| c.as_os_str() == "src") {
                let text = std::fs::read_to_string(&path).unwrap();
                for call in ["counter!(", "gauge!(", "histogram!("] {
                    let names = text.split(call).skip(1).filter_map(|rest| rest.trim_start().strip_prefix('"')?.split('"').next());
                    told.extend(names.map(str::to_owned));
                }
            }
        }
    }
    let known: std::collections::BTreeSet<String> = METRICS.iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(told, known);
}

/// A motion worker's roles, with the router at an address.
fn roles(router: &str) -> Roles {
    let text = format!("router = \"{router}\"\ncells = [\"lab\"]\n[users.motion]\nrole = \"service\"\nservice = \"motion\"\n");
    Roles::parse(&text).unwrap()
}

/// Whether somebody is told that the router's certificate is for one host and not for another.
fn names_hosts(refused: &Failed, old: &str, new: &str) -> bool {
    let words = [format!("is for {old}, "), format!("not for {new}:")];
    refused.path.ends_with("router/router.pem") && words.iter().all(|words| refused.message.contains(words))
}

#[test]
fn a_router_of_another_name_needs_another_certificate() {
    for (old, new) in [("old.example", "new.example"), ("10.0.0.8", "10.0.0.9"), ("[fd00::1]", "[fd00::2]"), ("old.example", "10.0.0.9")] {
        let folder = tempfile::tempdir().unwrap();
        let written = |host: &str| write(&roles(&format!("{host}:7447")), folder.path(), folder.path());
        let [named_old, named_new] = [old, new].map(|host| host.trim_matches(['[', ']']));
        written(old).unwrap();
        written(old).expect("one that is for the router stays");
        let refused = written(new).unwrap_err();
        assert!(names_hosts(&refused, named_old, named_new), "{refused}");
        // The trial on a router apart does not come by that name.
        let of_router = |host: &str| TrialFiles::write(&roles(&format!("{host}:7447")), folder.path()).unwrap().router();
        assert!(of_router(old).is_ok());
        let refused = of_router(new).unwrap_err();
        assert!(names_hosts(&refused, named_old, named_new), "{refused}");
        std::fs::remove_file(folder.path().join("router/router.pem")).unwrap();
        written(new).expect("another is made");
        assert!(of_router(new).is_ok());
    }
}

#[test]
fn a_router_of_another_name_takes_the_place_of_the_earlier_one_among_an_operators_own() {
    let folder = tempfile::tempdir().unwrap();
    let written = |router: &str| write(&roles(router), folder.path(), folder.path()).unwrap();
    let [motion, router] = ["users/motion/repose.toml", "router/router.toml"].map(|file| folder.path().join(file));
    let edit = |file: &Path, ours: &str, with_own: &str| {
        let text = std::fs::read_to_string(file).unwrap();
        assert!(text.contains(ours), "{text}");
        std::fs::write(file, text.replace(ours, with_own)).unwrap();
    };
    let endpoints = || {
        let session = |file: &Path| RuntimeConfig::load(Some(file)).unwrap().session;
        (session(&motion).connect, session(&router).listen)
    };
    written("old.example:7447");
    edit(&motion, "\"quic/old.example:7447\"", "\"quic/standby.example:7447\", \"quic/old.example:7447\"");
    edit(&router, "\"quic/0.0.0.0:7447\"", "\"quic/0.0.0.0:7447\", \"tcp/127.0.0.1:7450\"");
    let own = endpoints();
    written("old.example:7447");
    assert_eq!(endpoints(), own);
    std::fs::remove_file(folder.path().join("router/router.pem")).unwrap();
    for (host, port) in [("new.example", 7448), ("new.example", 7449)] {
        written(&format!("{host}:{port}"));
        let expected = (
            vec!["quic/standby.example:7447".to_owned(), format!("quic/{host}:{port}")],
            vec![format!("quic/0.0.0.0:{port}"), "tcp/127.0.0.1:7450".to_owned()],
        );
        assert_eq!(endpoints(), expected);
    }
}

#[test]
fn a_user_may_be_called_router_and_the_trials_router_is_another() {
    let folder = tempfile::tempdir().unwrap();
    let text = "router = \"router.example:7447\"\ncells = [\"lab\"]\n[users.router]\nrole = \"viewer\"\n";
    let roles = Roles::parse(text).unwrap();
    write(&roles, folder.path(), folder.path()).unwrap();
    let trial = TrialFiles::write(&roles, folder.path()).unwrap();
    let of_router = std::fs::read_to_string(trial.router().unwrap()).unwrap();
    assert!(of_router.contains("access_control") && of_router.contains("users.txt"), "{of_router}");
}

#[test]
fn a_certificate_of_an_operators_own_may_be_for_every_host_of_a_domain() {
    let folder = tempfile::tempdir().unwrap();
    let own = rcgen::generate_simple_self_signed(["*.cell.example".to_owned()]).unwrap();
    std::fs::create_dir(folder.path().join("router")).unwrap();
    std::fs::write(folder.path().join("router/router.pem"), own.cert.pem()).unwrap();
    std::fs::write(folder.path().join("router/router-key.pem"), own.signing_key.serialize_pem()).unwrap();
    write(&roles("router.cell.example:7447"), folder.path(), folder.path()).expect("it is for the router, too");
    let refused = write(&roles("router.hall.example:7447"), folder.path(), folder.path()).unwrap_err();
    assert!(refused.message.contains("is for *.cell.example, not for router.hall.example:"), "{refused}");
}

#[test]
fn a_certificate_belongs_to_its_key_also_where_writing_one_of_them_failed() {
    let belongs = |folder: &Path| {
        let [certificate, key] =
            ["router.pem", "router-key.pem"].map(|file| std::fs::read_to_string(folder.join("router").join(file)).unwrap());
        let (_rest, certificate) = x509_parser::pem::parse_x509_pem(certificate.as_bytes()).unwrap();
        let certified = certificate.parse_x509().unwrap().public_key().subject_public_key.data.to_vec();
        certified == KeyPair::from_pem(&key).unwrap().public_key_raw()
    };
    for (lost, unwritable) in [("router.pem", "router-key.pem"), ("router-key.pem", "router.pem")] {
        let folder = tempfile::tempdir().unwrap();
        let written = || write(&roles("router.example:7447"), folder.path(), folder.path());
        written().unwrap();
        std::fs::remove_file(folder.path().join("router").join(lost)).unwrap();
        // As a full disk: there is no place for the new one.
        let in_the_way = folder.path().join("router").join(format!("{unwritable}.new"));
        std::fs::create_dir(&in_the_way).unwrap();
        assert!(written().unwrap_err().path.ends_with(unwritable));
        std::fs::remove_dir(&in_the_way).unwrap();
        written().unwrap();
        assert!(belongs(folder.path()), "{lost} was lost");
    }
}

#[test]
fn an_authority_whose_key_could_not_be_written_is_made_anew() {
    let folder = tempfile::tempdir().unwrap();
    let written = || write(&roles("router.example:7447"), folder.path(), folder.path());
    let in_the_way = folder.path().join("authority/authority-key.pem.new");
    std::fs::create_dir_all(&in_the_way).unwrap();
    assert!(written().unwrap_err().path.ends_with("authority-key.pem"));
    std::fs::remove_dir(&in_the_way).unwrap();
    written().expect("one without its key would sign nothing, ever");
}

#[test]
fn a_services_user_has_a_unit_for_each_of_its_cells() {
    let folder = tempfile::tempdir().unwrap();
    let text = "router = \"router.example:7447\"\ncells = [\"line-1\", \"line-2\", \"hall\"]\n[pools]\nrack = [\"line-1\", \"line-2\"]\n\
                [users.motion]\nrole = \"service\"\nservice = \"motion\"\n\
                [users.planner]\nrole = \"service\"\nservice = \"planner\"\ncells = [\"rack\"]\n";
    write(&Roles::parse(text).unwrap(), folder.path(), Path::new("/etc/repose")).unwrap();
    let units = folder.path().join("units");
    let run = |name: &str| {
        let text = std::fs::read_to_string(units.join(name)).unwrap();
        text.lines().find_map(|line| line.strip_prefix("ExecStart=/usr/bin/repose serve ")).unwrap().to_owned()
    };
    let config = "--config /etc/repose/users/motion/repose.toml";
    assert_eq!(run("repose-motion.service"), format!("motion {config}"), "its configuration names the first");
    assert_eq!(run("repose-motion.line-2.service"), format!("motion --cell line-2 --pool rack {config}"));
    // Its configuration names the pool of the first cell, and this one has none.
    assert_eq!(run("repose-motion.hall.service"), format!("motion --cell hall --pool hall {config}"));
    assert_eq!(run("repose-planner.service"), "planner --config /etc/repose/users/planner/repose.toml");
    assert_eq!(std::fs::read_dir(&units).unwrap().count(), 5, "and the router's");
}
