//! `repose bench`: how fast a part is on this machine.

mod motion;
mod perception;
mod planner;
mod scoring;

use clap::{Args, Subcommand};

use crate::failure::CommandResult;
use crate::output::Output;

/// Arguments of `bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// Which part.
    #[command(subcommand)]
    pub part: Benchmark,
}

/// The benchmarks.
#[derive(Debug, Subcommand)]
pub enum Benchmark {
    /// Path planning of the arm, on a file of problems with known obstacles.
    Motion(motion::BenchMotionArgs),
    /// Perception: from a frame in memory to its scene, segmentation included.
    Perception(perception::BenchPerceptionArgs),
    /// Placement planning, in this process and through the services.
    Planner(planner::BenchPlannerArgs),
    /// The networks: candidates, relations and priors a second, and training samples.
    Scoring(scoring::BenchScoringArgs),
}

/// Runs the command.
pub fn run(args: &BenchArgs, output: Output) -> CommandResult {
    match &args.part {
        Benchmark::Motion(args) => motion::run(args, output),
        Benchmark::Perception(args) => perception::run(args, output),
        Benchmark::Planner(args) => planner::run(args, output),
        Benchmark::Scoring(args) => scoring::run(args, output),
    }
}
