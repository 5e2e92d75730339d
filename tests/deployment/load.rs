//! `repose load` with a system of its own: a mix of requests while processes are killed, asked by one process and by several.

use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::OsStrExt;
use std::process::Command;

use serde_json::Value;

use crate::common::repose;

fn load(args: &[&str]) -> Value {
    load_with_log(args).0
}

/// The same where every request is to be answered: nobody is lost who waits some seconds for a core, and who has died is waited for.
fn patient_load(args: &[&str]) -> Value {
    let mut command = repose();
    command.env("REPOSE_SESSION__LEASE_MS", "10000").env("REPOSE_CALLER__WORKER_WAIT_MS", "20000");
    run(command, args).0
}

fn load_with_log(args: &[impl AsRef<OsStr>]) -> (Value, String) {
    run(repose(), args)
}

fn run(mut command: Command, args: &[impl AsRef<OsStr>]) -> (Value, String) {
    command.env("REPOSE_INFERENCE__THREADS", "1").args(["--json", "load", "--up", "--deadline-ms", "120000"]).args(args);
    let ended = command.output().expect("it runs");
    let said = || format!("{}{}", String::from_utf8_lossy(&ended.stdout), String::from_utf8_lossy(&ended.stderr));
    assert!(ended.status.success(), "{}", said());
    let report = serde_json::from_slice(&ended.stdout).unwrap_or_else(|_| panic!("no report: {}", said()));
    (report, String::from_utf8_lossy(&ended.stderr).into_owned())
}

fn count(of: &Value, name: &str) -> u64 {
    of["outcomes"][name].as_u64().unwrap_or(0)
}

#[test]
fn a_mix_of_requests_is_answered_while_inference_is_killed_and_each_ends_once() {
    let mix = ["3:variant=geometric", "1:count=2,priority=batch", "1:method=segment"];
    let mix: Vec<&str> = mix.iter().flat_map(|kind| ["--mix", kind]).collect();
    // At a rate, not in a closed loop: a fast machine would have answered all of them before the first process is killed.
    let more = ["--requests", "40", "--rate", "5", "--inference", "2", "--fault", "kill:inference:2s", "--fault", "delay:5ms"];
    let report = load(&[&more[..], &mix].concat());
    assert_eq!((report["requests"].as_u64(), count(&report, "lost"), count(&report, "duplicate")), (Some(40), 0, 0), "{report:#}");
    // On a machine that has too much to do, processes are killed faster than they come up: what nobody could answer is said so.
    let ended = count(&report, "result") + count(&report, "none") + count(&report, "unavailable");
    assert!(ended == 40 && count(&report, "result") > 9, "{report:#}");
    let faults = report["faults"].as_array().expect("faults happened");
    assert!(faults.iter().all(|fault| fault["what"].as_str().is_some_and(|what| what.starts_with("kill inference-"))), "{report:#}");
    let kinds = report["kinds"].as_object().expect("several kinds");
    let asked: u64 = kinds.values().filter_map(|kind| kind["requests"].as_u64()).sum();
    assert!(kinds.len() == 3 && asked == 40 && kinds["variant=geometric"]["requests"].as_u64() > Some(14), "{report:#}");
    assert_eq!(kinds["count=2,priority=batch"]["requests"], report["priorities"]["batch"]["requests"], "{report:#}");
}

#[test]
fn several_processes_ask_what_one_would_have_asked() {
    let folder = tempfile::tempdir().expect("a folder");
    // The name of a file need not be text.
    let lines = folder.path().join(OsStr::from_bytes(b"lines-\xff.csv"));
    let asked = ["--requests", "15", "--clients", "3", "--variant", "geometric", "--agents", "2", "--secured", "--csv"];
    let (report, log) = load_with_log(&[&asked.map(OsString::from)[..], &[lines.clone().into()]].concat());
    assert_eq!(std::fs::read_to_string(&lines).expect("it is written").lines().count(), 1 + 15, "a line for each request");
    let refused: Vec<&str> = log.lines().filter(|line| line.contains("refused: ")).collect();
    assert!(refused.is_empty(), "whoever does what his role is for is refused nothing: {refused:#?}");
    assert_eq!((report["requests"].as_u64(), count(&report, "lost"), count(&report, "duplicate")), (Some(15), 0, 0), "{report:#}");
    assert_eq!(report["per_worker"].as_object().map(|workers| workers.len()), Some(1), "{report:#}");
}

#[test]
fn light_cells_ask_a_pool_with_the_traffic_of_robots_beside_it() {
    let report = patient_load(&["--cells", "4", "--clients", "4", "--requests", "60", "--variant", "geometric", "--routers", "2"]);
    assert_eq!((count(&report, "lost"), count(&report, "duplicate")), (0, 0), "{report:#}");
    assert_eq!(count(&report, "result") + count(&report, "none"), 60, "{report:#}");
    let light = &report["light"];
    let rate = |name: &str| light[name].as_f64().unwrap_or(0.0);
    // Four times fifty, and whatever a busy machine leaves of it; each is heard by the cell's other session, at whichever router.
    assert!(rate("states_put_per_s") > 50.0 && rate("states_heard_per_s") > 0.8 * rate("states_put_per_s"), "{light:#}");
    assert!(rate("summaries_put_per_s") > 5.0, "{light:#}");
    assert_eq!(light["scenes_sent"], 4, "each cell's scene goes to the pool once: {light:#}");
    assert!(rate("slowest_over_fastest") >= 1.0, "how unevenly cells waited is told: {light:#}");
}

#[test]
fn of_two_routers_one_may_be_killed_while_placements_are_asked() {
    let more = ["--requests", "24", "--rate", "3", "--variant", "geometric", "--routers", "2", "--fault", "router:3s:1s"];
    let report = patient_load(&more);
    assert_eq!((report["requests"].as_u64(), count(&report, "lost"), count(&report, "duplicate")), (Some(24), 0, 0), "{report:#}");
    assert_eq!(count(&report, "result") + count(&report, "none"), 24, "{report:#}");
    let faults: Vec<&str> =
        report["faults"].as_array().expect("faults happened").iter().filter_map(|fault| fault["what"].as_str()).collect();
    assert!(faults.contains(&"kill router-1") && faults.contains(&"kill router-2"), "each in its turn: {faults:?}");
}
