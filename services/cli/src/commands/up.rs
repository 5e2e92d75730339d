//! `repose up`: a router and every service as processes of their own on this machine, until interrupted.
//!
//! Each is this program as `repose serve …`. One that ends is started again after a pause; all end with this process, however it ends.

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use repose_proto::Service;
use repose_runtime::{RuntimeConfig, Session, SessionMode, Shutdown};
use tokio::process::{Child, Command};

use crate::args::UpArgs;
use crate::failure::{Failure, Outcome};
use crate::output::Output;

/// How long to wait before an ended process is started again.
const RESTART_PAUSE: Duration = Duration::from_secs(1);
/// How long the services may take to come up.
const READY_WITHIN: Duration = Duration::from_secs(60);
/// How long a process may take to drain before it is killed.
const STOP_WITHIN: Duration = Duration::from_secs(15);

/// Runs until interrupted.
pub async fn run(args: &UpArgs, output: Output) -> Outcome {
    let shutdown = Shutdown::on_signals()?;
    let mut processes = vec!["router".to_owned()];
    for service in Service::ALL {
        let count = match service {
            Service::Inference => args.inference,
            Service::Planner => args.planners,
            _ => 1,
        };
        processes.extend(std::iter::repeat_n(service.as_str().to_owned(), count));
    }
    let mut watchers = Vec::new();
    for what in &processes {
        watchers.push(tokio::spawn(keep_running(command(args, what)?, what.clone(), shutdown.clone())));
    }
    let up = ready(args, &shutdown).await;
    if let Err(failure) = up {
        shutdown.trigger();
        for watcher in watchers {
            watcher.await.map_err(Failure::other)?;
        }
        return Err(failure);
    }
    let document = serde_json::json!({"listen": args.listen, "cell": args.cell, "processes": processes});
    output.print(&document, || format!("up: {} at {}, cell {}; Ctrl-C ends it", processes.join(", "), args.listen, args.cell))?;
    shutdown.requested().await;
    for watcher in watchers {
        watcher.await.map_err(Failure::other)?;
    }
    Ok(())
}

/// Waits until every service has its workers.
async fn ready(args: &UpArgs, shutdown: &Shutdown) -> Outcome {
    let mut config = RuntimeConfig::load(args.config.as_deref())?;
    config.session.mode = SessionMode::Client;
    config.session.connect = vec![args.listen.clone()];
    config.session.cell.clone_from(&args.cell);
    let session = Session::open(config).await?;
    for service in Service::ALL {
        let count = match service {
            Service::Inference => args.inference,
            Service::Planner => args.planners,
            _ => 1,
        };
        let caller = session.caller(service).await?;
        tokio::select! {
            up = caller.wait_for_workers(count, READY_WITHIN) => up?,
            () = shutdown.requested() => break,
        }
    }
    Ok(session.close().await?)
}

fn command(args: &UpArgs, what: &str) -> Result<Command, Failure> {
    let mut command = service_process(&args.listen, &args.cell, args.config.as_deref(), what)?;
    if what == Service::Simulator.as_str() {
        command.env("REPOSE_SIMULATOR__SEED", args.seed.to_string());
    }
    Ok(command)
}

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

/// Starts a process again whenever it ends, until `shutdown`; then tells it to drain.
async fn keep_running(mut command: Command, what: String, shutdown: Shutdown) {
    while !shutdown.is_requested() {
        let mut child = match command.spawn() {
            Ok(child) => child,
            Err(error) => {
                tracing::error!(what, %error, "could not be started");
                return;
            }
        };
        tokio::select! {
            ended = child.wait() => {
                if !shutdown.is_requested() {
                    tracing::warn!(what, status = ?ended.ok(), "ended, starting it again");
                }
            }
            () = shutdown.requested() => return stop(&mut child, &what).await,
        }
        tokio::select! {
            () = tokio::time::sleep(RESTART_PAUSE) => {}
            () = shutdown.requested() => {}
        }
    }
}

async fn stop(child: &mut Child, what: &str) {
    if let Some(id) = child.id().and_then(|id| i32::try_from(id).ok()) {
        // SAFETY: a plain system call on a child that has not been waited for, so its id is still its own.
        unsafe { libc::kill(id, libc::SIGTERM) };
    }
    if tokio::time::timeout(STOP_WITHIN, child.wait()).await.is_err() {
        tracing::warn!(what, "did not drain in time and is killed");
        if let Err(error) = child.kill().await {
            tracing::error!(what, %error, "could not be killed");
        }
    }
}
