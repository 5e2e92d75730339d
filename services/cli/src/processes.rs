//! This program as another process: how `up` and benches start services.

use std::path::Path;
use std::process::Stdio;

use tokio::process::Command;

use crate::failure::Failure;

/// A service, or the router, as a process of this program that ends with this one.
pub fn service_process(endpoint: &str, cell: &str, config: Option<&Path>, what: &str) -> Result<Command, Failure> {
    let mut command = Command::new(std::env::current_exe().map_err(Failure::other)?);
    command.args(["serve", what, "--connect", endpoint, "--cell", cell]);
    if let Some(config) = config {
        command.arg("--config").arg(config);
    }
    command.stdin(Stdio::null()).stdout(Stdio::null()).kill_on_drop(true);
    // A terminal's Ctrl-C would reach the whole group; the processes are told one by one instead, so that they drain.
    command.process_group(0);
    // SAFETY: prctl is async-signal-safe and touches nothing but the new process's own setting.
    unsafe {
        command.pre_exec(|| match libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM) {
            0 => Ok(()),
            _ => Err(std::io::Error::last_os_error()),
        });
    }
    Ok(command)
}
