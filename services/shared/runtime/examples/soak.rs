//! A deployment under load whose processes are killed and started again, for as long as one likes: does any end that nobody killed?
//!
//! `cargo run --release -p repose-runtime --example soak -- run quic/127.0.0.1:17447 soak.json5 120 0.5`: endpoint, a Zenoh file with the
//! certificates of both ends, minutes, and the pause between two calls of a client's, milliseconds. A router, two workers and two clients,
//! each a process; every three seconds one of them is killed, in turn by SIGKILL and by SIGTERM. Prints one line of JSON a minute.

use std::collections::BTreeMap;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use repose_proto::{CallError, Payload, Service};
use repose_runtime::{Call, CallOptions, Handler, RuntimeConfig, Session, SessionMode, Shutdown, Traffic, run_router};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, Command};

type Failed = Box<dyn std::error::Error + Send + Sync>;

/// The processes of the deployment.
const ROLES: [&str; 5] = ["router", "worker", "worker", "client", "client"];
/// How often one of them is killed.
const PERIOD: Duration = Duration::from_secs(3);
/// Bytes of a frame, put five times a second by every worker.
const FRAME_BYTES: usize = 600_000;

struct Echo;

#[async_trait::async_trait]
impl Handler for Echo {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        Ok(call.payload)
    }
}

fn payload(bytes: usize) -> Payload {
    Payload { encoding: "application/octet-stream".to_owned(), bytes: vec![7; bytes].into() }
}

fn config(mode: SessionMode, endpoint: &str, file: &str) -> RuntimeConfig {
    let mut config = RuntimeConfig::default();
    config.session.mode = mode;
    config.session.zenoh_file = (file != "-").then(|| PathBuf::from(file));
    match mode {
        SessionMode::Router => config.session.listen = vec![endpoint.to_owned()],
        _ => config.session.connect = vec![endpoint.to_owned()],
    }
    config
}

async fn worker(endpoint: &str, file: &str, shutdown: Shutdown) -> Result<(), Failed> {
    let session = Session::open(config(SessionMode::Client, endpoint, file)).await?;
    let frames = session.publisher(session.cell().camera_frame(&format!("c{}", std::process::id())), Traffic::Frame);
    tokio::spawn(async move {
        loop {
            // A link that is down loses frames, as it may.
            drop(frames.put(payload(FRAME_BYTES)).await);
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
    });
    session.serve(Service::Inference, Arc::new(Echo), shutdown).await?;
    Ok(session.close().await?)
}

async fn client(endpoint: &str, file: &str, pause: Duration, shutdown: Shutdown) -> Result<(), Failed> {
    let session = Session::open(config(SessionMode::Client, endpoint, file)).await?;
    let caller = session.caller(Service::Inference).await?;
    let mut frames = session.subscribe_latest(&session.cell().camera_frames()).await?;
    tokio::spawn(async move { while frames.recv().await.is_some() {} });
    let (answered, failed) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    for seed in 0..4 {
        let (caller, answered, failed) = (caller.clone(), answered.clone(), failed.clone());
        tokio::spawn(async move {
            let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
            loop {
                let bytes = 64 << random.random_range(0..15);
                match caller.call("echo", payload(bytes), CallOptions::within(Duration::from_secs(10))).await {
                    Ok(_) => answered.fetch_add(1, Ordering::Relaxed),
                    Err(error) => {
                        println!("failed {error}");
                        failed.fetch_add(1, Ordering::Relaxed)
                    }
                };
                tokio::time::sleep(pause).await;
            }
        });
    }
    loop {
        tokio::select! {
            () = shutdown.requested() => return Ok(session.close().await?),
            () = tokio::time::sleep(Duration::from_secs(1)) => {
                println!("calls {} {}", answered.swap(0, Ordering::Relaxed), failed.swap(0, Ordering::Relaxed));
            }
        }
    }
}

/// What was counted so far.
#[derive(Default, Clone, serde::Serialize)]
struct Report {
    minutes: f64,
    killed: u64,
    calls: u64,
    failed: u64,
    /// Ends that nobody asked for, by role and status.
    unasked: BTreeMap<String, u64>,
    /// Remarkable lines on standard error.
    said: BTreeMap<String, u64>,
}

fn spawn(role: &str, args: &[String], report: &Arc<std::sync::Mutex<Report>>) -> Result<Child, Failed> {
    let mut command = Command::new(std::env::current_exe()?);
    command.arg(role).args(args).stdout(Stdio::piped()).stderr(Stdio::piped()).kill_on_drop(true);
    let mut child = command.spawn()?;
    for (lines, is_error) in [(child.stdout.take().map(either), false), (child.stderr.take().map(either), true)] {
        let (Some(lines), report) = (lines, report.clone()) else { continue };
        tokio::spawn(async move {
            let mut lines = BufReader::new(lines).lines();
            while let Ok(Some(line)) = lines.next_line().await {
                let mut report = report.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                let words: Vec<&str> = line.split(' ').collect();
                if !is_error && words[0] == "calls" {
                    report.calls += words[1].parse().unwrap_or(0);
                    report.failed += words[2].parse().unwrap_or(0);
                } else if !is_error || ["memory allocation", "emap", "panicked"].iter().any(|sign| line.contains(sign)) {
                    *report.said.entry(line.chars().take(160).collect()).or_default() += 1;
                }
            }
        });
    }
    Ok(child)
}

fn either(stream: impl tokio::io::AsyncRead + Send + Unpin + 'static) -> Box<dyn tokio::io::AsyncRead + Send + Unpin> {
    Box::new(stream)
}

async fn run(args: &[String], minutes: f64) -> Result<(), Failed> {
    let report = Arc::new(std::sync::Mutex::new(Report::default()));
    let mut children = Vec::new();
    for role in ROLES {
        children.push(spawn(role, args, &report)?);
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    let (started, mut told) = (Instant::now(), 0.0);
    for round in 0usize.. {
        tokio::time::sleep(PERIOD).await;
        // The router less often than the others: it takes them all along.
        let victim = if round.is_multiple_of(10) { 0 } else { 1 + round % (ROLES.len() - 1) };
        for (index, child) in children.iter_mut().enumerate() {
            let ended = child.try_wait()?;
            if let Some(status) = ended {
                let how = status.signal().map_or_else(|| status.to_string(), |signal| format!("signal {signal}"));
                *report
                    .lock()
                    .unwrap_or_else(std::sync::PoisonError::into_inner)
                    .unasked
                    .entry(format!("{} {how}", ROLES[index]))
                    .or_default() += 1;
            } else if index == victim {
                let id = i32::try_from(child.id().ok_or("the child has no id")?)?;
                let signal = if round % 2 == 0 { libc::SIGKILL } else { libc::SIGTERM };
                // SAFETY: a plain system call on a child that has not been waited for, so its id is still its own.
                unsafe { libc::kill(id, signal) };
                child.wait().await?;
                report.lock().unwrap_or_else(std::sync::PoisonError::into_inner).killed += 1;
            }
            if ended.is_some() || index == victim {
                *child = spawn(ROLES[index], args, &report)?;
            }
        }
        let elapsed = started.elapsed().as_secs_f64() / 60.0;
        if elapsed - told >= 1.0 || elapsed >= minutes {
            told = elapsed;
            let mut report = report.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            report.minutes = elapsed;
            println!("{}", serde_json::to_string(&*report)?);
        }
        if elapsed >= minutes {
            break;
        }
    }
    Ok(())
}

#[tokio::main]
async fn main() -> Result<(), Failed> {
    repose_runtime::start_logging("warn,repose=warn");
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [role, endpoint, file, minutes, pause_ms] = args.as_slice() else { return Err("run ENDPOINT FILE MINUTES PAUSE_MS".into()) };
    let pause = Duration::from_secs_f64(pause_ms.parse::<f64>()? / 1e3);
    match role.as_str() {
        "run" => run(&args[1..], minutes.parse()?).await,
        "router" => Ok(run_router(config(SessionMode::Router, endpoint, file), Shutdown::on_signals()?).await?),
        "worker" => worker(endpoint, file, Shutdown::on_signals()?).await,
        _ => client(endpoint, file, pause, Shutdown::on_signals()?).await,
    }
}
