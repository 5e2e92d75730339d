//! `repose evaluate world`: how the simulated world behaves.

use clap::Args;
use repose_dataset::Split;
use repose_evaluation::report;
use repose_evaluation::tables::world::{WorldReportSettings, world_report};
use repose_simulator::scene::{KindWeights, SceneKind};

use crate::failure::CommandResult;
use crate::output::Output;
use crate::progress::Progress;
use crate::values::{check_scenes, parse_count, parse_kind, parse_split, threads};

/// Arguments of `evaluate world`.
#[derive(Debug, Args)]
pub struct EvaluateWorldArgs {
    /// How many scenes.
    #[arg(long, default_value_t = 1000, value_parser = parse_count)]
    pub scenes: usize,
    /// Number of releases simulated at the usual physics step and at a quarter of it.
    #[arg(long, default_value_t = 200)]
    pub placements: usize,
    /// Only this kind of scene (open_table, large_box, clutter, stacking, shelf, drawer, kitchen, desk, pile). Default: the training mix.
    #[arg(long, value_parser = parse_kind)]
    pub kind: Option<SceneKind>,
    /// Which split's seeds: train, validation or test.
    #[arg(long, default_value = "validation", value_parser = parse_split)]
    pub split: Split,
    /// Threads. Default: one per core. Only times depend on it.
    #[arg(long)]
    pub threads: Option<usize>,
}

/// Runs the command.
pub fn run(args: &EvaluateWorldArgs, output: Output) -> CommandResult {
    // Releases are of scenes after those that are looked at.
    check_scenes(args.split, 0, args.scenes.saturating_add(args.placements) as u64)?;
    let mut settings =
        WorldReportSettings { split: args.split, scenes: args.scenes, placements: args.placements, ..WorldReportSettings::default() };
    if let Some(kind) = args.kind {
        settings.scene.kinds = KindWeights::only(kind);
    }
    let threads = threads(args.threads);
    let bar = Progress::new((args.scenes + args.placements) as u64, "scenes and releases");
    let world = world_report(&settings, threads, |done| bar.set(done as u64));
    bar.finish();
    output.print(&report::world::document(&world), || report::world::text_of(&world))
}
