//! `repose deploy`: the configuration of a deployment with users, from one short file; and the trial of who may do what.

use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use clap::{Args, Subcommand};
use repose_proto::CallError;
use repose_runtime::CertificateExpiry;
use repose_runtime::deployment::{self, CheckReport, Group, Roles, TrialFiles};
use tokio::process::Child;

use crate::asynchronous::in_runtime;
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::processes::service_process;

/// Arguments of `deploy`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct DeployArgs {
    /// The roles file (TOML): users and their permissions. deploy/roles.toml is an example.
    #[arg(required = true, value_name = "ROLES")]
    roles: Option<PathBuf>,
    /// The output folder. Existing passwords, certificates, and settings of your own in the configurations are kept.
    #[arg(long, required = true, value_name = "DIR")]
    out: Option<PathBuf>,
    /// The folder's absolute path on the machines that use it. Default: DIR.
    #[arg(long, value_name = "DIR", value_parser = parse_absolute)]
    installed_at: Option<PathBuf>,
    /// A group, by name or number, that may read the router's and the users' secrets: that of the units' user, repose. Default: nobody but whoever
    /// writes them. The authority's key is never shared.
    #[arg(long, value_name = "GROUP")]
    group: Option<String>,
    /// What else to do.
    #[command(subcommand)]
    command: Option<DeployCommand>,
}

/// A path on another machine: there is no folder there that it could be relative to.
fn parse_absolute(path: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(path);
    if path.is_absolute() { Ok(path) } else { Err("expected an absolute path, such as /etc/repose".to_owned()) }
}

/// What else `deploy` does.
#[derive(Debug, Subcommand)]
enum DeployCommand {
    /// Tests every user, verb and key against the running router, and reports what differs from the roles. Only for a cell that is not in
    /// operation: robots would act on the messages sent.
    Check(CheckArgs),
}

/// Arguments of `deploy check`.
#[derive(Debug, Args)]
struct CheckArgs {
    /// The folder that `deploy` wrote.
    #[arg(value_name = "DIR")]
    deployment: PathBuf,
    /// The router's address. Default: the roles file's.
    #[arg(long, value_name = "ENDPOINT", conflicts_with = "apart")]
    connect: Option<String>,
    /// Start a separate router with this configuration, on a port of its own, and test that one: does not touch running systems.
    #[arg(long)]
    apart: bool,
}

/// Runs the command.
pub fn run(args: &DeployArgs, output: Output) -> CommandResult {
    match (&args.command, &args.roles, &args.out) {
        (Some(DeployCommand::Check(args)), ..) => in_runtime(check(args, output)),
        (None, Some(roles), Some(out)) => write(args, roles, out, output),
        _ => Err(Failure::bad_input("roles", "a roles file and --out are needed")),
    }
}

/// The roles file beside what was made of it.
const ROLES: &str = "roles.toml";

fn read(path: &Path) -> Result<(Roles, String), Failure> {
    let named = |e: CallError| CallError { message: format!("{}: {}", path.display(), e.message), ..e };
    let text = std::fs::read_to_string(path).map_err(|e| Failure::bad_input(&path.display().to_string(), e))?;
    let roles = Roles::parse(&text).map_err(|e| Failure::from(named(e)))?;
    Ok((roles, text))
}

fn write(args: &DeployArgs, path: &Path, out: &Path, output: Output) -> CommandResult {
    let (roles, text) = read(path)?;
    let group = args.group.as_deref().map(Group::named).transpose()?;
    let at = std::path::absolute(out).map_err(|e| Failure::bad_input("out", e))?;
    let installed_at = args.installed_at.as_deref().unwrap_or(&at);
    let written = deployment::write(&roles, &at, installed_at).map_err(failed)?;
    group.map_or(Ok(()), |group| group.may_read(&written, &at)).map_err(failed)?;
    // It may be the very file that was read.
    repose_dataset::write_whole(&at.join(ROLES), text.as_bytes()).map_err(|e| Failure::bad_input("out", e))?;
    output.print(&written, || {
        format!(
            "{}: {} files written, {} secrets and certificates kept\nrouter: repose serve router --config {}\ncheck: repose deploy check {}{}",
            at.display(),
            written.files.len(),
            written.kept.len(),
            installed_at.join("router/router.toml").display(),
            at.display(),
            if group.is_some() { "" } else { UNREADABLE },
        )
    })
}

fn failed(e: deployment::Failed) -> Failure {
    Failure::bad_input(&e.path.display().to_string(), e.message)
}

/// What is said where nobody but whoever wrote the secrets reads them.
const UNREADABLE: &str = "\nunits: they run as user repose, who cannot read these secrets: with --group repose it can";

async fn check(args: &CheckArgs, output: Output) -> CommandResult {
    let (roles, _) = read(&args.deployment.join(ROLES))?;
    let at = std::path::absolute(&args.deployment).map_err(|e| Failure::bad_input("deployment", e))?;
    let files = TrialFiles::write(&roles, &at)?;
    let (_router, endpoint) = match args.apart {
        true => router_apart(&files).map(|(router, endpoint)| (Some(router), endpoint))?,
        false => (None, args.connect.clone().unwrap_or_else(|| roles.endpoint())),
    };
    let report = deployment::check(&roles, &files, &endpoint).await?;
    output.print(&report, || words(&report))?;
    if report.is_right() { Ok(()) } else { Err(Failure::NotAchieved) }
}

/// A router with the deployment's configuration, as a process of its own on a port that is free; and where it is.
fn router_apart(files: &TrialFiles) -> Result<(Child, String), Failure> {
    let config = files.router().map_err(failed)?;
    let address = UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).map_err(Failure::other)?;
    let endpoint = format!("quic/{address}");
    let mut router = service_process(&endpoint, "check", None, "router")?;
    // What it refuses is in the report; in its log it would be said a second time.
    router.env("REPOSE_SESSION__ZENOH_FILE", config).stderr(Stdio::null());
    Ok((router.spawn().map_err(Failure::other)?, endpoint))
}

fn words(report: &CheckReport) -> String {
    let CheckReport { tried, allowed, untried, wrong, unanswered, expiring } = report;
    let mut lines = vec![format!(
        "{tried} combinations of user, verb and key tried, {allowed} of them allowed; {untried} not tried, because nobody may be at the other end"
    )];
    lines.extend(wrong.iter().map(|trial| format!("WRONG: {trial}")));
    lines.extend(unanswered.iter().map(|trial| format!("UNKNOWN: {trial}")));
    lines.extend(expiring.iter().filter_map(CertificateExpiry::warning).map(|warning| format!("EXPIRES: {warning}")));
    lines.push(match (wrong.len(), unanswered.len()) {
        (0, 0) => "every user may do what the roles say, and nothing else".to_owned(),
        (wrong, 0) => format!("{wrong} differ from the roles"),
        (wrong, unanswered) => format!("{wrong} differ from the roles, and {unanswered} had no answer either way"),
    });
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    type Line = crate::testing::Line<DeployArgs>;

    #[test]
    fn what_expires_is_said_beside_what_is_right() {
        let old = CertificateExpiry { file: "router/router.pem".into(), expires_on: "1970-01-01".to_owned(), expires_s: 0 };
        let report = CheckReport { expiring: vec![old], ..CheckReport::default() };
        assert!(report.is_right());
        assert!(words(&report).contains("EXPIRES: the certificate router/router.pem has expired, on 1970-01-01"), "{}", words(&report));
    }

    #[test]
    fn a_folder_on_another_machine_is_named_from_its_root() {
        let installed_at = |path: &str| {
            let line = ["deploy", "roles.toml", "--out", "out", "--installed-at", path];
            Line::try_parse_from(line).map(|line| line.args.installed_at).map_err(|e| e.to_string())
        };
        assert_eq!(installed_at("/etc/repose"), Ok(Some(PathBuf::from("/etc/repose"))));
        assert!(installed_at("etc/repose").is_err_and(|e| e.contains("--installed-at") && e.contains("absolute")));
    }
}
