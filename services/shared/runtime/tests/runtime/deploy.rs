//! What the examples in `deploy/` promise: every field of the runtime's sections with its default, and files that can be read.

use std::path::{Path, PathBuf};

use repose_proto::Service;
use repose_runtime::deployment::Roles;
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
