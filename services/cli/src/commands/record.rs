//! `repose record`: a running cell into MCAP files, to look at, to play, and to ask again.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use repose_recorder::record::record;
use repose_recorder::{RecordSettings, RecordingError, Summary};
use repose_runtime::Shutdown;

use crate::client::{self, SystemArgs};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;

/// Arguments of `record`.
#[derive(Debug, Args)]
pub struct RecordArgs {
    /// The file to write; the next ones are named run.2.mcap, run.3.mcap, ….
    #[arg(long, default_value = "run.mcap", value_name = "FILE.mcap")]
    pub out: PathBuf,
    /// The running system.
    #[command(flatten)]
    pub system: SystemArgs,
    /// Stop after this many seconds. Default: when interrupted.
    #[arg(long)]
    pub seconds: Option<f64>,
    /// Start a new file when the current one exceeds this size, MiB.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u64).range(1..))]
    pub file_mib: u64,
    /// Remove the oldest files when their total exceeds this size, MiB.
    #[arg(long, default_value_t = 8192)]
    pub total_mib: u64,
    /// Minimum time between two frames of a camera, milliseconds; 0 records all of them.
    #[arg(long, default_value_t = 200)]
    pub frame_period_ms: u64,
    /// Minimum time between two whole scenes of a camera, milliseconds. Scenes that a request refers to are always recorded.
    #[arg(long, default_value_t = 2000)]
    pub scene_period_ms: u64,
    /// Minimum time between two pictures of a camera for Foxglove and Lichtblick, milliseconds; 0 draws every recorded frame.
    #[arg(long, default_value_t = 500)]
    pub picture_period_ms: u64,
    /// Record only the messages of the wire, which play and replay need, without those that Foxglove and Lichtblick draw.
    #[arg(long)]
    pub no_looks: bool,
}

impl RecordArgs {
    fn settings(&self) -> Result<RecordSettings, Failure> {
        let bytes = |field: &str, mib: u64| {
            mib.checked_mul(1 << 20).ok_or_else(|| Failure::bad_input(field, format!("{mib} MiB exceed what a file system can hold")))
        };
        if self.total_mib / 2 < self.file_mib {
            return Err(Failure::bad_input(
                "total-mib",
                format!("expected at least twice --file-mib, {}, got {}", self.file_mib, self.total_mib),
            ));
        }
        let settings = RecordSettings {
            max_file_bytes: bytes("file-mib", self.file_mib)?,
            max_total_bytes: bytes("total-mib", self.total_mib)?,
            frame_period: Duration::from_millis(self.frame_period_ms),
            scene_period: Duration::from_millis(self.scene_period_ms),
            looks: !self.no_looks,
            picture_period: Duration::from_millis(self.picture_period_ms),
            ..RecordSettings::new(self.out.clone())
        };
        settings.validate()?;
        Ok(settings)
    }
}

impl From<RecordingError> for Failure {
    fn from(error: RecordingError) -> Self {
        match error {
            RecordingError::Setting { field, message } => Self::bad_input(field, message),
            RecordingError::File { path, source } => Self::bad_input(&path.display().to_string(), source),
            RecordingError::Content { path, reason } => Self::bad_input(&path.display().to_string(), reason),
            RecordingError::Call(error) => error.into(),
            RecordingError::Runtime(error) => error.into(),
        }
    }
}

/// Runs the command.
pub async fn run(args: &RecordArgs, output: Output) -> CommandResult {
    let settings = args.settings()?;
    if args.seconds.is_some_and(|seconds| !(seconds > 0.0 && seconds <= 1e9)) {
        return Err(Failure::bad_input("seconds", "expected above 0"));
    }
    let session = client::connect(&args.system).await?;
    let shutdown = Shutdown::on_signals()?;
    let enough = shutdown.clone();
    let seconds = args.seconds;
    let begun = |silent: &[String]| {
        tracing::info!(file = %args.out.display(), cell = session.cell().name(), "recording; Ctrl-C ends it");
        if let Some(pool) = session.pool() {
            tracing::warn!(
                "calls to the pool {pool} are not recorded with this cell: its workers copy them for whoever records {pool} (--cell {pool})"
            );
        }
        if !silent.is_empty() {
            let why =
                if session.is_user() { "this user may not record: frames = true in the roles file lets it" } else { "an earlier version?" };
            tracing::warn!("these workers do not copy their calls ({why}): {}", silent.join(", "));
        }
        if let Some(seconds) = seconds {
            tokio::spawn(async move {
                tokio::time::sleep(Duration::from_secs_f64(seconds)).await;
                enough.trigger();
            });
        }
    };
    let recorded = record(&session, settings, &shutdown, begun).await;
    let cell = session.cell().name().to_owned();
    client::close(session).await;
    let Summary { written, messages, lost } = recorded?;
    if messages.is_empty() {
        return Err(Failure::other(format!("nothing was heard in cell {cell}: {} holds no message", args.out.display())));
    }
    let files: Vec<String> = written.files.iter().map(|file| file.display().to_string()).collect();
    let lost_count = lost.values().sum::<u64>();
    let document = serde_json::json!({
        "files": files, "bytes": written.bytes, "removed": written.removed, "messages": messages, "lost": lost_count, "lost_by_kind": lost,
    });
    output.print(&document, || {
        let counts: Vec<String> = messages.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
        let mut said = format!("{} ({:.1} MB): {}", files.join(", "), written.bytes as f64 / 1e6, counts.join(", "));
        if written.removed > 0 {
            said.push_str(&format!("; {} older files had to go", written.removed));
        }
        if lost_count > 0 {
            let lost: Vec<String> = lost.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
            said.push_str(&format!(
                "; lost: {} (disk, network or machine were too slow; outages are the router's; scenes also where no perception that may be asked has them)",
                lost.join(", ")
            ));
        }
        said
    })
}
