//! `repose bench`: how fast a part is on this machine.

use clap::{Args, Subcommand};

use crate::commands::bench_motion::{self, BenchMotionArgs};
use crate::commands::bench_perception::{self, BenchPerceptionArgs};
use crate::commands::bench_planner::{self, BenchPlannerArgs};
use crate::commands::bench_scoring::{self, BenchScoringArgs};
use crate::failure::Outcome;
use crate::output::Output;

/// Arguments of `bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// Which part.
    #[command(subcommand)]
    pub part: Part,
}

/// The parts.
#[derive(Debug, Subcommand)]
pub enum Part {
    /// The arm's path planning on a file of problems in known worlds.
    Motion(BenchMotionArgs),
    /// A frame in memory to its scene, segmentation included.
    Perception(BenchPerceptionArgs),
    /// A placement, in this process and through the services.
    Planner(BenchPlannerArgs),
    /// The networks: candidates, relations and priors a second, and training samples.
    Scoring(BenchScoringArgs),
}

/// Runs the command.
pub fn run(args: &BenchArgs, output: Output) -> Outcome {
    match &args.part {
        Part::Motion(args) => bench_motion::run(args, output),
        Part::Perception(args) => bench_perception::run(args, output),
        Part::Planner(args) => bench_planner::run(args, output),
        Part::Scoring(args) => bench_scoring::run(args, output),
    }
}

/// The value below which a share of sorted values lies; NaN (null in JSON) without values.
pub fn at(sorted: &[f64], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted.get((last as f64 * share).round() as usize).copied().unwrap_or(f64::NAN)
}
