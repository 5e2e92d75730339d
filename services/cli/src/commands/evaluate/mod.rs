//! `repose evaluate`: the paper's tables.

mod arrange;
mod belief;
mod discriminator;
mod planner;
mod relations;
mod robot;
mod segmentation;
mod shared;
mod world;

use clap::{Args, Subcommand};

use crate::failure::CommandResult;
use crate::output::Output;

/// Arguments of `evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Which table.
    #[command(subcommand)]
    pub table: EvaluationTable,
}

/// The tables.
#[derive(Debug, Subcommand)]
pub enum EvaluationTable {
    /// Placement success of the planner's variants, on held-out simulated scenes (the paper's Table 1).
    Planner(planner::EvaluatePlannerArgs),
    /// Accuracy of the relations, learned and by rule, on held-out simulated scenes (the paper's Table 2).
    Relations(relations::EvaluateRelationsArgs),
    /// Accuracy of shapes completed from one camera's view.
    Belief(belief::EvaluateBeliefArgs),
    /// Success of arrangements, on generated tasks with a known solution.
    Arrange(arrange::EvaluateArrangeArgs),
    /// Realism scores against simulated outcomes, on held-out kitchen scenes.
    Discriminator(discriminator::EvaluateDiscriminatorArgs),
    /// Quality of the simulated scenes: rejected draws, rest, overlaps, and whether releases depend on the physics step.
    World(world::EvaluateWorldArgs),
    /// Accuracy of perception's masks on labelled frames.
    Segmentation(segmentation::EvaluateSegmentationArgs),
    /// Success of pick and place with the simulated Panda and named objects (the paper's Table 3).
    Robot(robot::EvaluateRobotArgs),
}

/// Runs the command.
pub fn run(args: &EvaluateArgs, output: Output) -> CommandResult {
    match &args.table {
        EvaluationTable::Planner(args) => planner::run(args, output),
        EvaluationTable::Belief(args) => belief::run(args, output),
        EvaluationTable::Arrange(args) => arrange::run(args, output),
        EvaluationTable::World(args) => world::run(args, output),
        EvaluationTable::Relations(args) => relations::run(args, output),
        EvaluationTable::Discriminator(args) => discriminator::run(args, output),
        EvaluationTable::Segmentation(args) => segmentation::run(args, output),
        EvaluationTable::Robot(args) => robot::run(args, output),
    }
}
