//! A robot's cell and an office in networks of their own, with a slow link between: the short part of `tests/networks/trials.py`.
//!
//! It makes network namespaces, which only root may: elsewhere it is left out, and says so on standard error.

use std::io::{ErrorKind, Write};
use std::path::Path;
use std::process::Command;

/// What the script exits with where something that it needs is not there.
const SKIPPED: i32 = 77;

/// Says it whether or not the test's output is captured.
fn left_out(why: &str) {
    writeln!(std::io::stderr(), "networks apart are left out: {why}").expect("standard error is open");
}

#[test]
fn over_a_slow_link_delay_is_paid_once_nothing_crosses_unasked_and_a_cut_heals() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/networks/trials.py");
    let ran = Command::new("python3").arg(script).args(["--program", env!("CARGO_BIN_EXE_repose"), "short"]).output();
    let ran = match ran {
        Err(error) if error.kind() == ErrorKind::NotFound => return left_out("there is no python3"),
        ran => ran.expect("the script runs"),
    };
    let (said, log) = (String::from_utf8_lossy(&ran.stdout), String::from_utf8_lossy(&ran.stderr));
    match ran.status.code() {
        Some(SKIPPED) => left_out(log.trim()),
        code => assert_eq!(code, Some(0), "{said}{log}"),
    }
}
