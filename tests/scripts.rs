//! What needs more than Rust: tests with a browser, with Python, with other people's software. Each is a script that installs what it needs;
//! `cargo test` says that they were left out, and `.ci/run` runs them.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::Command;

fn root() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

fn run(script: &str) {
    let status = Command::new(root().join("scripts").join(script)).status().expect("the script starts");
    assert!(status.success(), "{status}");
}

#[test]
#[ignore = "needs Chromium and Node: run scripts/browser-tests"]
fn browser_tests() {
    run("browser-tests");
}

#[test]
#[ignore = "needs Python and PyPI: run scripts/python-tests"]
fn python_tests() {
    run("python-tests");
}

#[test]
#[ignore = "needs Debian's prometheus: run scripts/prometheus-tests"]
fn prometheus_tests() {
    run("prometheus-tests");
}

#[test]
#[ignore = "needs Python and PyPI: run scripts/mcp-tests"]
fn mcp_tests() {
    run("mcp-tests");
}

#[test]
#[ignore = "needs Python and PyPI: run scripts/recording-tests"]
fn recording_tests() {
    run("recording-tests");
}

#[test]
#[ignore = "needs Python and PyPI: run scripts/ros2-tests"]
fn ros2_tests() {
    run("ros2-tests");
}

#[test]
#[ignore = "needs Python and PyPI: run scripts/franka-tests"]
fn franka_tests() {
    run("franka-tests");
}

#[test]
#[ignore = "needs Python and PyPI: run scripts/foreign-world-tests"]
fn foreign_world_tests() {
    run("foreign-world-tests");
}

#[test]
fn what_packages_are_built_with_is_linted_before_a_change_lands() {
    let read = |path: &str| std::fs::read_to_string(root().join(path)).unwrap_or_else(|e| panic!("{path}: {e}"));
    let manifest: toml::Table = read("services/cli/Cargo.toml").parse().expect("TOML");
    let features = manifest["package"]["metadata"]["deb"]["features"].as_array().expect("a list").iter().filter_map(toml::Value::as_str);
    let (features, checks) = (features.collect::<Vec<_>>(), read(".ci/run"));
    assert!(!features.is_empty());
    for (feature, command) in features.iter().flat_map(|feature| ["cargo clippy ", "cargo doc "].map(|command| (feature, command))) {
        let option = format!(" --features repose-cli/{feature}");
        let has_it = |line: &str| line.starts_with("step ") && line.contains(command) && line.contains(&option);
        assert!(checks.lines().any(has_it), "no step with {command}compiles {feature}");
    }
}

#[test]
fn every_script_of_tests_is_named_here_and_run_before_a_change_lands() {
    let read = |path: &str| std::fs::read_to_string(root().join(path)).unwrap_or_else(|e| panic!("{path}: {e}"));
    let (here, checks) = (read("tests/scripts.rs"), read(".ci/run"));
    let entries = std::fs::read_dir(root().join("scripts")).expect("the folder of scripts");
    let names: BTreeSet<String> = entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("a plain name")).collect();
    let scripts: Vec<&String> = names.iter().filter(|name| name.ends_with("-tests")).collect();
    assert!(!scripts.is_empty());
    for script in scripts {
        assert!(here.contains(&format!("run(\"{script}\")")), "{script} is not in tests/scripts.rs");
        assert!(checks.lines().any(|line| line == format!("step scripts/{script}")), "{script} is not in .ci/run");
    }
}
