//! `repose train --network back`: how far objects go on behind what was seen of them, from training scenes in which that is known.
//!
//! How good the fit is is told on scenes that it has not seen, part by part.

use repose_belief::back::{Back, FittedOn};
use repose_evaluation::scenes::back_samples::{FIRST_SEED, SceneBacks};
use repose_evaluation::statistics::forecast_fit::{FitSettings, fit_lengths};
use repose_evaluation::statistics::quantile::Sorted;
use serde_json::json;

use super::tried::{FitArgs, Scenes, TriedScene, other_length};
use crate::failure::{Failure, Outcome};
use crate::output::Output;

/// In so many parts the scenes are held out in turn, to tell how good the fit is.
const FOLDS: usize = 8;

/// Tries, fits, writes and reports.
pub fn run(args: &FitArgs<'_>, output: Output) -> Outcome {
    if args.start.is_some() {
        return Err(Failure::bad_input("start", "only weights of networks start from others"));
    }
    let tried = Scenes {
        data: args.data,
        file: "backs.jsonl",
        first_seed: FIRST_SEED,
        first: args.first,
        count: args.scenes,
        threads: args.threads,
    };
    let scenes: Vec<SceneBacks> = tried.tried(|index| Ok(SceneBacks::of(index)))?.into_values().collect();
    let fit = |keep: &dyn Fn(usize) -> bool| {
        let kept = scenes.iter().enumerate().filter(|(i, _)| keep(*i)).flat_map(|(_, scene)| scene.objects.clone());
        let objects: Vec<(Vec<f32>, f64)> = kept.map(|(measures, missing_m)| (measures, Back::target(missing_m))).collect();
        let trees = fit_lengths(&objects, &FitSettings::of_lengths(args.seed)).map_err(|e| Failure::bad_input("data", e))?;
        Back::new(trees, FittedOn { scenes: scenes.len(), objects: objects.len() }).map_err(Failure::other)
    };
    let mut errors = Vec::new();
    let mut beyond = 0;
    for fold in 0..FOLDS {
        let back = fit(&|i| i % FOLDS != fold)?;
        for (measures, missing_m) in scenes.iter().skip(fold).step_by(FOLDS).flat_map(|scene| &scene.objects) {
            let said_m = back.missing_m(measures);
            errors.push(f64::from((said_m - missing_m) * 1e3));
            beyond += usize::from(*missing_m > said_m * 1.9 + 0.005);
        }
    }
    let whole = fit(&|_| true)?;
    let text = serde_json::to_string(&whole).map_err(Failure::other)?;
    repose_dataset::write_whole(args.out, text.as_bytes())
        .map_err(|e| Failure::bad_input("out", format!("{}: {e}", args.out.display())))?;
    let sizes: Sorted = errors.iter().map(|e| e.abs()).collect();
    let objects = errors.len();
    let middle = Sorted::new(errors);
    let [bias, p50, p90] = [middle.at_or_nan(0.5), sizes.at_or_nan(0.5), sizes.at_or_nan(0.9)];
    let beyond = beyond as f64 / objects.max(1) as f64;
    let document = json!({
        "out": args.out, "scenes": scenes.len(), "objects": objects,
        "held_out": {"middle_mm": bias, "p50_mm": p50, "p90_mm": p90, "beyond_doubt": beyond},
    });
    output.print(&document, || {
        format!(
            "{}: fitted on {objects} objects of {} scenes; on scenes held out off by {bias:+.1} mm (median), by {p50:.1} mm or less in half of \
             them and {p90:.1} mm in nine of ten; {:.1} % go on farther than is held to be possible",
            args.out.display(),
            scenes.len(),
            beyond * 100.0
        )
    })
}

impl TriedScene for SceneBacks {
    fn seed(&self) -> u64 {
        self.seed
    }

    fn other_length(&self) -> Option<String> {
        other_length(repose_belief::back::MEASURES.len(), self.objects.iter().map(|(measures, _)| measures))
    }
}
