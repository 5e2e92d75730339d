//! The checked-in JSON Schemas are those of the types. `REPOSE_BLESS=1 cargo test -p repose-proto` rewrites them.

use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("schemas")
}

#[test]
fn the_checked_in_schemas_are_those_of_the_types() {
    let bless = std::env::var_os("REPOSE_BLESS").is_some();
    let mut names = Vec::new();
    for (name, schema) in repose_proto::schemas::all() {
        let path = folder().join(format!("{name}.json"));
        let text = serde_json::to_string_pretty(&schema).unwrap() + "\n";
        if bless {
            std::fs::create_dir_all(folder()).unwrap();
            std::fs::write(&path, &text).unwrap();
        }
        let checked_in = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(checked_in == text, "{} has drifted from its type; REPOSE_BLESS=1 rewrites it", path.display());
        names.push(format!("{name}.json"));
    }
    for entry in std::fs::read_dir(folder()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(names.contains(&name), "{name} is no message's schema any more");
    }
}
