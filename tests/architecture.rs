//! The rules of who may know whom, read off the crates' manifests and sources.
//!
//! A rule that is broken prints the file at fault. The rules themselves: pure crates do no I/O and know no runtime; only
//! `shared/runtime` imports zenoh; a service never depends on another; in a service only the files that face the network or own the
//! compute use the runtime.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

const PURE: [&str; 14] = [
    "repose-belief",
    "repose-geometry",
    "repose-relations",
    "repose-made-scenes",
    "repose-networks",
    "repose-panda",
    "repose-pictures",
    "repose-robot-side",
    "repose-ros-messages",
    "repose-sensor",
    "repose-sentences",
    "repose-simd",
    "repose-tracking",
    "repose-words",
];
const SERVICES: [&str; 5] = ["repose-perception", "repose-inference", "repose-planner", "repose-motion", "repose-simulator"];
/// In a service, the files that may name the runtime: those that face the network or own the compute. Everything else is domain code.
const RUNTIME_FILES: [&str; 10] = [
    "weights_file.rs",
    "endpoints.rs",
    "lib.rs",
    "worker.rs",
    "config.rs",
    "cameras.rs",
    "remote_models.rs",
    "robot_link.rs",
    "client_watch.rs",
    "neighbours.rs",
];

struct Member {
    dir: PathBuf,
    dependencies: Vec<String>,
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().expect("the workspace's root")
}

fn members() -> BTreeMap<String, Member> {
    let mut manifests = vec![root().join("proto/Cargo.toml")];
    for folder in ["services", "services/shared"] {
        for entry in std::fs::read_dir(root().join(folder)).expect("the services folder") {
            let manifest = entry.expect("a folder entry").path().join("Cargo.toml");
            if manifest.exists() {
                manifests.push(manifest);
            }
        }
    }
    manifests
        .into_iter()
        .map(|path| {
            let manifest: toml::Table = std::fs::read_to_string(&path).expect("a manifest").parse().expect("TOML");
            let names =
                |table: &str| manifest.get(table).and_then(toml::Value::as_table).map(|t| t.keys().cloned().collect()).unwrap_or_default();
            let name = manifest["package"]["name"].as_str().expect("a package name").to_owned();
            let member = Member { dir: path.parent().expect("a folder").to_owned(), dependencies: names("dependencies") };
            (name, member)
        })
        .collect()
}

fn sources(dir: &Path) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).into_iter().flatten() {
            let path = entry.expect("a folder entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = std::fs::read_to_string(&path).expect("a source file");
                found.push((path, text));
            }
        }
    }
    assert!(!found.is_empty(), "no sources in {}", dir.display());
    found.sort();
    found
}

/// The code lines of a source without comments, and without what only tests are built with, wherever in the file it is: as rustfmt writes it, an
/// item ends in the column in which it begins.
fn code(text: &str) -> String {
    let (mut kept, mut lines) = (Vec::new(), text.lines().filter(|l| !l.trim_start().starts_with("//")));
    while let Some(line) = lines.next() {
        let Some(indent) = line.strip_suffix("#[cfg(test)]") else {
            kept.push(line);
            continue;
        };
        let in_column = |l: &str| l.strip_prefix(indent).is_some_and(|l| !l.starts_with([' ', '#']));
        let _end = lines.find(|l| in_column(l) && (l.trim_start().starts_with('}') || l.ends_with([';', '}', ','])));
    }
    kept.join("\n")
}

#[test]
fn pure_crates_depend_on_no_runtime_and_do_no_io() {
    let members = members();
    for name in PURE {
        let member = &members[name];
        for forbidden in ["tokio", "zenoh", "repose-runtime", "tracing", "futures", "async-trait", "image"] {
            assert!(!member.dependencies.iter().any(|d| d == forbidden), "{name} is pure and must not depend on {forbidden}");
        }
        for (path, text) in sources(&member.dir.join("src")) {
            for forbidden in ["std::fs", "std::net", "std::env::var", "async fn", "std::process"] {
                assert!(!code(&text).contains(forbidden), "{} is in a pure crate and uses {forbidden}", path.display());
            }
        }
    }
}

#[test]
fn proto_depends_on_nothing_of_ours() {
    let member = &members()["repose-proto"];
    let ours: Vec<_> = member.dependencies.iter().filter(|d| d.starts_with("repose-")).collect();
    assert!(ours.is_empty(), "proto depends on {ours:?}");
}

#[test]
fn only_the_runtime_imports_zenoh() {
    for (name, member) in members() {
        if name == "repose-runtime" {
            continue;
        }
        assert!(!member.dependencies.iter().any(|d| d.starts_with("zenoh")), "{name} depends on zenoh");
        for (path, text) in sources(&member.dir.join("src")) {
            assert!(!code(&text).contains("zenoh::"), "{} uses zenoh", path.display());
        }
    }
}

#[test]
fn clients_stop_robots_read_states_and_find_scenes_by_the_runtimes_functions() {
    // Whoever asks one perception worker for the newest scene misses those of the others; whoever moves a robot without its token is not missed
    // when it dies. What names, records and plays messages, and what hands them to another language, knows them one by one.
    const BY_THE_MESSAGE: [&str; 4] = ["repose-proto", "repose-runtime", "repose-recorder", "repose-python"];
    for (name, member) in members() {
        if BY_THE_MESSAGE.contains(&name.as_str()) {
            continue;
        }
        for (path, text) in sources(&member.dir.join("src")) {
            for forbidden in ["call(\"latest\"", "Traffic::EmergencyStop", "live_client(&", "decode_json::<RobotState>"] {
                assert!(!code(&text).contains(forbidden), "{} has a copy of what the runtime does: {forbidden}", path.display());
            }
        }
    }
}

#[test]
fn whoever_serves_over_http_lets_silent_connections_and_unending_requests_go() {
    for (name, member) in members() {
        for (path, text) in sources(&member.dir.join("src")) {
            let serves = ["axum::serve(", "http1::Builder", "auto::Builder"].iter().any(|way| code(&text).contains(way));
            let limited = name == "repose-runtime" && path.ends_with("src/http.rs");
            assert!(limited || !serves, "{} of {name} lets clients keep connections for ever: use serve_http", path.display());
        }
    }
}

#[test]
fn a_service_depends_on_no_other_service() {
    for (name, member) in members() {
        let is_service = SERVICES.contains(&name.as_str());
        let may_start_services = ["repose-cli", "repose-evaluation", "repose-local", "repose-python"].contains(&name.as_str());
        if may_start_services {
            continue;
        }
        for dependency in &member.dependencies {
            assert!(!SERVICES.contains(&dependency.as_str()), "{name} (service: {is_service}) depends on the service {dependency}");
        }
    }
}

#[test]
fn training_takes_its_data_through_the_dataset_crate() {
    let training = &members()["repose-training"];
    assert!(training.dependencies.iter().any(|d| d == "repose-dataset"));
    assert!(!training.dependencies.iter().any(|d| d == "repose-runtime"));
}

#[test]
fn of_the_console_only_what_faces_the_network_knows_the_runtime() {
    // Its other async files face browsers: queues of messages, and TLS.
    const OUTER: [&str; 4] = ["access.rs", "cell.rs", "config.rs", "lib.rs"];
    for (path, text) in sources(&members()["repose-console"].dir.join("src")) {
        let file = path.file_name().and_then(|f| f.to_str()).unwrap_or_default();
        let outer = OUTER.contains(&file) || path.components().any(|c| c.as_os_str() == "endpoints");
        assert!(outer || !code(&text).contains("repose_runtime"), "{} uses the runtime", path.display());
    }
}

#[test]
fn of_the_franka_driver_only_what_faces_the_cell_knows_the_runtime() {
    const OUTER: [&str; 3] = ["endpoints.rs", "error.rs", "lib.rs"];
    for (path, text) in sources(&members()["repose-franka"].dir.join("src")) {
        let outer = path.file_name().and_then(|f| f.to_str()).is_some_and(|file| OUTER.contains(&file));
        for forbidden in ["repose_runtime", "async fn", "tokio::"] {
            assert!(outer || !code(&text).contains(forbidden), "{} uses {forbidden}: the control loop waits for nobody", path.display());
        }
    }
}

#[test]
fn the_kit_of_the_agents_protocol_is_known_in_one_file() {
    for (path, text) in sources(&members()["repose-mcp"].dir.join("src")) {
        let is_protocol = path.file_name().is_some_and(|file| file == "protocol.rs");
        assert!(is_protocol || !code(&text).contains("rmcp::"), "{} knows the kit", path.display());
    }
}

#[test]
fn in_a_service_only_the_outer_files_know_the_runtime() {
    let members = members();
    for name in SERVICES {
        for (path, text) in sources(&members[name].dir.join("src")) {
            let file = path.file_name().and_then(|f| f.to_str()).unwrap_or_default();
            let outer = RUNTIME_FILES.contains(&file) || path.components().any(|c| c.as_os_str() == "endpoints");
            assert!(outer || !code(&text).contains("repose_runtime"), "{} is domain code and uses the runtime", path.display());
            assert!(outer || !code(&text).contains("async fn"), "{} is domain code and is async", path.display());
        }
    }
}

#[test]
fn every_dependency_has_its_version_in_the_workspace_table() {
    for (name, member) in members() {
        let manifest: toml::Table = std::fs::read_to_string(member.dir.join("Cargo.toml")).expect("a manifest").parse().expect("TOML");
        for table in ["dependencies", "dev-dependencies"] {
            for (dependency, value) in manifest.get(table).and_then(toml::Value::as_table).into_iter().flatten() {
                let inherited = value.get("workspace").and_then(toml::Value::as_bool) == Some(true);
                assert!(inherited, "{name} gives {dependency} a version of its own");
            }
        }
        assert!(manifest["lints"]["workspace"].as_bool() == Some(true), "{name} does not take the workspace's lints");
    }
}

#[test]
fn every_dependency_is_used() {
    let mut named = BTreeSet::new();
    for (name, member) in members() {
        let manifest: toml::Table = std::fs::read_to_string(member.dir.join("Cargo.toml")).expect("a manifest").parse().expect("TOML");
        let mut files = sources(&member.dir);
        if name == "repose-cli" {
            files.extend(sources(&root().join("tests")));
        }
        // Named for the features that a build of one member gets of others, so that it takes what a build of all has compiled.
        let for_features: Vec<&str> = manifest["package"]
            .get("metadata")
            .and_then(|metadata| metadata.get("for_features")?.as_array())
            .map_or_else(Vec::new, |names| names.iter().filter_map(toml::Value::as_str).collect());
        let mentions = |dependency: &str, file: &(PathBuf, String)| {
            let start = format!("{}::", dependency.replace('-', "_"));
            let code = file.1.lines().filter(|l| !l.trim_start().starts_with("//"));
            code.flat_map(|l| l.match_indices(&start).map(move |(at, _)| &l[..at]))
                .any(|before| !before.ends_with(|c: char| c.is_alphanumeric() || c == '_'))
        };
        for (table, of_tests) in [("dependencies", false), ("dev-dependencies", true)] {
            for dependency in manifest.get(table).and_then(toml::Value::as_table).into_iter().flat_map(toml::Table::keys) {
                let may_use = |file: &&(PathBuf, String)| of_tests || file.0.starts_with(member.dir.join("src"));
                let is_used = files.iter().filter(may_use).any(|file| mentions(dependency, file));
                let used = is_used != for_features.contains(&dependency.as_str());
                assert!(used, "{name} names {dependency} among its {table} and does not use it, or uses what it names for its features");
                named.insert(dependency.clone());
            }
        }
    }
    let manifest: toml::Table = std::fs::read_to_string(root().join("Cargo.toml")).expect("a manifest").parse().expect("TOML");
    let offered = manifest["workspace"]["dependencies"].as_table().expect("the version table");
    let idle: Vec<_> = offered.keys().filter(|dependency| !named.contains(*dependency)).collect();
    assert!(idle.is_empty(), "no member takes {idle:?} of the workspace's table");
}

#[test]
fn no_file_is_longer_than_a_thousand_lines() {
    for (_, member) in members() {
        for (path, text) in sources(&member.dir) {
            let lines = text.lines().count();
            assert!(lines <= 1000, "{} has {lines} lines", path.display());
        }
    }
}

#[test]
fn the_top_level_holds_what_it_should_and_nothing_else() {
    let allowed =
        ["Cargo.toml", "Cargo.lock", "README.md", "LICENSE-APACHE", "LICENSE-MIT", "proto", "services", "deploy", "scripts", "tests"];
    let built = ["target", "out"];
    for entry in std::fs::read_dir(root()).expect("the workspace's root") {
        let name = entry.expect("a folder entry").file_name().into_string().expect("a plain name");
        let known = name.starts_with('.') || allowed.contains(&name.as_str()) || built.contains(&name.as_str());
        assert!(known, "{name} does not belong at the top level");
    }
}

#[test]
fn the_band_that_perception_takes_off_a_cloud_is_the_one_that_others_put_back_on() {
    let taken_px = repose_perception::Settings::default().borders.radius_px as f32;
    let networks = repose_networks::Models::embedded().expect("the weights that come with the program");
    assert_eq!(networks.config().cloud.border_px, taken_px, "the relation predictor's gaps");
    let bottoms_px = repose_belief::BeliefSettings::default().border_px;
    assert!((taken_px..=taken_px + 1.0).contains(&bottoms_px), "the planner's bottoms: {bottoms_px}, a pixel more than {taken_px} at most");
}

/// A file of a crate in the crate's module tree: `search/settings.rs` is `search::settings`, `search/mod.rs` is `search`.
fn module_of(file: &Path, src: &Path) -> Vec<String> {
    let below = file.strip_prefix(src).expect("a file of the crate").with_extension("");
    let mut module: Vec<String> = below.iter().map(|part| part.to_str().expect("a plain name").to_owned()).collect();
    if module.last().is_some_and(|last| ["mod", "lib", "main"].contains(&last.as_str())) {
        module.pop();
    }
    module
}

/// The paths below `crate::`, `self::` and `super::` that a source names, as modules from the crate's root; `use` trees are spread out.
fn named_modules(code: &str, module: &[String]) -> Vec<Vec<String>> {
    let mut named = Vec::new();
    let mut spread = |text: &str| spread_out(text, module, &mut named);
    let flat: String = code.split_whitespace().collect::<Vec<_>>().join(" ");
    for (at, start) in ["crate::", "super::", "self::"].iter().flat_map(|start| flat.match_indices(start)) {
        let before = flat[..at].chars().next_back();
        // `$crate::` is another crate's, `a::super::` goes on from elsewhere.
        if before.is_none_or(|c| !c.is_alphanumeric() && !['_', ':', '$'].contains(&c)) {
            let end = flat[at..].find([';', '(', ')', '<', '>', '=', '[', '.', '&']).map_or(flat.len(), |length| at + length);
            spread(&flat[at..end.max(at + start.len())]);
        }
    }
    named
}

/// `crate::a::{b::C, d}` is `a::b::C` and `a::d`.
fn spread_out(text: &str, module: &[String], named: &mut Vec<Vec<String>>) {
    let text = text.trim();
    if let Some((head, rest)) = text.split_once('{') {
        let (mut depth, mut start) = (0usize, 0);
        let inner = rest.trim_end().trim_end_matches('}');
        let mut parts = Vec::new();
        for (at, c) in inner.char_indices() {
            match c {
                '{' => depth += 1,
                '}' => depth = depth.saturating_sub(1),
                ',' if depth == 0 => {
                    parts.push(&inner[start..at]);
                    start = at + 1;
                }
                _ => {}
            }
        }
        parts.push(&inner[start..]);
        parts.iter().filter(|part| !part.trim().is_empty()).for_each(|part| spread_out(&format!("{head}{}", part.trim()), module, named));
        return;
    }
    let mut chunks = text.split("::").map(|chunk| chunk.split([' ', ',', '}']).next().unwrap_or_default());
    let mut path: Vec<String> = match chunks.next() {
        Some("crate") => Vec::new(),
        Some("self") => module.to_vec(),
        Some("super") => module[..module.len().saturating_sub(1)].to_vec(),
        _ => return,
    };
    for chunk in chunks {
        match chunk {
            "super" => drop(path.pop()),
            "self" => {}
            chunk => path.push(chunk.to_owned()),
        }
    }
    named.push(path);
}

/// Which file of a crate imports which, faces (`mod.rs`, `lib.rs`) that define nothing aside: they only hand names on.
fn imports_of(src: &Path) -> BTreeMap<PathBuf, BTreeSet<PathBuf>> {
    let files = sources(src);
    let by_module: BTreeMap<Vec<String>, &PathBuf> = files.iter().map(|(path, _)| (module_of(path, src), path)).collect();
    let defines = |text: &str| {
        let items = ["fn ", "struct ", "enum ", "trait ", "const ", "type ", "static "];
        code(text)
            .lines()
            .any(|line| items.iter().any(|item| line.trim_start_matches("pub ").trim_start_matches("pub(crate) ").starts_with(item)))
    };
    let is_face = |path: &Path| {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        ["mod.rs", "lib.rs"].contains(&name) && !files.iter().any(|(file, text)| file == path && defines(text))
    };
    let mut imports: BTreeMap<PathBuf, BTreeSet<PathBuf>> = BTreeMap::new();
    for (path, text) in files.iter().filter(|(path, _)| !is_face(path)) {
        let of = imports.entry(path.clone()).or_default();
        for named in named_modules(&code(text), &module_of(path, src)) {
            // The longest part of the path that is a file.
            let target = (0..=named.len()).rev().find_map(|length| by_module.get(&named[..length]));
            of.extend(target.filter(|target| **target != path && !is_face(target)).map(|target| (*target).clone()));
        }
    }
    imports
}

/// A way from a file back to itself, if there is one.
fn circle_through(start: &Path, imports: &BTreeMap<PathBuf, BTreeSet<PathBuf>>) -> Option<Vec<PathBuf>> {
    let mut came_from: BTreeMap<&Path, &Path> = BTreeMap::new();
    let mut open = vec![start];
    while let Some(at) = open.pop() {
        for next in &imports[at] {
            if next == start {
                let mut way = vec![start.to_owned(), at.to_owned()];
                while let Some(before) = came_from.get(way[way.len() - 1].as_path()) {
                    way.push((*before).to_owned());
                }
                way.dedup();
                way.reverse();
                return Some(way);
            }
            if !came_from.contains_key(next.as_path()) && imports.contains_key(next) {
                came_from.insert(next, at);
                open.push(next);
            }
        }
    }
    None
}

#[test]
fn files_of_a_crate_do_not_import_each_other_in_circles() {
    for (name, member) in members() {
        let src = member.dir.join("src");
        let imports = imports_of(&src);
        if let Some(way) = imports.keys().find_map(|file| circle_through(file, &imports)) {
            let way: Vec<String> = way.iter().map(|path| path.strip_prefix(&src).expect("of the crate").display().to_string()).collect();
            panic!("{name}: {} import each other in a circle", way.join(" -> "));
        }
    }
}

#[test]
fn imports_are_read_as_the_compiler_reads_them() {
    let module = ["search".to_owned(), "ranking".to_owned()];
    let named =
        named_modules("use crate::judge::{self, cost::{Cost, total}, Judge};\nlet x = super::settings::most(self::of::A);", &module);
    let mut named: Vec<String> = named.iter().map(|path| path.join("::")).collect();
    named.sort();
    let expected = ["judge", "judge::Judge", "judge::cost::Cost", "judge::cost::total", "search::ranking::of::A", "search::settings::most"];
    assert_eq!(named, expected);
    assert_eq!(module_of(Path::new("src/search/mod.rs"), Path::new("src")), ["search"]);
    let for_tests = "#[cfg(test)]\n#[path = \"b.rs\"]\nmod b;\nuse c::D;\n#[cfg(test)]\nmod e {\n    fn f() {}\n}\nfn g() {}";
    assert_eq!(code(for_tests), "use c::D;\nfn g() {}");
}

/// The files that git tracks; none, which is said, where this is no checkout.
fn tracked() -> Vec<PathBuf> {
    let listed = std::process::Command::new("git").args(["ls-files", "-z"]).current_dir(root()).output();
    match listed {
        Ok(listed) if listed.status.success() => {
            let names = String::from_utf8(listed.stdout).expect("plain names");
            names.split('\0').filter(|name| !name.is_empty()).map(PathBuf::from).collect()
        }
        _ => {
            println!("skipped: not a git checkout");
            Vec::new()
        }
    }
}

#[test]
fn nothing_that_is_built_is_tracked() {
    for path in tracked() {
        let built = ["target", "out", "__pycache__", "node_modules"];
        let is_built = path.iter().any(|part| built.iter().any(|name| part == *name));
        assert!(!is_built && path.extension().is_none_or(|e| e != "tmp"), "{} is build output", path.display());
    }
}

#[test]
fn no_file_names_a_place_on_the_machine_that_made_it() {
    // Spelt in two halves, so that this file does not name them.
    let places = [["/ho", "me/"], ["/ro", "ot/"], ["/wo", "rk/"], ["/Us", "ers/"]].map(|halves| halves.concat());
    for path in tracked() {
        // What is no text has no such names, or has them inside of a library's format.
        let Ok(text) = std::fs::read_to_string(root().join(&path)) else { continue };
        for place in &places {
            let named = text.match_indices(place.as_str()).any(|(at, _)| {
                // After a name it is a folder of ours; only at the beginning of a path is it the machine's.
                !text[..at].ends_with(|c: char| c.is_alphanumeric() || ['.', '_', '-', '*', '}', '/'].contains(&c))
            });
            assert!(!named, "{} names {place}", path.display());
        }
    }
}
