//! `repose generate`: simulated scenes to train on.

use indicatif::{ProgressBar, ProgressStyle};
use repose_dataset::Split;
use repose_proto::Relation;
use repose_simulator::generate::{GenerateSettings, generate};

use crate::args::GenerateArgs;
use crate::failure::{Failure, Outcome};
use crate::output::Output;

/// How often each relation held in the paper's evaluation set, percent, in wire order (its Table 2; `aligned` was left out).
const PAPER_PERCENT: [Option<f64>; 10] =
    [Some(13.9), Some(14.0), Some(4.6), Some(5.0), Some(4.3), Some(4.3), Some(29.0), Some(12.7), Some(5.6), None];

/// The split of that name.
pub fn split_of(name: &str) -> Result<Split, Failure> {
    let known = || Split::ALL.map(Split::name).join(", ");
    Split::ALL
        .into_iter()
        .find(|s| s.name() == name)
        .ok_or_else(|| Failure::bad_input("split", format!("expected one of {}, got {name:?}", known())))
}

/// Runs the command.
pub fn run(args: &GenerateArgs, output: Output) -> Outcome {
    let mut settings = GenerateSettings::new(&args.out, split_of(&args.split)?, args.scenes as u64);
    settings.views = args.views as u32;
    if let Some(threads) = args.threads {
        settings.threads = threads;
    }
    let bar = ProgressBar::new(args.scenes as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} scenes, {per_sec}, {eta} left {msg}") {
        bar.set_style(style);
    }
    let started = std::time::Instant::now();
    let made = generate(&settings, |so_far| {
        bar.set_position((so_far.scenes + so_far.skipped) as u64);
        true
    });
    let made = made.map_err(|e| Failure::bad_input(&args.out.display().to_string(), e))?;
    bar.finish_and_clear();
    let scenes_per_s = made.scenes as f64 / started.elapsed().as_secs_f64();
    let percent = made.prevalence_percent();
    let prevalence: serde_json::Map<_, _> = Relation::ALL.iter().map(|r| (r.as_str().to_owned(), percent[r.index()].into())).collect();
    let document = serde_json::json!({
        "scenes": made.scenes, "skipped": made.skipped, "views": made.views, "scenes_per_s": scenes_per_s,
        "rejected": made.rejected, "failed": made.failed, "prevalence": prevalence,
    });
    output.print(&document, || {
        let mut text = format!(
            "{} scenes ({} were there), {} views, {scenes_per_s:.1} scenes/s, {} draws rejected, {} seeds given up",
            made.scenes, made.skipped, made.views, made.rejected, made.failed
        );
        for relation in Relation::ALL {
            let paper = PAPER_PERCENT[relation.index()].map_or("-".to_owned(), |p| format!("{p:.1}"));
            text += &format!("\n  {:<12} {:>5.1} %   paper {paper:>5}", relation.as_str(), percent[relation.index()]);
        }
        text
    })
}
