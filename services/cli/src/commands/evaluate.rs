//! `repose evaluate`: the paper's tables.

use crate::args::{EvaluateArgs, Table};
use crate::failure::Outcome;
use crate::output::Output;

/// Runs the command.
pub fn run(args: &EvaluateArgs, output: Output) -> Outcome {
    match &args.table {
        Table::Planner(args) => super::evaluate_planner::run(args, output),
        Table::World(args) => super::evaluate_world::run(args, output),
        Table::Relations(args) => super::evaluate_relations::run(args, output),
        Table::Discriminator(args) => super::evaluate_discriminator::run(args, output),
        Table::Segmentation(args) => super::evaluate_segmentation::run(args, output),
        Table::Robot(args) => super::evaluate_robot::run(args, output),
    }
}
