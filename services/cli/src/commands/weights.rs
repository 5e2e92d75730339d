//! `repose weights`: parts that were trained apart, put into one file.

use std::path::{Path, PathBuf};

use clap::Args;
use repose_networks::Weights;
use repose_training::{TrainedPart, merge::merged};
use serde_json::json;

use crate::failure::{CommandResult, Failure};
use crate::output::Output;

/// Arguments of `weights`.
#[derive(Debug, Args)]
pub struct WeightsArgs {
    /// Weights to take the encoders, relation predictor and prior from.
    #[arg(long, value_name = "FILE")]
    pub joint: PathBuf,
    /// Weights to take the relation predictor from instead of `--joint`; it must have been trained on the same encoders.
    #[arg(long, value_name = "FILE")]
    pub relations: Option<PathBuf>,
    /// Weights to take the discriminator from.
    #[arg(long, value_name = "FILE")]
    pub discriminator: PathBuf,
    /// Weights to take the outcome network from. Default: the result has none.
    #[arg(long, value_name = "FILE")]
    pub outcome: Option<PathBuf>,
    /// The weights file to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// Runs the command.
pub fn run(args: &WeightsArgs, output: Output) -> CommandResult {
    let read = |field: &str, path: &Path| {
        let failed = |e: &dyn std::fmt::Display| Failure::bad_input(field, format!("{}: {e}", path.display()));
        Weights::from_bytes(&std::fs::read(path).map_err(|e| failed(&e))?).map_err(|e| failed(&e))
    };
    let mut parts =
        vec![(TrainedPart::Joint, read("joint", &args.joint)?), (TrainedPart::Discriminator, read("discriminator", &args.discriminator)?)];
    for (part, path) in [(TrainedPart::Relations, &args.relations), (TrainedPart::Outcome, &args.outcome)] {
        if let Some(path) = path {
            parts.push((part, read(part.name(), path)?));
        }
    }
    let bytes = merged(&parts).map_err(|e| Failure::bad_input("weights", e))?;
    repose_dataset::write_whole(&args.out, &bytes).map_err(|e| Failure::bad_input("out", format!("{}: {e}", args.out.display())))?;
    let hash = Weights::from_bytes(&bytes).map_err(Failure::other)?.hash;
    let document = json!({"weights": args.out, "hash": hash, "bytes": bytes.len()});
    output.print(&document, || format!("{}: {} bytes, {hash}", args.out.display(), bytes.len()))
}
