//! Configuration: one TOML file with a section for each part, and environment variables over it.
//!
//! `REPOSE_PLANNER__QUEUE_CAPACITY=8` overrides `queue_capacity` of `[planner]`; in both places a field that does not exist is an error.
//! A section that the file lacks has its defaults. `deploy/repose.toml` shows every field.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use repose_proto::{keys, limits};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize};

use crate::RuntimeError;
use crate::endpoint::{endpoint_fault, is_host_and_port};
use crate::shares::{CellShare, Shares};

/// The sections that a configuration file may have. Any other is an error, so that a misspelled one is not silently ignored.
pub const SECTIONS: [&str; 12] =
    ["session", "caller", "worker", "telemetry", "perception", "inference", "planner", "motion", "simulator", "console", "ros2", "franka"];

/// How a process takes part in the network.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SessionMode {
    /// Alone: everything that talks is in this process, nothing listens.
    #[default]
    Embedded,
    /// Behind a router: the mode of services.
    Client,
    /// The router.
    Router,
    /// Linked directly to other peers; for tests and the smallest deployments.
    Peer,
}

/// The network session, section `[session]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SessionConfig {
    /// The robot cell, a chunk of every key. Processes with different cells do not see each other.
    pub cell: String,
    /// The name that this process goes by in other processes' logs and traces; none where absent. Workers of release 1 refuse calls that
    /// carry one.
    pub name: Option<String>,
    /// How this process takes part.
    pub mode: SessionMode,
    /// Where to connect to, `tcp/127.0.0.1:7447`. Of several a client uses the first that answers; peers and routers use all.
    #[serde(deserialize_with = "list_or_commas")]
    pub connect: Vec<String>,
    /// Where to listen, `tcp/0.0.0.0:7447`; port 0 picks one.
    #[serde(deserialize_with = "list_or_commas")]
    pub listen: Vec<String>,
    /// How long a silent link is believed in, milliseconds. Higher: dead machines are noticed later; lower: a starved one is taken for dead.
    pub lease_ms: u64,
    /// The largest message that a link takes, bytes; larger ones are lost in silence. Higher: more memory that a sender can claim.
    /// Must stay above the 32 MiB that a message may have.
    pub max_receive_bytes: usize,
    /// Sessions that a router takes at once; the next is refused. A process has one, one with a camera two. Higher: more cells at one router.
    pub max_sessions: usize,
    /// How long opening tries to connect, milliseconds. Higher: services may start longer before their router.
    pub connect_timeout_ms: u64,
    /// When queries without a deadline are given up, milliseconds. Calls always carry their own.
    pub query_timeout_ms: u64,
    /// How long closing may take, milliseconds. Higher: more of what is still being sent arrives.
    pub close_timeout_ms: u64,
    /// A Zenoh configuration file (JSON5) below these fields: TLS, user and password, access control. Its endpoints hold where
    /// `connect` and `listen` are empty.
    pub zenoh_file: Option<PathBuf>,
}

impl Default for SessionConfig {
    fn default() -> Self {
        Self {
            cell: "cell".to_owned(),
            name: None,
            mode: SessionMode::Embedded,
            connect: Vec::new(),
            listen: Vec::new(),
            lease_ms: 2500,
            max_receive_bytes: 80 * 1024 * 1024,
            max_sessions: 1000,
            connect_timeout_ms: 10_000,
            query_timeout_ms: 10_000,
            close_timeout_ms: 2000,
            zenoh_file: None,
        }
    }
}

/// How calls are made, section `[caller]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CallerConfig {
    /// The pool that serves this cell, too: the cell whose planners and inference workers are called in place of its own. None where absent.
    pub pool: Option<String>,
    /// Whether scenes are fetched in packed form: a fifth of the bytes, at some 50 ms of computing at either end. On where the link is slower than
    /// 300 Mbit/s.
    pub packed_scenes: bool,
    /// How often an idempotent call is tried again after its first attempt. Higher: survives more failures, loads a struggling system more.
    pub retries: u32,
    /// How long a worker's load may be silent before calls leave it, milliseconds. Higher: stopped workers hold calls longer; lower:
    /// starved ones lose them.
    pub suspect_after_ms: u64,
    /// The share of the time left that an attempt may take before the next one starts, 0.05 to 1. Higher: fewer computations are thrown
    /// away, less time is left to the next attempt.
    pub attempt_share: f64,
    /// How long a call waits for a first worker to appear, milliseconds, within its deadline.
    pub worker_wait_ms: u64,
    /// How long workers may take to come back after their router did, milliseconds, within the deadline of a call that waits for one.
    pub return_wait_ms: u64,
    /// The first wait before the same workers are asked again, milliseconds; it doubles, and is drawn at random between half and all of it.
    pub backoff_ms: u64,
    /// How long a worker's refusal of a batch call stands for others like it, milliseconds: as long as the worker asked to be left alone, and
    /// at most this; 0 asks every time. Higher: a crowd costs an overloaded worker less, and is slower to see that there is room again.
    pub heed_refusals_ms: u64,
    /// How long a cancelled call that must not be repeated waits for its worker's last word, milliseconds.
    pub cancel_grace_ms: u64,
    /// Seed of the random choices; without one every process chooses differently.
    pub seed: Option<u64>,
}

impl Default for CallerConfig {
    fn default() -> Self {
        Self {
            pool: None,
            packed_scenes: false,
            retries: 2,
            suspect_after_ms: 1000,
            attempt_share: 0.5,
            worker_wait_ms: 1000,
            return_wait_ms: 5000,
            backoff_ms: 20,
            heed_refusals_ms: 500,
            cancel_grace_ms: 1000,
            seed: None,
        }
    }
}

/// How calls are served, section `[worker]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorkerConfig {
    /// The worker's name, unique in its service; without one it is made up.
    pub name: Option<String>,
    /// How long a worker with a name waits for that of a predecessor that has died to become free, milliseconds: a lease, and some more. For one that
    /// drains it waits as long as that takes.
    pub name_wait_ms: u64,
    /// Calls that may be open at once, waiting and computing; the next is refused at once. More than the service's queue and threads take together,
    /// or that queue is never full, where an interactive call takes a batch call's place. Higher: more memory.
    pub max_open_calls: usize,
    /// Whether methods that move a robot or change the world are taken on the `operate` key only, and not on `call` as clients of release 1
    /// send them. A worker that is let in as a user does so whatever this says: access control tells users apart by keys.
    pub operate_only: bool,
    /// How often the load is published, milliseconds, 100 to 200 in operation. Lower: better choices by callers, more traffic.
    pub load_period_ms: u64,
    /// How long a cancelled or overdue call may take to notice, milliseconds, before its future is dropped.
    pub cancel_grace_ms: u64,
    /// How long calls are still taken after the liveliness token was dropped, milliseconds: what it takes callers to see it.
    pub drain_notice_ms: u64,
    /// How long open calls may then take to finish, and at the console, a bridge to ROS 2 and `repose mcp` the moves that they
    /// have begun, milliseconds. Higher: slower restarts, fewer calls cut off.
    pub drain_ms: u64,
    /// How many outcomes of at-most-once calls are remembered.
    pub outcomes_kept: usize,
    /// What each cell that this worker serves as a pool's may have of it.
    pub share: CellShare,
    /// What single cells may have in place of that, by name.
    pub shares: BTreeMap<String, CellShare>,
}

impl Default for WorkerConfig {
    fn default() -> Self {
        Self {
            name: None,
            name_wait_ms: 6000,
            max_open_calls: 128,
            operate_only: false,
            load_period_ms: 150,
            cancel_grace_ms: 1000,
            drain_notice_ms: 100,
            drain_ms: 10_000,
            outcomes_kept: 256,
            share: CellShare::default(),
            shares: BTreeMap::new(),
        }
    }
}

impl WorkerConfig {
    /// What the cells that this worker serves may have of it.
    pub fn cell_shares(&self) -> Shares {
        Shares::new(self.share.clone(), self.shares.clone())
    }
}

/// What a process tells of itself, section `[telemetry]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TelemetryConfig {
    /// Where `/live`, `/ready` and `/metrics` are served, `127.0.0.1:9464`; port 0 picks one, which the log says. Nowhere where absent.
    pub listen: Option<String>,
}

/// Everything that the runtime reads.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RuntimeConfig {
    /// The network session.
    pub session: SessionConfig,
    /// How calls are made.
    pub caller: CallerConfig,
    /// How calls are served.
    pub worker: WorkerConfig,
    /// Health and metrics.
    pub telemetry: TelemetryConfig,
}

impl RuntimeConfig {
    /// Reads the runtime's sections of a file, where one is given, and the environment over them.
    ///
    /// # Errors
    /// [`RuntimeError::Config`] that names the section and the field.
    pub fn load(file: Option<&Path>) -> Result<Self, RuntimeError> {
        let config = Self::read(file)?;
        config.validate()?;
        Ok(config)
    }

    /// The same for a caller that still has fields to set, unchecked: [`crate::Session::open`] checks it.
    ///
    /// # Errors
    /// [`RuntimeError::Config`] that names the section and the field.
    pub fn read(file: Option<&Path>) -> Result<Self, RuntimeError> {
        Ok(Self {
            session: load_config("session", file)?,
            caller: load_config("caller", file)?,
            worker: load_config("worker", file)?,
            telemetry: load_config("telemetry", file)?,
        })
    }

    /// Checks what the types cannot.
    ///
    /// # Errors
    /// [`RuntimeError::Config`] that names the section and the field.
    pub fn validate(&self) -> Result<(), RuntimeError> {
        let check = |good: bool, section: &str, message: &str| match good {
            true => Ok(()),
            false => Err(RuntimeError::Config { section: section.to_owned(), file: None, message: message.to_owned() }),
        };
        let (session, caller, worker) = (&self.session, &self.caller, &self.worker);
        let chunk = |field, name: &str| keys::validate_chunk(field, name).is_ok();
        check(chunk("cell", &session.cell), "session", "cell: must be of the form [a-z0-9][a-z0-9_-]{0,63}")?;
        check(session.lease_ms >= 500, "session", "lease_ms: at least 500, or a busy process is taken for dead")?;
        let receives = session.max_receive_bytes > limits::MAX_MESSAGE_BYTES;
        check(receives, "session", "max_receive_bytes: must exceed 33554432, what a message may have")?;
        check(session.max_sessions > 0, "session", "max_sessions: at least 1")?;
        let sections = [("connect", &session.connect), ("listen", &session.listen)];
        let tls = sections.into_iter().find(|(_, endpoints)| endpoints.iter().any(|endpoint| endpoint.starts_with("tls/")));
        let why =
            "tls/ is not built in: Zenoh 1.10's TLS link can end the process (eclipse-zenoh/zenoh#2557); quic/ takes the same certificates";
        check(tls.is_none(), "session", &format!("{}: {why}", tls.map_or("", |(field, _)| field)))?;
        let faulty = |endpoints: &[String]| endpoints.iter().find_map(|endpoint| endpoint_fault(endpoint));
        let fault = sections.into_iter().find_map(|(field, endpoints)| Some(format!("{field}: {}", faulty(endpoints)?)));
        check(fault.is_none(), "session", &fault.unwrap_or_default())?;
        let unreachable = session.mode == SessionMode::Client && session.connect.is_empty() && session.zenoh_file.is_none();
        check(!unreachable, "session", "connect: a client needs at least one endpoint, such as tcp/127.0.0.1:7447")?;
        let embedded = session.mode == SessionMode::Embedded && !(session.connect.is_empty() && session.listen.is_empty());
        check(!embedded, "session", "mode: an embedded session neither connects nor listens; use client, router or peer")?;
        let telemetry = self.telemetry.listen.as_deref().filter(|address| !is_host_and_port(address));
        let message = format!("telemetry.listen: expected HOST:PORT, such as 127.0.0.1:9464, got {:?}", telemetry.unwrap_or_default());
        check(telemetry.is_none(), "telemetry", &message)?;
        check((0.05..=1.0).contains(&caller.attempt_share), "caller", "attempt_share: expected 0.05 to 1")?;
        check(caller.retries <= 10, "caller", "retries: at most 10")?;
        check(worker.name.as_ref().is_none_or(|n| chunk("name", n)), "worker", "name: must be of the form [a-z0-9][a-z0-9_-]{0,63}")?;
        check(worker.max_open_calls > 0, "worker", "max_open_calls: at least 1")?;
        check(
            worker.outcomes_kept > 0,
            "worker",
            "outcomes_kept: at least 1, or an `execute` that is asked for again is carried out again",
        )?;
        check((20..=500).contains(&worker.load_period_ms), "worker", "load_period_ms: expected 20 to 500")?;
        check(caller.pool.as_ref().is_none_or(|n| chunk("pool", n)), "caller", "pool: must be of the form [a-z0-9][a-z0-9_-]{0,63}")?;
        let shares = worker.shares.iter().map(|(cell, share)| (format!("shares.{cell}"), share));
        for (field, share) in shares.chain([("share".to_owned(), &worker.share)]) {
            let fault = share.fault();
            check(fault.is_none(), "worker", &format!("{field}.{}", fault.unwrap_or_default()))?;
        }
        Ok(())
    }
}

/// Refuses counts of a section, by field, of which at least one is needed: a queue without places would refuse every call.
///
/// # Errors
/// [`RuntimeError::Config`] that names the section and the field.
pub fn check_counts(section: &str, counts: &[(&str, usize)]) -> Result<(), RuntimeError> {
    counts.iter().find(|(_, count)| *count == 0).map_or(Ok(()), |(field, _)| {
        let message = format!("{field}: expected at least 1, got 0");
        Err(RuntimeError::Config { section: section.to_owned(), file: None, message })
    })
}

/// Reads one section: the file's, where there is one, and `REPOSE_{SECTION}__{FIELD}` over it. Unknown fields are the type's to refuse
/// (`#[serde(deny_unknown_fields, default)]`).
///
/// # Errors
/// [`RuntimeError::Config`] that names the section and the field.
pub fn load_config<T: DeserializeOwned>(section: &str, file: Option<&Path>) -> Result<T, RuntimeError> {
    let fail = |e: &dyn std::fmt::Display| RuntimeError::Config {
        section: section.to_owned(),
        file: file.map(Path::to_path_buf),
        message: e.to_string(),
    };
    let mut builder = config::Config::builder();
    if let Some(path) = file {
        let source = config::File::from(path).format(config::FileFormat::Toml);
        let whole = config::Config::builder().add_source(source).build().map_err(|e| fail(&e))?;
        let sections = whole.try_deserialize::<config::Map<String, config::Value>>().map_err(|e| fail(&e))?;
        if let Some(unknown) = sections.keys().filter(|k| !SECTIONS.contains(&k.as_str())).min() {
            return Err(fail(&format!("unknown section [{unknown}], expected one of {}", SECTIONS.join(", "))));
        }
        if let Some(fields) = sections.get(section) {
            for (field, value) in fields.clone().into_table().map_err(|e| fail(&e))? {
                builder = builder.set_default(field, value).map_err(|e| fail(&e))?;
            }
        }
    }
    let merged = builder.add_source(environment(section)).build().map_err(|e| fail(&e))?;
    merged.try_deserialize().map_err(|e| fail(&e))
}

/// A section's variables, each as the text that it is: its field's type says how to read it. A guess from the text alone would make the cell `01`
/// the cell `1`, the worker `1e5` the worker `100000`, and of a count `nan` 0.
fn environment(section: &str) -> config::Environment {
    config::Environment::with_prefix(&format!("REPOSE_{}", section.to_uppercase())).prefix_separator("__").separator("__")
}

/// A list, or one string with commas, as an environment variable has it; for `#[serde(deserialize_with = "…")]`.
///
/// # Errors
/// When the value is neither.
pub fn list_or_commas<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Either {
        List(Vec<String>),
        Commas(String),
    }
    Ok(match Either::deserialize(deserializer)? {
        Either::List(list) => list,
        Either::Commas(text) => text.split(',').map(str::trim).filter(|s| !s.is_empty()).map(str::to_owned).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<RuntimeConfig, RuntimeError> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("repose.toml");
        std::fs::write(&file, text).unwrap();
        RuntimeConfig::load(Some(&file))
    }

    #[test]
    fn absent_sections_and_fields_have_their_defaults() {
        let text = "[session]\ncell = \"lab\"\nmode = \"client\"\nconnect = [\"tcp/127.0.0.1:7447\"]\n[planner]\nanything = 1\n";
        let config = load(text).unwrap();
        assert_eq!(config.session.connect, ["tcp/127.0.0.1:7447"]);
        assert_eq!((config.session.cell.as_str(), config.session.lease_ms), ("lab", 2500));
        assert_eq!(config.worker, WorkerConfig::default());
    }

    #[test]
    fn an_unknown_field_or_section_is_refused_by_name() {
        assert!(load("[session]\nlaese_ms = 3\n").unwrap_err().to_string().contains("laese_ms"));
        assert!(load("[sesion]\nlease_ms = 3\n").unwrap_err().to_string().contains("sesion"));
    }

    /// A section as these variables have it, `FIELD` and its text.
    fn from_environment<T: DeserializeOwned>(section: &str, variables: &[(&str, &str)]) -> Result<T, config::ConfigError> {
        let named = |(field, text): &(&str, &str)| (format!("REPOSE_{}__{field}", section.to_uppercase()), (*text).to_owned());
        let source = environment(section).source(Some(variables.iter().map(named).collect()));
        config::Config::builder().add_source(source).build()?.try_deserialize()
    }

    #[test]
    fn names_of_the_environment_that_look_like_numbers_stay_as_they_are_spelt() {
        for name in ["01", "007", "1e5", "0x10", "inf", "true", "20261127165900123456789"] {
            let session: SessionConfig = from_environment("session", &[("CELL", name), ("CONNECT", name)]).unwrap();
            assert_eq!((session.cell.as_str(), session.connect), (name, vec![name.to_owned()]));
            let worker: WorkerConfig = from_environment("worker", &[("NAME", name)]).unwrap();
            assert_eq!(worker.name.as_deref(), Some(name));
        }
    }

    #[test]
    fn variables_are_read_as_what_their_fields_are() {
        let session: SessionConfig =
            from_environment("session", &[("MODE", "client"), ("LEASE_MS", "3000"), ("CONNECT", "tcp/a:1, tcp/b:2")]).unwrap();
        assert_eq!((session.mode, session.lease_ms, session.connect.len()), (SessionMode::Client, 3000, 2));
        let caller: CallerConfig =
            from_environment("caller", &[("ATTEMPT_SHARE", "0.25"), ("PACKED_SCENES", "true"), ("SEED", "7"), ("RETRIES", "1")]).unwrap();
        assert_eq!((caller.attempt_share, caller.packed_scenes, caller.seed, caller.retries), (0.25, true, Some(7), 1));
        let worker: WorkerConfig = from_environment("worker", &[("SHARES__LINE-1__WEIGHT", "2.5")]).unwrap();
        assert_eq!(worker.shares["line-1"].weight, Some(2.5));
        for text in ["nan", "2.7", "-1", "soon"] {
            let refused = from_environment::<CallerConfig>("caller", &[("RETRIES", text)]).unwrap_err();
            assert!(refused.to_string().contains("retries"), "{refused}");
        }
    }

    #[test]
    fn a_value_out_of_range_is_refused_by_name() {
        assert!(load("[session]\ncell = \"No Chunk\"\n").unwrap_err().to_string().contains("cell"));
        assert!(load("[session]\nmode = \"client\"\n").unwrap_err().to_string().contains("connect"));
        assert!(load("[session]\nlease_ms = \"soon\"\n").unwrap_err().to_string().contains("lease_ms"));
        assert!(load("[worker]\noutcomes_kept = 0\n").unwrap_err().to_string().contains("outcomes_kept"));
        assert!(load("[caller]\nattempt_share = 2.0\n").unwrap_err().to_string().contains("attempt_share"));
    }
}
