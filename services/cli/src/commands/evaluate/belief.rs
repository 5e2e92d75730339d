//! `repose evaluate belief`: what is believed of objects that one camera saw, against what they are.

use std::path::PathBuf;

use clap::Args;
use repose_belief::BeliefSettings;
use repose_dataset::Split;
use repose_evaluation::report;
use repose_evaluation::scenes::problem::ProblemSettings;
use repose_evaluation::tables::belief::{BeliefTableSettings, belief_table};
use repose_simulator::scene::SceneKind;

use super::shared::only_meshes;
use crate::failure::CommandResult;
use crate::output::Output;
use crate::progress::Progress;
use crate::values::{check_scenes, distinct_or, parse_count, parse_kind, parse_split, threads};

/// Arguments of `evaluate belief`.
#[derive(Debug, Args)]
pub struct EvaluateBeliefArgs {
    /// Scenes of each kind.
    #[arg(long, default_value_t = 40, value_parser = parse_count)]
    pub scenes: usize,
    /// The first scene of each kind, counted from the split's first seed.
    #[arg(long, default_value_t = 0)]
    pub first: u64,
    /// Only this kind of scene (open_table, large_box, clutter, stacking, shelf, drawer, kitchen, desk, pile); repeat for more. Default: all.
    #[arg(long = "kind", value_parser = parse_kind)]
    pub kinds: Vec<SceneKind>,
    /// A folder of held-out meshes to make the scenes from.
    #[arg(long, value_name = "DIR")]
    pub objects: Option<PathBuf>,
    /// Masks that perception finds, named after the objects that they match, instead of the true ones.
    #[arg(long)]
    pub found_masks: bool,
    /// Shapes that the network completes, in place of those of the rules.
    #[arg(long)]
    pub learned_shapes: bool,
    /// Which split's seeds: train, validation or test.
    #[arg(long, default_value = "validation", value_parser = parse_split)]
    pub split: Split,
    /// Threads. Default: one per core. Only times depend on it.
    #[arg(long)]
    pub threads: Option<usize>,
}

/// Runs the command.
pub fn run(args: &EvaluateBeliefArgs, output: Output) -> CommandResult {
    check_scenes(args.split, args.first, args.scenes as u64)?;
    let mut problem = ProblemSettings::default();
    if let Some(folder) = &args.objects {
        only_meshes(&mut problem.scene, folder)?;
    }
    let kinds = distinct_or(&args.kinds, &SceneKind::ALL);
    let settings = BeliefTableSettings {
        problem,
        kinds,
        split: args.split,
        first: args.first,
        scenes: args.scenes,
        masks_found: args.found_masks,
        belief: BeliefSettings::of_shapes(args.learned_shapes),
        threads: threads(args.threads),
    };
    let bar = Progress::new((settings.kinds.len() * settings.scenes) as u64, "scenes");
    let table = belief_table(&settings, |done| bar.set(done as u64));
    bar.finish();
    output.print(&table, || report::belief::text_of(&table))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    type Line = crate::testing::Line<EvaluateBeliefArgs>;

    #[test]
    fn scenes_of_another_split_are_refused() {
        for first in ["1000000000", "18446744073709551615"] {
            let line = ["x", "--scenes", "1", "--kind", "large_box", "--split", "validation", "--first", first];
            let refused = run(&Line::parse_from(line).args, Output { json: false }).expect_err("there are no such scenes");
            assert_eq!((refused.exit_code(), refused.error().and_then(|e| e.field.as_deref())), (2, Some("first")));
        }
    }
}
