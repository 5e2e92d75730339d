//! The Debian package, made of what `services/cli/Cargo.toml` says of it (as `cargo deb` does): installed, upgraded, removed and purged in a root
//! of its own, with its units read by systemd there. Where there is no `dpkg-deb`, there is nothing to install.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use toml::{Table, Value};

/// Units that systemd wants below every unit.
const TARGETS: [&str; 5] = ["sysinit", "basic", "shutdown", "network-online", "multi-user"];

fn crate_folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// What `cargo deb` reads.
fn metadata() -> Table {
    let manifest: Table = fs::read_to_string(crate_folder().join("Cargo.toml")).expect("the manifest").parse().expect("TOML");
    let of = |table: &Table, key: &str| table.get(key).and_then(Value::as_table).cloned().unwrap_or_else(|| panic!("no [{key}]"));
    of(&of(&of(&manifest, "package"), "metadata"), "deb")
}

fn texts(of: &Table, key: &str) -> Vec<String> {
    let list = of.get(key).and_then(Value::as_array).unwrap_or_else(|| panic!("no {key}"));
    list.iter().filter_map(Value::as_str).map(str::to_owned).collect()
}

fn write(path: &Path, text: &str, mode: u32) {
    fs::create_dir_all(path.parent().expect("a folder")).expect("made");
    fs::write(path, text).expect("written");
    fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("its mode");
}

fn ran(command: &mut Command) -> Output {
    let output = command.output().unwrap_or_else(|e| panic!("{command:?}: {e}"));
    assert!(output.status.success(), "{command:?}: {}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    output
}

/// Builds the package of a version.
fn package(folder: &Path, version: &str) -> PathBuf {
    let (metadata, tree) = (metadata(), folder.join(format!("tree-{version}")));
    for asset in metadata["assets"].as_array().expect("assets") {
        let [source, to, mode] = [0, 1, 2].map(|k| asset[k].as_str().expect("source, destination and mode"));
        let source = match source {
            "target/release/repose" => PathBuf::from(env!("CARGO_BIN_EXE_repose")),
            other => crate_folder().join(other),
        };
        let to = match to.ends_with('/') {
            true => tree.join(to).join(source.file_name().expect("a file")),
            false => tree.join(to),
        };
        fs::create_dir_all(to.parent().expect("a folder")).expect("made");
        fs::copy(&source, &to).unwrap_or_else(|e| panic!("{}: {e}", source.display()));
        fs::set_permissions(&to, fs::Permissions::from_mode(u32::from_str_radix(mode, 8).expect("a mode"))).expect("its mode");
    }
    let name = metadata["name"].as_str().expect("a name");
    let control = format!("Package: {name}\nVersion: {version}\nArchitecture: all\nMaintainer: nobody\nDescription: a test\n");
    write(&tree.join("DEBIAN/control"), &control, 0o644);
    write(&tree.join("DEBIAN/conffiles"), &(texts(&metadata, "conf-files").join("\n") + "\n"), 0o644);
    let scripts = crate_folder().join(metadata["maintainer-scripts"].as_str().expect("scripts"));
    for script in fs::read_dir(scripts).expect("scripts").map(|entry| entry.expect("a script").path()) {
        let text = fs::read_to_string(&script).expect("a script");
        write(&tree.join("DEBIAN").join(script.file_name().expect("its name")), &text, 0o755);
    }
    let package = folder.join(format!("repose-{version}.deb"));
    ran(Command::new("dpkg-deb").args(["-Znone", "--root-owner-group", "--build"]).args([&tree, &package]));
    package
}

/// A root with a package database and nothing installed.
fn root(folder: &Path) -> PathBuf {
    let root = folder.join("root");
    for file in ["status", "available"] {
        write(&root.join("var/lib/dpkg").join(file), "", 0o644);
    }
    for folder in ["info", "updates", "triggers"] {
        fs::create_dir_all(root.join("var/lib/dpkg").join(folder)).expect("made");
    }
    for target in TARGETS {
        write(&root.join("usr/lib/systemd/system").join(format!("{target}.target")), "[Unit]\nDescription=a target\n", 0o644);
    }
    write(&root.join("bin/sh"), "#!/bin/sh\n", 0o755);
    root
}

fn dpkg(root: &Path, arguments: &[&str]) {
    let mut command = Command::new("dpkg");
    // An edited configuration stays, as when an operator is asked and says so.
    command.args(["--force-not-root", "--force-script-chrootless", "--force-confold"]).arg(format!("--root={}", root.display()));
    ran(command.args(arguments));
}

#[test]
fn the_package_is_installed_upgraded_and_removed_and_its_units_are_good() {
    if Command::new("dpkg-deb").arg("--version").output().is_err() {
        eprintln!("there is no dpkg-deb here: no package was tried");
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let (root, first, second) = (root(folder.path()), package(folder.path(), "1.0"), package(folder.path(), "2.0"));
    dpkg(&root, &["--install", first.to_str().expect("a plain path")]);
    ran(Command::new(root.join("usr/bin/repose")).args(["serve", "router", "--help"]));
    let config = root.join("etc/repose/repose.toml");
    let installed = fs::read_to_string(&config).expect("the configuration");
    if Command::new("systemd-sysusers").arg("--version").output().is_ok() {
        let users = fs::read_to_string(root.join("etc/passwd")).expect("users");
        assert!(users.lines().any(|line| line.starts_with("repose:")), "the units' user is made: {users}");
    }
    if Command::new("systemd-analyze").arg("--version").output().is_ok() {
        let instances = ["perception", "inference-2", "planner", "motion"].map(|service| format!("repose@{service}.service"));
        let root = format!("--root={}", root.display());
        let verified = ran(Command::new("systemd-analyze")
            .args(["verify", "--man=no", &root, "repose-router.service", "repose-franka.service"])
            .args(instances));
        assert!(verified.stderr.is_empty(), "{}", String::from_utf8_lossy(&verified.stderr));
    }
    let edited = installed.clone() + "\n# an operator's own\n";
    fs::write(&config, &edited).expect("edited");
    dpkg(&root, &["--install", second.to_str().expect("a plain path")]);
    assert_eq!(fs::read_to_string(&config).expect("it is there"), edited, "an upgrade keeps what the operator wrote");
    dpkg(&root, &["--remove", "repose"]);
    assert!(!root.join("usr/bin/repose").exists() && config.exists(), "removed, with its configuration kept");
    dpkg(&root, &["--purge", "repose"]);
    assert!(!config.exists(), "purged");
}

/// Stands in for systemd: says what runs, and writes down what else it is asked.
const SYSTEMCTL: &str = r#"#!/bin/sh
case "$1 $3" in
    list-units*)
        for unit in repose-router repose@planner repose-motion repose-franka repose-wall; do echo "$unit.service loaded active running Repose"; done ;;
    "show repose@planner.service") echo 'ExecStart={ path=/bin/sh ; argv[]=/bin/sh -c exec /usr/bin/repose serve "${INSTANCE%%-*}" ; pid=7 }' ;;
    "show repose-franka.service") echo 'ExecStart={ path=/usr/bin/repose ; argv[]=/usr/bin/repose driver franka --config franka.toml ; pid=8 }' ;;
    "show repose-wall.service") echo 'ExecStart={ path=/usr/bin/python3 ; argv[]=/usr/bin/python3 wall.py ; pid=9 }' ;;
    show*) echo 'ExecStart={ path=/usr/bin/repose ; argv[]=/usr/bin/repose serve motion --config motion.toml ; pid=10 }' ;;
    *) echo "$*" >>"$ASKED" ;;
esac
"#;

/// What a script of the package asks systemd for, and says.
fn asked_by(folder: &Path, script: &str, arguments: &[&str]) -> (String, String) {
    write(&folder.join("systemctl"), SYSTEMCTL, 0o755);
    write(&folder.join("systemd-sysusers"), "#!/bin/sh\n", 0o755);
    write(&folder.join("asked"), "", 0o644);
    let source = crate_folder().join(metadata()["maintainer-scripts"].as_str().expect("scripts")).join(script);
    let text = fs::read_to_string(source).expect("a script").replace("/run/systemd/system", folder.to_str().expect("a plain path"));
    write(&folder.join(script), &text, 0o755);
    let path = format!("{}:{}", folder.display(), std::env::var("PATH").expect("a path"));
    let mut run = Command::new("sh");
    run.arg(folder.join(script)).args(arguments).env("PATH", path).env("ASKED", folder.join("asked")).env_remove("DPKG_ROOT");
    let said = String::from_utf8_lossy(&ran(&mut run).stdout).into_owned();
    (fs::read_to_string(folder.join("asked")).expect("what was asked"), said)
}

#[test]
fn an_upgrade_restarts_what_serves_whoever_wrote_its_unit_and_leaves_a_robots_driver() {
    let folder = tempfile::tempdir().expect("a folder");
    let (asked, said) = asked_by(folder.path(), "postinst", &["configure", "1.0"]);
    assert_eq!(asked, "daemon-reload\ntry-restart repose-router.service repose@planner.service repose-motion.service\n");
    assert!(said.contains("systemctl restart repose-franka.service") && said.lines().count() == 1, "{said}");
    let (asked, said) = asked_by(folder.path(), "postinst", &["configure", ""]);
    assert_eq!((asked.as_str(), said.as_str()), ("daemon-reload\n", ""), "what is installed for the first time starts nothing");
    let (asked, _) = asked_by(folder.path(), "prerm", &["remove"]);
    assert_eq!(asked, "stop repose-router.service repose@planner.service repose-motion.service repose-franka.service\n");
    assert_eq!(asked_by(folder.path(), "prerm", &["upgrade", "2.0"]).0, "");
}
