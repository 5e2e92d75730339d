//! `repose evaluate world`: how the simulated world behaves.

use std::collections::BTreeMap;

use clap::Args;
use comfy_table::Table;
use indicatif::{ProgressBar, ProgressStyle};
use repose_evaluation::world::Spread;
use repose_evaluation::{WorldReport, WorldReportSettings, world_report};
use repose_simulator::scene::{KindWeights, SceneKind};

use crate::commands::evaluate_scenes::threads;
use crate::commands::generate::{parse_kind, split_of};
use crate::failure::Outcome;
use crate::output::Output;

/// Arguments of `evaluate world`.
#[derive(Debug, Args)]
pub struct EvaluateWorldArgs {
    /// How many scenes.
    #[arg(long, default_value_t = 1000)]
    pub scenes: usize,
    /// How many releases are simulated at the usual step and at a quarter of it.
    #[arg(long, default_value_t = 200)]
    pub placements: usize,
    /// Only this kind of scene (open_table, large_box, clutter, stacking, shelf, drawer, kitchen); the training mix by default.
    #[arg(long, value_parser = parse_kind)]
    pub kind: Option<SceneKind>,
    /// Which split's seeds: train, validation or test.
    #[arg(long, default_value = "validation")]
    pub split: String,
    /// Threads; all cores by default. Only times depend on it.
    #[arg(long)]
    pub threads: Option<usize>,
}

/// Runs the command.
pub fn run(args: &EvaluateWorldArgs, output: Output) -> Outcome {
    let mut settings = WorldReportSettings {
        split: split_of(&args.split)?,
        scenes: args.scenes,
        placements: args.placements,
        ..WorldReportSettings::default()
    };
    if let Some(kind) = args.kind {
        settings.scene.kinds = KindWeights::only(kind);
    }
    let threads = threads(args.threads);
    let bar = ProgressBar::new((args.scenes + args.placements) as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} scenes and releases, {eta} left") {
        bar.set_style(style);
    }
    let report = world_report(&settings, threads, |done| bar.set_position(done as u64));
    bar.finish_and_clear();
    let by_kind: BTreeMap<&str, f64> = report.kinds.iter().map(|(kind, row)| (kind.name(), row.rejected_percent_of_draws())).collect();
    let document = serde_json::json!({
        "scenes": report.scenes,
        "failed": report.failed,
        "scenes_per_s": report.scenes_per_s,
        "rejected_percent": {
            "by_reason": report.rejected_percent,
            "by_kind": by_kind,
        },
        "kinds": report.kinds,
        "penetration_mm": report.penetration_mm,
        "residual_mm": report.residual_mm,
        "release_agreement_percent": report.releases.agreement_percent(),
        "placements": report.releases.placements,
        "releases": report.releases,
    });
    output.print(&document, || text_of(&report))
}

fn text_of(report: &WorldReport) -> String {
    let mut table = Table::new();
    let reasons: Vec<&str> = report.rejected_percent.keys().copied().collect();
    let mut header = vec!["kind", "scenes", "objects", "ms", "rejected %"];
    header.extend(&reasons);
    table.set_header(header);
    for (kind, row) in &report.kinds {
        let mut cells = vec![
            kind.name().to_owned(),
            row.scenes.to_string(),
            format!("{:.1}", row.objects),
            format!("{:.0}", row.mean_ms),
            format!("{:.1}", row.rejected_percent_of_draws()),
        ];
        cells.extend(reasons.iter().map(|reason| format!("{:.1}", row.rejected_percent.get(reason).copied().unwrap_or(0.0))));
        table.add_row(cells);
    }
    let spread = |name: &str, s: &Spread| format!("{name}: median {:.2}, 99 % {:.2}, most {:.2} mm", s.p50, s.p99, s.max);
    let releases = &report.releases;
    format!(
        "{} scenes ({} seeds gave none), {:.1} scenes/s settled\n{table}\n{}\n{}\nreleases: {:.1} % of {} the same at a quarter of the step ({} stable, {} not, {} only at the usual step, {} only at the finer)",
        report.scenes,
        report.failed,
        report.scenes_per_s,
        spread("deepest overlap", &report.penetration_mm),
        spread("motion in a further second", &report.residual_mm),
        releases.agreement_percent(),
        releases.placements,
        releases.both_stable,
        releases.both_unstable,
        releases.only_usual_stable,
        releases.only_finer_stable
    )
}
