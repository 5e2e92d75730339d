//! The files of a deployment: the router's configuration with access control, each user's own, certificates and units.
//!
//! What was made before is kept where it is a secret or a certificate, and so are an operator's own settings: to add a user, add it to the roles
//! file and write again.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use repose_proto::{Cell, Service, limits};
use serde_json::{Value, json};

use super::access::{Verb, grants};
use super::certificates::Authority;
use super::roles::{DeploymentRole, Roles, User};
use super::writer::{Failed, Files, WrittenFiles};

/// Frames of one camera that the router passes on in a second.
pub(super) const FRAMES_PER_S: f64 = 30.0;
/// What an attachment may add to a message.
const ATTACHMENT_BYTES: usize = 64 << 10;

/// Writes a deployment to `out`. `installed_at` is where its files will lie on the machines that use them: what the configurations name.
///
/// # Errors
/// The file that could not be read or written.
pub fn write(roles: &Roles, out: &Path, installed_at: &Path) -> Result<WrittenFiles, Failed> {
    let mut files = Files::default();
    let authority = Authority::of(&mut files, &out.join("authority"))?;
    let router = out.join("router");
    let hosts = [roles.host(), "localhost", "127.0.0.1", "::1"];
    authority.sign(&mut files, &router.join("router.pem"), &router.join("router-key.pem"), roles.host(), &hosts)?;
    files.write_unless_there(&router.join("authority.pem"), &authority.certificate)?;
    let passwords = passwords(&mut files, roles, &router.join("users.txt"))?;
    let (settings, session) = (router.join("router.toml"), router.join("router.json5"));
    // Settings come first: until they are written, the Zenoh file beside them says which of their endpoints was ours.
    let listened = endpoint_before(&mut files, &session, "listen")?;
    files.write_settings(&settings, &router_toml(roles, &installed_at.join("router")), listened.as_deref())?;
    files.write(&session, &router_json5(roles, &installed_at.join("router")))?;
    for (name, user) in &roles.users {
        let (folder, installed) = (out.join("users").join(name), installed_at.join("users").join(name));
        if roles.login.has_certificates() {
            authority.sign(&mut files, &folder.join("certificate.pem"), &folder.join("key.pem"), name, &[])?;
        }
        files.write_unless_there(&folder.join("authority.pem"), &authority.certificate)?;
        let (settings, session) = (folder.join("repose.toml"), folder.join("zenoh.json5"));
        let connected = endpoint_before(&mut files, &session, "connect")?;
        files.write_settings(&settings, &user_toml(roles, name, user, &installed), connected.as_deref())?;
        files.write_secret(&session, &user_json5(roles, name, passwords.get(name), &installed))?;
        for (file, unit) in user_units(name, user, &installed) {
            files.write(&out.join("units").join(file), &unit)?;
        }
    }
    let run = format!("router --config {}", argument(&installed_at.join("router/router.toml")));
    files.write(&out.join("units/repose-router.service"), &unit("Repose router", &run))?;
    Ok(files.written())
}

/// The endpoint in a Zenoh file as it was written before; none where there is no file, or nothing like it in the file.
fn endpoint_before(files: &mut Files, file: &Path, field: &str) -> Result<Option<String>, Failed> {
    let text = files.existing(file)?.unwrap_or_default();
    // Ours is JSON under lines of comment.
    let json: String = text.lines().filter(|line| !line.starts_with("//")).collect();
    let document: Option<Value> = serde_json::from_str(&json).ok();
    Ok(document.and_then(|document| document.pointer(&format!("/{field}/endpoints/0"))?.as_str().map(str::to_owned)))
}

/// The router's Zenoh file in the folder of a trial.
pub(super) fn trial_file_of_router(trial: &Path) -> PathBuf {
    trial.join("router.json5")
}

/// A user's Zenoh file in the folder of a trial: in a folder of the users', one of whom may be called `router`.
pub(super) fn trial_file_of_user(trial: &Path, name: &str) -> PathBuf {
    trial.join("users").join(format!("{name}.json5"))
}

/// Writes the Zenoh files of a trial to `to`: as [`write`] does, with everything read from where it lies now.
pub(super) fn write_trial(roles: &Roles, deployment: &Path, to: &Path) -> Result<(), Failed> {
    let mut files = Files::default();
    let router = deployment.join("router");
    files.write_secret(&trial_file_of_router(to), &router_json5(roles, &router))?;
    let missing = |path: &Path| Failed::new(path, "is missing; `repose deploy` writes it");
    let users = router.join("users.txt");
    let passwords = match roles.login.has_passwords() {
        true => files.existing(&users)?.ok_or_else(|| missing(&users))?,
        false => String::new(),
    };
    let passwords: BTreeMap<&str, &str> = passwords.lines().filter_map(|line| line.split_once(':')).collect();
    for name in roles.users.keys() {
        let password = passwords.get(name.as_str()).map(|password| (*password).to_owned());
        let installed = deployment.join("users").join(name);
        files.write_secret(&trial_file_of_user(to, name), &user_json5(roles, name, password.as_ref(), &installed))?;
    }
    Ok(())
}

/// Every user's password; those of users that are there already stay.
fn passwords(files: &mut Files, roles: &Roles, file: &Path) -> Result<BTreeMap<String, String>, Failed> {
    if !roles.login.has_passwords() {
        return Ok(BTreeMap::new());
    }
    let earlier = files.existing(file)?.unwrap_or_default();
    let earlier: BTreeMap<&str, &str> = earlier.lines().filter_map(|line| line.split_once(':')).collect();
    let password =
        |name: &String| earlier.get(name.as_str()).map_or_else(|| uuid::Uuid::new_v4().simple().to_string(), |p| (*p).to_owned());
    let passwords: BTreeMap<String, String> = roles.users.keys().map(|name| (name.clone(), password(name))).collect();
    let lines = passwords.iter().fold(String::new(), |mut lines, (name, password)| {
        // Writing to a string does not fail.
        let _infallible = writeln!(lines, "{name}:{password}");
        lines
    });
    files.write_secret(file, &lines)?;
    Ok(passwords)
}

/// Zenoh's messages of a verb: those that the user sends, and those that the router passes on to it.
fn messages(verb: Verb) -> [(&'static str, &'static [&'static str]); 2] {
    match verb {
        Verb::Put => [("ingress", &["put"]), ("egress", &[])],
        Verb::Subscribe => [("ingress", &["declare_subscriber"]), ("egress", &["put"])],
        Verb::Query => [("ingress", &["query"]), ("egress", &["declare_queryable", "reply"])],
        Verb::Serve => [("ingress", &["declare_queryable", "reply"]), ("egress", &["query"])],
        Verb::Token => [("ingress", &["liveliness_token"]), ("egress", &[])],
        Verb::Watch => [("ingress", &["liveliness_query", "declare_liveliness_subscriber"]), ("egress", &["liveliness_token"])],
    }
}

/// Zenoh's access control: a rule for each user, verb and direction.
pub(super) fn access_control(roles: &Roles) -> Value {
    let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
    for (name, user) in &roles.users {
        let grants = grants(user);
        let mut of_user = Vec::new();
        for verb in Verb::ALL {
            let keys: Vec<&str> = grants.iter().filter(|g| g.verb == verb).map(|g| g.keys.as_str()).collect();
            for (flow, messages) in messages(verb).into_iter().filter(|(_, messages)| !messages.is_empty() && !keys.is_empty()) {
                let id = format!("{name} {} {flow}", json!(verb).as_str().unwrap_or_default());
                rules.push(json!({"id": id, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}));
                of_user.push(id);
            }
        }
        let mut subject = json!({"id": name});
        if roles.login.has_passwords() {
            subject["usernames"] = json!([name]);
        }
        if roles.login.has_certificates() {
            subject["cert_common_names"] = json!([name]);
        }
        subjects.push(subject);
        policies.push(json!({"subjects": [name], "rules": of_user}));
    }
    json!({"enabled": true, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies})
}

fn document(about: &str, value: &Value) -> String {
    format!("// {about}\n// Written by `repose deploy`; change the roles file and write again.\n{value:#}\n")
}

fn router_json5(roles: &Roles, installed: &Path) -> String {
    let at = |name: &str| installed.join(name).display().to_string();
    let tls = json!({
        "listen_private_key": at("router-key.pem"), "listen_certificate": at("router.pem"),
        "root_ca_certificate": at("authority.pem"), "enable_mtls": roles.login.has_certificates(),
    });
    let mut transport = json!({"link": {"tls": tls}});
    if roles.login.has_passwords() {
        transport["auth"] = json!({"usrpwd": {"dictionary_file": at("users.txt")}});
    }
    let value = json!({
        "listen": {"endpoints": [roles.listening()]},
        "transport": transport,
        "access_control": access_control(roles),
        "downsampling": [{"id": "frames of one camera", "messages": ["put"], "flows": ["ingress"], "rules": frame_limits(roles)}],
        "low_pass_filter": [{
            "id": "larger than a message may be", "messages": ["put", "query", "reply"], "flows": ["ingress"],
            "key_exprs": limited_keys(), "size_limit": limits::MAX_MESSAGE_BYTES + ATTACHMENT_BYTES,
        }],
    });
    document("The router: its certificate, its users, and what each may do. Everything that no rule allows is denied.", &value)
}

/// The keys at which messages are limited in size: all of them. `**` stands for no chunk that begins with `@`.
fn limited_keys() -> Vec<String> {
    let every = Cell::every();
    let cancels = Service::ALL.map(|service| every.cancels(service, "*"));
    ["**".to_owned(), every.robot_estop("*")].into_iter().chain(cancels).collect()
}

/// Zenoh's limits of frames. A rule counts what a session puts to all of its keys together, so each camera has a rule of its own: of two that one
/// session shows at the same time, the second would never be passed on. Of two rules for one key either may count: where cameras have names, there is
/// no rule for all of them.
fn frame_limits(roles: &Roles) -> Value {
    let users = || roles.users.values();
    let cameras: BTreeSet<&String> = users().flat_map(|user| &user.cameras).collect();
    let keys: BTreeSet<String> = match cameras.is_empty() {
        true => BTreeSet::from([Cell::every().camera_frames()]),
        false => {
            let puts_any = |user: &&User| user.service == Some(Service::Simulator) && user.robot.is_none() && user.cameras.is_empty();
            let simulated = users().filter(puts_any).flat_map(|user| &user.cells).filter_map(|cell| Cell::new(cell).ok());
            let simulated = simulated.map(|cell| cell.camera_frames());
            cameras.into_iter().map(|camera| Cell::every().camera_frame(camera)).chain(simulated).collect()
        }
    };
    keys.into_iter().map(|key| json!({"key_expr": key, "freq": FRAMES_PER_S})).collect()
}

fn router_toml(roles: &Roles, installed: &Path) -> String {
    let (listen, file) = (roles.listening(), installed.join("router.json5"));
    format!("# repose serve router --config router.toml\n[session]\nmode = \"router\"\nlisten = [\"{listen}\"]\nzenoh_file = {file:?}\n")
}

fn user_json5(roles: &Roles, name: &str, password: Option<&String>, installed: &Path) -> String {
    let at = |name: &str| installed.join(name).display().to_string();
    let mut tls = json!({"root_ca_certificate": at("authority.pem")});
    if roles.login.has_certificates() {
        tls["enable_mtls"] = json!(true);
        tls["connect_certificate"] = json!(at("certificate.pem"));
        tls["connect_private_key"] = json!(at("key.pem"));
    }
    let mut transport = json!({"link": {"tls": tls}});
    if let Some(password) = password {
        transport["auth"] = json!({"usrpwd": {"user": name, "password": password}});
    }
    let value = json!({"mode": "client", "connect": {"endpoints": [roles.endpoint()]}, "transport": transport});
    document(&format!("What {name} needs to be let in, in any language: a Zenoh session opened with this file. Keep it secret."), &value)
}

fn user_toml(roles: &Roles, name: &str, user: &User, installed: &Path) -> String {
    let (cell, endpoint, file) = (&user.cells[0], roles.endpoint(), installed.join("zenoh.json5"));
    let session = format!("[session]\nmode = \"client\"\ncell = \"{cell}\"\nconnect = [\"{endpoint}\"]\nzenoh_file = {file:?}\n");
    let pool = user.pools.of_cell.get(cell).map_or_else(String::new, |pool| format!("\n[caller]\npool = \"{pool}\"\n"));
    let (use_it, worker) = match (user.role, user.service) {
        (DeploymentRole::Service, Some(service)) => {
            let worker = user.worker.as_ref().map_or_else(String::new, |worker| format!("name = \"{worker}\"\n"));
            (format!("repose serve {service} --config repose.toml"), format!("\n[worker]\noperate_only = true\n{worker}"))
        }
        _ => ("the commands of repose take --config repose.toml".to_owned(), String::new()),
    };
    format!("# {name}: {use_it}\n{session}{pool}{worker}")
}

/// The units of a service's user, with their files' names: one for each of its cells. The first is the one that its configuration names.
fn user_units(name: &str, user: &User, installed: &Path) -> Vec<(String, String)> {
    let Some(service) = user.service else { return Vec::new() };
    let config = argument(&installed.join("repose.toml"));
    let of_cell = |(place, cell): (usize, &String)| {
        if place == 0 {
            let unit = unit(&format!("Repose {service} as {name}"), &format!("{service} --config {config}"));
            return (format!("repose-{name}.service"), unit);
        }
        // A cell without a pool is its own: the configuration may name the first cell's.
        let pool = user.pools.of_cell.get(cell).unwrap_or(cell);
        let run = format!("{service} --cell {cell} --pool {pool} --config {config}");
        let unit = unit(&format!("Repose {service} as {name} in {cell}"), &run);
        // No name has a dot, so that this is no other user's.
        (format!("repose-{name}.{cell}.service"), unit)
    };
    let is_first = |(place, cell): &(usize, &String)| !user.cells[..*place].contains(cell);
    user.cells.iter().enumerate().filter(is_first).map(of_cell).collect()
}

/// A path as one argument of a unit's command: systemd parts words at spaces, and reads quotes, backslashes, `$` and `%` in them.
fn argument(path: &Path) -> String {
    let path = path.display().to_string();
    if path.bytes().all(|b| b.is_ascii_alphanumeric() || b"/._-+@:,".contains(&b)) {
        return path;
    }
    let escaped = path.replace('\\', r"\\").replace('"', "\\\"").replace('%', "%%").replace('$', "$$");
    format!("\"{escaped}\"")
}

fn unit(description: &str, run: &str) -> String {
    // Where both are stopped, workers that drain still have their router.
    let after = if run.starts_with("router ") { "" } else { " repose-router.service" };
    format!(
        "[Unit]\nDescription={description}\nAfter=network-online.target{after}\nWants=network-online.target\n\
         # It is tried for ever: after a reboot names and addresses may come later than this.\nStartLimitIntervalSec=0\n\n[Service]\n\
         ExecStart=/usr/bin/repose serve {run}\nUser=repose\n# Longer than draining takes.\nTimeoutStopSec=20\nKillSignal=SIGTERM\n\
         Restart=always\nRestartSec=1\nNoNewPrivileges=yes\nProtectSystem=strict\nProtectHome=yes\nPrivateTmp=yes\n\n\
         [Install]\nWantedBy=multi-user.target\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The keys whose frames are limited together.
    fn limited(users: &str) -> Vec<String> {
        let roles = Roles::parse(&format!("router = \"r:1\"\ncells = [\"lab\"]\n{users}")).expect("roles");
        let limits = frame_limits(&roles);
        let key = |limit: &Value| limit["key_expr"].as_str().expect("a key").to_owned();
        limits.as_array().expect("a list").iter().map(key).collect()
    }

    #[test]
    fn a_path_is_one_argument_of_a_units_command() {
        let of = |path: &str| argument(Path::new(path));
        assert_eq!(of("/etc/repose/router/router.toml"), "/etc/repose/router/router.toml");
        assert_eq!(of("/srv/cell \"A\"/100 %/$x.toml"), "\"/srv/cell \\\"A\\\"/100 %%/$$x.toml\"");
        assert_eq!(of(r"/srv/back\slash"), r#""/srv/back\\slash""#);
    }

    #[test]
    fn whatever_a_user_may_send_is_limited_in_size() {
        let example = include_str!("../../../../../deploy/roles.toml");
        let (roles, limited) = (Roles::parse(example).expect("roles"), limited_keys());
        let sent = roles.users.values().flat_map(grants).filter(|grant| [Verb::Put, Verb::Query, Verb::Serve].contains(&grant.verb));
        let verbatim: BTreeSet<String> = sent.map(|grant| grant.keys.replace("/cell/", "/*/")).filter(|keys| keys.contains("/@")).collect();
        assert!(verbatim.len() > Service::ALL.len() && verbatim.iter().all(|keys| limited.contains(keys)), "{verbatim:?}");
        assert!(limited.contains(&"**".to_owned()), "and all others");
    }

    #[test]
    fn each_camera_that_has_a_name_has_a_limit_of_its_own() {
        let pair = "[users.pair]\nrole = \"driver\"\ncameras = [\"left\", \"right\"]\n";
        let simulator = "[users.sim]\nrole = \"service\"\nservice = \"simulator\"\ncells = [\"hall\"]\n";
        let each = ["repose/v1/*/camera/left/frame", "repose/v1/*/camera/right/frame"];
        assert_eq!(limited(pair), each);
        assert_eq!(limited(simulator), ["repose/v1/*/camera/*/frame"]);
        assert_eq!(limited(&format!("{pair}{simulator}")), [&each[..], &["repose/v1/hall/camera/*/frame"]].concat());
    }
}
