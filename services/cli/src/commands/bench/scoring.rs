//! `repose bench scoring`: how fast the networks answer and learn on this machine.

use std::path::Path;
use std::time::Duration;

use clap::Args;
use repose_dataset::Split;
use repose_evaluation::tables::scoring_speed::{BATCHES, ScoringSpeed, SpeedSettings, scoring_speed};
use repose_networks::Models;
use repose_simulator::generate::{GenerateSettings, generate};
use serde_json::{Value, json};

use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::values::threads;

/// Scenes that the training is timed on: speed does not depend on how many there are.
const TRAINING_SCENES: u64 = 16;

/// Arguments of `bench scoring`.
#[derive(Debug, Args)]
pub struct BenchScoringArgs {
    /// Threads. Default: one per core.
    #[arg(long)]
    pub threads: Option<usize>,
    /// Seconds per scoring figure.
    #[arg(long, default_value_t = 3.0)]
    pub seconds: f64,
    /// Seconds of training the discriminator; 0 skips it.
    #[arg(long, default_value_t = 45.0)]
    pub training_seconds: f64,
}

/// Runs the command.
pub fn run(args: &BenchScoringArgs, output: Output) -> CommandResult {
    let [each, training] = [("seconds", args.seconds), ("training-seconds", args.training_seconds)].map(|(field, value)| {
        Duration::try_from_secs_f64(value).map_err(|e| Failure::bad_input(field, format!("expected seconds, got {value}: {e}")))
    });
    let (each, training) = (each?, training?);
    let threads = threads(args.threads);
    let models = Models::embedded().map_err(Failure::other)?;
    let speed = scoring_speed(&models, &SpeedSettings { each, threads })?;
    let training_per_s = if training.is_zero() { None } else { Some(training_per_s(threads, training)?) };
    let document = document(&speed, training_per_s);
    output.print(&document, || text_of(&speed, training_per_s))
}

fn document(speed: &ScoringSpeed, training_per_s: Option<f64>) -> Value {
    let by_batch = |rates: [f64; BATCHES.len()]| -> serde_json::Map<String, Value> {
        BATCHES.iter().zip(rates).map(|(batch, rate)| (batch.to_string(), rate.into())).collect()
    };
    json!({
        "discriminator_per_s": by_batch(speed.discriminator_per_s),
        "outcome_per_s": by_batch(speed.outcome_per_s),
        "relations_per_s": speed.relations_per_s,
        "prior_per_s": speed.prior_per_s,
        "matmul_share": speed.matmul_share,
        "training_per_s": training_per_s,
        "points": speed.points, "candidate_gflop": speed.candidate_gflop, "matmul_gflops": speed.matmul_gflops,
        "kernel": speed.kernel, "threads": speed.threads,
    })
}

fn text_of(speed: &ScoringSpeed, training_per_s: Option<f64>) -> String {
    let mut lines = vec![format!("{} threads, kernel {}, {} points a candidate", speed.threads, speed.kernel, speed.points)];
    for (batch, rate) in BATCHES.iter().zip(speed.discriminator_per_s) {
        lines.push(format!("discriminator, batches of {batch:>3}: {rate:>8.0} candidates/s"));
    }
    for (batch, rate) in BATCHES.iter().zip(speed.outcome_per_s) {
        lines.push(format!("outcome, batches of {batch:>9}: {rate:>8.0} candidates/s (scene features shared)"));
    }
    lines.push(format!("relations, translations:       {:>8.0} /s", speed.relations_per_s));
    lines.push(format!("prior:                         {:>8.0} /s", speed.prior_per_s));
    lines.push(format!(
        "{:.3} GFLOP a candidate; {:.0} % of the {:.0} GFLOP/s that a large product reaches",
        speed.candidate_gflop,
        100.0 * speed.matmul_share,
        speed.matmul_gflops
    ));
    lines.extend(training_per_s.map(|rate| format!("training the discriminator:    {rate:>8.1} samples/s")));
    lines.join("\n")
}

/// Samples a second of `repose train` on a few scenes made for it. In a process of its own, as a training always is: the tensor library
/// reads how many threads it may have when it first runs.
fn training_per_s(threads: usize, length: Duration) -> Result<f64, Failure> {
    let folder = std::env::temp_dir().join(format!("repose-bench-scoring-{}", uuid::Uuid::new_v4()));
    let rate = trained(&folder, threads, length);
    if let Err(error) = std::fs::remove_dir_all(&folder) {
        tracing::warn!(folder = %folder.display(), %error, "left behind");
    }
    rate
}

fn trained(folder: &Path, threads: usize, length: Duration) -> Result<f64, Failure> {
    let settings = GenerateSettings { threads, ..GenerateSettings::new(folder, Split::Train, TRAINING_SCENES) };
    generate(&settings, |_| true).map_err(Failure::other)?;
    let program = std::env::current_exe().map_err(Failure::other)?;
    let mut command = std::process::Command::new(program);
    command.args(["--json", "train", "--network", "discriminator", "--minutes", &(length.as_secs_f64() / 60.0).to_string()]);
    command.args(["--threads", &threads.to_string()]).arg("--data").arg(folder).arg("--out").arg(folder.join("weights.safetensors"));
    // Its progress is not this command's.
    let done = command.stderr(std::process::Stdio::null()).output().map_err(Failure::other)?;
    let report: Value =
        serde_json::from_slice(&done.stdout).map_err(|e| Failure::other(format!("train ended with {}: {e}", done.status)))?;
    report["samples_per_s"].as_f64().ok_or_else(|| Failure::other(format!("train said no samples_per_s: {report}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_document_has_the_contracts_keys() {
        let args = BenchScoringArgs { threads: Some(1), seconds: 0.02, training_seconds: 0.0 };
        run(&args, Output { json: false }).unwrap_or_else(|e| panic!("{e:?}"));
        let speed = ScoringSpeed {
            discriminator_per_s: [1.0, 2.0, 3.0],
            outcome_per_s: [4.0, 5.0, 6.0],
            points: 2048,
            relations_per_s: 4.0,
            prior_per_s: 5.0,
            matmul_share: 0.5,
            candidate_gflop: 0.6,
            matmul_gflops: 7.0,
            kernel: "plain-1",
            threads: 1,
        };
        let document = document(&speed, Some(20.0));
        assert_eq!(document["discriminator_per_s"], json!({"1": 1.0, "25": 2.0, "100": 3.0}));
        assert_eq!(document["outcome_per_s"], json!({"1": 4.0, "25": 5.0, "100": 6.0}));
        for key in ["relations_per_s", "prior_per_s", "matmul_share", "training_per_s"] {
            assert!(document[key].is_number(), "{key}");
        }
    }

    #[test]
    fn a_length_that_is_none_is_refused() {
        let args = BenchScoringArgs { threads: None, seconds: f64::NAN, training_seconds: 0.0 };
        assert_eq!(run(&args, Output { json: false }).expect_err("refused").exit_code(), 2);
    }
}
