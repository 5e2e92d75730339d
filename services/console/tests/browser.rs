//! The page in a browser, on a running system: `scripts/browser-tests`, which installs what it needs. Left out of `cargo test`.

use std::path::Path;
use std::process::Command;

#[test]
#[ignore = "needs Chromium and Node: run scripts/browser-tests"]
fn the_page_does_the_whole_job_in_a_browser() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scripts/browser-tests");
    let status = Command::new(script).status().expect("the script starts");
    assert!(status.success(), "{status}");
}
