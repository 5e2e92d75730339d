//! This program as another process: how `up` and benches start services.

use std::io::Write;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use repose_runtime::{FORMAT_VARIABLE, TelemetryConfig, load_config};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, ChildStderr, ChildStdin, Command};
use tokio::task::JoinHandle;

use crate::failure::Failure;

/// A service, or the router, as a process of this program that ends with this one, however this one ends: it drains when its standard input ends,
/// which this process holds open. (Linux's parent-death signal comes when the *thread* that started a process ends, and threads of a runtime do.)
///
/// Where its configuration has it tell its health at some port, it does so at one that is free, for it is not the only one with that configuration.
pub fn service_process(endpoint: &str, cell: &str, config: Option<&Path>, what: &str) -> Result<Command, Failure> {
    let mut command = Command::new(std::env::current_exe().map_err(Failure::other)?);
    command.args(["serve", what, "--until-stdin-ends", "--connect", endpoint, "--cell", cell]);
    if let Some(config) = config {
        command.arg("--config").arg(config);
    }
    let telemetry: TelemetryConfig = load_config("telemetry", config)?;
    if let Some((host, _)) = telemetry.listen.as_deref().and_then(|listen| listen.rsplit_once(':')) {
        command.env("REPOSE_TELEMETRY__LISTEN", format!("{host}:0"));
    }
    command.stdin(Stdio::piped()).stdout(Stdio::null()).kill_on_drop(true);
    // A terminal's Ctrl-C would reach the whole group; the processes are told one by one instead, so that they drain.
    command.process_group(0);
    Ok(command)
}

/// A process whose log comes out on standard error with its name before every line. Logs as JSON stay as they are, one document a line.
pub struct LabelledProcess {
    /// The process.
    pub child: Child,
    /// Open for as long as the process is to run: waiting for a child would close it.
    _stdin: Option<ChildStdin>,
    log: Option<JoinHandle<()>>,
}

impl LabelledProcess {
    /// Starts one.
    pub fn spawn(command: &mut Command, name: &str) -> std::io::Result<Self> {
        let mut child = command.stderr(Stdio::piped()).spawn()?;
        let log = child.stderr.take().map(|log| tokio::spawn(relabel(log, name.to_owned())));
        Ok(Self { _stdin: child.stdin.take(), child, log })
    }

    /// Waits until the last line of a process that has ended is out.
    pub async fn rest_of_log(self) {
        if let Some(log) = self.log {
            let _ended = tokio::time::timeout(LAST_LINES, log).await;
        }
    }
}

/// How long the last lines of a process may take: a process that it started may hold its log open.
const LAST_LINES: Duration = Duration::from_secs(1);
/// The longest name that is not cut off its column.
const NAME_WIDTH: usize = 12;

async fn relabel(log: ChildStderr, name: String) {
    let is_json = std::env::var(FORMAT_VARIABLE).is_ok_and(|format| format == "json");
    let mut lines = BufReader::new(log).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        let label = if is_json { String::new() } else { format!("{name:<NAME_WIDTH$} ") };
        // Where nobody reads the log any more, the process goes on.
        let _unread = writeln!(std::io::stderr(), "{label}{line}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processes_of_one_configuration_each_tell_their_health_at_a_port_of_their_own() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let listens_at = |text: &str| {
            std::fs::write(file.path(), text).expect("written");
            let command = service_process("tcp/127.0.0.1:7447", "cell", Some(file.path()), "planner").expect("a command");
            let mut set = command.as_std().get_envs().filter(|(name, _)| *name == "REPOSE_TELEMETRY__LISTEN");
            set.next().and_then(|(_, value)| value?.to_str().map(str::to_owned))
        };
        assert_eq!(listens_at("[telemetry]\nlisten = \"10.0.0.1:9464\"\n").as_deref(), Some("10.0.0.1:0"));
        assert_eq!(listens_at("[telemetry]\nlisten = \"[::1]:9464\"\n").as_deref(), Some("[::1]:0"));
        assert_eq!(listens_at(""), None, "nobody asked for it");
    }
}
