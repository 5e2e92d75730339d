//! `repose bench`: how fast a part is on this machine.

mod motion;
mod perception;
mod planner;
mod scoring;

use clap::{Args, Subcommand};

use crate::failure::Outcome;
use crate::output::Output;

/// Arguments of `bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// Which part.
    #[command(subcommand)]
    pub part: Part,
}

/// The benchmarks.
#[derive(Debug, Subcommand)]
pub enum Part {
    /// The arm's path planning on a file of problems in known worlds.
    Motion(motion::BenchMotionArgs),
    /// Perception: from a frame in memory to its scene, segmentation included.
    Perception(perception::BenchPerceptionArgs),
    /// Placement planning, in this process and through the services.
    Planner(planner::BenchPlannerArgs),
    /// The networks: candidates, relations and priors a second, and training samples.
    Scoring(scoring::BenchScoringArgs),
}

/// Runs the command.
pub fn run(args: &BenchArgs, output: Output) -> Outcome {
    match &args.part {
        Part::Motion(args) => motion::run(args, output),
        Part::Perception(args) => perception::run(args, output),
        Part::Planner(args) => planner::run(args, output),
        Part::Scoring(args) => scoring::run(args, output),
    }
}
