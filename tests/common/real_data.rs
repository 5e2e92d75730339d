//! Where tests find real data, which is not in the repository. Included by path: `#[path = "…/tests/common/real_data.rs"] mod real_data;`.

use std::io::Write;
use std::path::{Path, PathBuf};

/// Names the folder with the data; what is not there is then an error.
const VARIABLE: &str = "REPOSE_DATA";
/// The folder beside the repository that is taken without the variable. Every crate is two or three folders deep.
const BESIDE: [&str; 2] = ["../../../shared/data", "../../../../shared/data"];

/// A file or folder of the data. `None` where there is no data, which is said on standard error past the harness that keeps what passing
/// tests print: a test that skips must not look like one that has tested.
///
/// # Panics
/// When `REPOSE_DATA` names a folder that lacks it.
pub fn real_data(below: &str) -> Option<PathBuf> {
    if let Some(root) = std::env::var_os(VARIABLE) {
        let path = Path::new(&root).join(below);
        assert!(path.exists(), "{VARIABLE} is set, and there is no {}", path.display());
        return Some(path);
    }
    let found = BESIDE.iter().map(|root| Path::new(env!("CARGO_MANIFEST_DIR")).join(root).join(below)).find(|path| path.exists());
    if found.is_none() {
        let test = std::thread::current().name().unwrap_or("a test").to_owned();
        let _unread = writeln!(std::io::stderr(), "SKIPPED {test}: it needs {below} of the data that {VARIABLE} names");
    }
    found
}
