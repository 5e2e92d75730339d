//! One run asked by several processes: on this machine, or on others by `ssh`. Each has sessions of its own and asks every so-many-th request of the
//! same sequence; what became of each request comes back here, where the one report is made.

use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::process::Stdio;
use std::time::Duration;

use repose_runtime::now_ns;
use serde::{Deserialize, Serialize};
use tokio::process::Command;

use super::LoadArgs;
use super::asking::{Asking, Slice};
use super::report::{Asked, Ended};
use crate::client::{self, SystemArgs};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;

/// How long agents may take to start and to get ready: they all begin then, by the clocks of their machines.
const READY_WITHIN: Duration = Duration::from_secs(8);
/// The most processes of one machine.
const MOST: usize = 64;

/// Where the processes run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Agents {
    /// So many on this machine.
    Here(usize),
    /// One on each of these, by `ssh`, where `repose` is installed.
    On(Vec<String>),
}

impl std::str::FromStr for Agents {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            Ok(count @ 1..=MOST) => Ok(Self::Here(count)),
            Ok(_) => Err(format!("expected 1 to {MOST} processes on this machine")),
            Err(_) => {
                let hosts: Vec<String> = text.split(',').map(str::trim).filter(|host| !host.is_empty()).map(str::to_owned).collect();
                let is_option = hosts.iter().any(|host| host.starts_with('-'));
                if hosts.is_empty() || is_option {
                    Err(format!("expected a number of processes, or machines with commas, got {text:?}"))
                } else {
                    Ok(Self::On(hosts))
                }
            }
        }
    }
}

/// What an agent is told beside the run's arguments: which of the requests are its own, and when to begin.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    slice: Slice,
    begin_ns: u64,
    rate: Option<f64>,
    requests: usize,
}

impl std::str::FromStr for Part {
    type Err = String;

    /// `1/3@1764000000000000000,requests=100,rate=20`
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("a coordinator's own word was expected, got {text:?}");
        let parsed = || {
            let mut fields = text.split(',');
            let (slice, begin_ns) = fields.next()?.split_once('@')?;
            let (of, all) = slice.split_once('/')?;
            let slice = Slice { of: of.parse().ok()?, all: all.parse().ok()? };
            let requests = fields.next()?.strip_prefix("requests=")?.parse().ok()?;
            let rate = match fields.next() {
                Some(rate) => Some(rate.strip_prefix("rate=")?.parse().ok()?),
                None => None,
            };
            (slice.of < slice.all).then_some(Self { slice, begin_ns: begin_ns.parse().ok()?, rate, requests })
        };
        parsed().ok_or_else(wrong)
    }
}

impl std::fmt::Display for Part {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}@{},requests={}", self.slice.of, self.slice.all, self.begin_ns, self.requests)?;
        self.rate.map_or(Ok(()), |rate| write!(f, ",rate={rate}"))
    }
}

/// What an agent tells.
#[derive(Debug, Serialize, Deserialize)]
struct Told {
    ended: Vec<Ended>,
    dropped: usize,
    duplicates: usize,
    elapsed_s: f64,
    /// Whether it was ready when all were to begin.
    in_time: bool,
}

/// Asks one part, and tells what became of it on standard output.
pub async fn ask_part(args: &LoadArgs, part: &Part) -> CommandResult {
    let session = client::connect(&args.connect.system).await?;
    let asking = Asking::prepare(&session, args, &args.connect.system, part.slice).await?;
    let left = Duration::from_nanos(part.begin_ns.saturating_sub(now_ns()));
    tokio::time::sleep(left).await;
    let asked = asking.ask(part.requests, part.rate).await?;
    client::close(session).await;
    let Asked { ended, dropped, duplicates, elapsed } = asked;
    let told = Told { ended, dropped, duplicates, elapsed_s: elapsed.as_secs_f64(), in_time: !left.is_zero() };
    Output { json: true }.print(&told, String::new)
}

/// Has agents ask all of a run, and puts together what they tell.
pub async fn ask_by(agents: &Agents, system: &SystemArgs, requests: usize, rate: Option<f64>) -> Result<Asked, Failure> {
    let hosts: Vec<Option<&str>> = match agents {
        Agents::Here(count) => vec![None; *count],
        Agents::On(hosts) => hosts.iter().map(|host| Some(host.as_str())).collect(),
    };
    let begin_ns = now_ns() + READY_WITHIN.as_nanos() as u64;
    let asked = hosts.iter().enumerate().map(|(of, host)| {
        let part = Part { slice: Slice { of, all: hosts.len() }, begin_ns, rate, requests };
        ask_one(*host, system, part)
    });
    let mut all = Asked { ended: Vec::new(), dropped: 0, duplicates: 0, elapsed: Duration::ZERO };
    for told in futures::future::try_join_all(asked).await? {
        if !told.in_time {
            tracing::warn!("an agent was not ready in time and began later than the others");
        }
        all.ended.extend(told.ended);
        all.dropped += told.dropped;
        all.duplicates += told.duplicates;
        all.elapsed = all.elapsed.max(Duration::from_secs_f64(told.elapsed_s));
    }
    Ok(all)
}

async fn ask_one(host: Option<&str>, system: &SystemArgs, part: Part) -> Result<Told, Failure> {
    let args = arguments(std::env::args_os().skip(1), system, &part);
    let mut command = match host {
        None => {
            let mut command = Command::new(std::env::current_exe().map_err(Failure::other)?);
            command.args(args);
            command
        }
        Some(host) => {
            let mut command = Command::new("ssh");
            command.args(["-o", "BatchMode=yes", host, "repose"]).args(args.iter().map(|arg| quoted(arg)));
            command
        }
    };
    let name = host.map_or_else(|| format!("agent {}", part.slice.of), str::to_owned);
    let ended = command.stdin(Stdio::null()).stderr(Stdio::inherit()).kill_on_drop(true).output().await;
    let ended = ended.map_err(|e| Failure::other(format!("{name} could not be started: {e}")))?;
    if !ended.status.success() {
        return Err(Failure::other(format!("{name} ended early: {}", ended.status)));
    }
    serde_json::from_slice(&ended.stdout).map_err(|e| Failure::other(format!("{name} told something else than what it asked: {e}")))
}

/// Options of a run that are the coordinator's own, or that an agent is told anew, and whether a value follows.
const OWN: [(&str, bool); 17] = [
    ("--agents", true),
    ("--agent", true),
    ("--up", false),
    ("--secured", false),
    ("--routers", true),
    ("--planners", true),
    ("--inference", true),
    ("--fault", true),
    ("--find-capacity", false),
    ("--slo", true),
    ("--warm-up", true),
    ("--csv", true),
    ("--html", true),
    ("--connect", true),
    ("--cell", true),
    ("--pool", true),
    ("--config", true),
];

/// An agent's arguments: those of this process without what is the coordinator's own.
fn arguments(ours: impl Iterator<Item = OsString>, system: &SystemArgs, part: &Part) -> Vec<OsString> {
    let (mut args, mut ours) = (Vec::new(), ours);
    while let Some(arg) = ours.next() {
        let bytes = arg.as_bytes();
        let is = |name: &str| bytes.strip_prefix(name.as_bytes()).is_some_and(|rest| rest.is_empty() || rest[0] == b'=');
        match OWN.iter().find(|(name, _)| is(name)) {
            Some((name, has_value)) => {
                if *has_value && bytes == name.as_bytes() {
                    ours.next();
                }
            }
            None => args.push(arg),
        }
    }
    // Some of these may come from variables here, which other machines do not have.
    let option = |name: &str, value: &OsStr| [OsString::from(name), value.to_owned()];
    args.extend(system.connect.iter().flat_map(|endpoint| option("--connect", endpoint.as_ref())));
    args.extend(system.cell.iter().flat_map(|cell| option("--cell", cell.as_ref())));
    args.extend(system.pool.iter().flat_map(|pool| option("--pool", pool.as_ref())));
    args.extend(system.config.iter().flat_map(|file| option("--config", file.as_os_str())));
    args.extend(option("--agent", part.to_string().as_ref()));
    args
}

/// A word for a shell, as `ssh` hands its words to one.
fn quoted(word: &OsStr) -> OsString {
    let parts: Vec<&[u8]> = word.as_bytes().split(|byte| *byte == b'\'').collect();
    let inside: Vec<u8> = parts.join(&b"'\\''"[..]);
    OsString::from_vec([&b"'"[..], &inside[..], &b"'"[..]].concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agents_are_processes_here_or_machines() {
        assert_eq!("3".parse(), Ok(Agents::Here(3)));
        assert_eq!("a, b.example".parse(), Ok(Agents::On(vec!["a".to_owned(), "b.example".to_owned()])));
        assert!(["0", "", "-oProxyCommand=x", "1000"].iter().all(|text| text.parse::<Agents>().is_err()));
    }

    #[test]
    fn an_agent_is_told_its_part_and_nothing_of_the_coordinators() {
        let part = Part { slice: Slice { of: 1, all: 3 }, begin_ns: 7, rate: Some(2.5), requests: 10 };
        assert_eq!(part.to_string().parse(), Ok(part.clone()));
        let closed = Part { rate: None, ..part.clone() };
        assert_eq!(closed.to_string().parse(), Ok(closed));
        assert!(["", "3/3@7,requests=1", "1/3", "x"].iter().all(|text| text.parse::<Part>().is_err()));
        let ours = "--json load --agents 3 --clients 8 --html=a.html --up --routers 2 --fault kill:planner:2s --mix 1:count=2 --slo p50<1s";
        let system = SystemArgs { connect: Some("tcp/127.0.0.1:1".to_owned()), cell: None, pool: None, config: None };
        let args = arguments(ours.split(' ').map(OsString::from), &system, &part).join(OsStr::new(" "));
        assert_eq!(args, *format!("--json load --clients 8 --mix 1:count=2 --connect tcp/127.0.0.1:1 --agent {part}"));
        assert_eq!(quoted(OsStr::new("it's")), "'it'\\''s'");
    }

    #[test]
    fn an_agent_elsewhere_is_told_the_cell_that_a_variable_says_here() {
        let part = Part { slice: Slice { of: 0, all: 2 }, begin_ns: 7, rate: None, requests: 10 };
        let system = SystemArgs { connect: None, cell: Some("lab".to_owned()), pool: Some("rack".to_owned()), config: None };
        for ours in ["load --requests 10", "load --requests 10 --cell lab --pool=rack"] {
            let args = arguments(ours.split(' ').map(OsString::from), &system, &part).join(OsStr::new(" "));
            assert_eq!(args, *format!("load --requests 10 --cell lab --pool rack --agent {part}"));
        }
    }

    #[test]
    fn names_of_files_that_are_no_text_are_passed_on_as_they_are() {
        let part = Part { slice: Slice { of: 0, all: 1 }, begin_ns: 7, rate: None, requests: 10 };
        let name = OsString::from_vec(b"la\xffb's".to_vec());
        let system = SystemArgs { connect: None, cell: None, pool: None, config: Some(name.clone().into()) };
        let ours = [OsString::from("load"), OsString::from_vec(b"--csv=\xff.csv".to_vec()), OsString::from("--html"), name.clone()];
        let args = arguments(ours.into_iter(), &system, &part);
        assert_eq!(args, ["load".into(), "--config".into(), name.clone(), "--agent".into(), OsString::from(part.to_string())]);
        assert_eq!(quoted(&name), OsString::from_vec(b"'la\xffb'\\''s'".to_vec()));
    }
}
