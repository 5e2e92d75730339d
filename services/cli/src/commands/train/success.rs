//! `repose train --network success`: how likely placements of `best` succeed, from its own answers in training scenes.
//!
//! How good the fit is is told on scenes that it has not seen, part by part.

use std::path::Path;

use repose_evaluation::scenes::held_scenes::forecasts_of;
use repose_evaluation::scenes::success_samples::{FIRST_SEED, SceneAnswers};
use repose_evaluation::statistics::calibration::Calibration;
use repose_evaluation::statistics::correlation::area_under_curve;
use repose_evaluation::statistics::forecast_fit::{FitSample, FitSettings};
use repose_planner::learned::forecast::SUCCESS;
use repose_planner::learned::success::names;
use serde_json::json;

use super::tried::{FitArgs, MeasuredScene, fitted, other_length};
use super::with_forecasts;
use crate::embedded::engine;
use crate::failure::CommandResult;
use crate::output::Output;

/// Tries, fits, writes and reports.
pub fn run(args: &FitArgs<'_>, output: Output) -> CommandResult {
    let engine = engine(args.start.map(Path::to_owned))?;
    let forecasts = forecasts_of(&engine)?;
    let mut tried = args.scenes_in("answers.jsonl", FIRST_SEED);
    tried.outcome_hash = Some(engine.outcome_hash());
    let answers = tried.tried(|index| SceneAnswers::of(index, &engine, &forecasts))?;
    let scenes: Vec<Vec<FitSample>> =
        answers.values().filter(|scene| !scene.measures.is_empty()).map(|scene| scene.samples().collect()).collect();
    let fitted = fitted(&names(), &scenes, engine.outcome_hash(), &FitSettings::of_few(args.seed))?;
    let said_of_first: Vec<(f64, bool)> = fitted.held_out.iter().filter_map(|said| said.first().copied()).collect();
    let said = fitted.held_out.concat();
    with_forecasts(args.start, args.out, &[(SUCCESS, &fitted.forecast)])?;
    let (all, first) = (Calibration::of(&said, 1), Calibration::of(&said_of_first, 1));
    let right = said.iter().filter(|(_, right)| *right).count();
    let document = json!({
        "out": args.out, "scenes": scenes.len(), "answers": said.len(), "right": right,
        "area_held_out": area_under_curve(&said), "calibration_held_out": all, "calibration_of_first_held_out": first,
    });
    output.print(&document, || {
        let number = |value: Option<f64>| value.map_or_else(|| "undefined".to_owned(), |v| format!("{v:.3}"));
        format!(
            "{}: fitted on {} answers of {} scenes, {right} of them right\non scenes held out: area under the curve {}, calibration error {} \
             (floor {}), of first answers {} (floor {})",
            args.out.display(),
            said.len(),
            scenes.len(),
            number(area_under_curve(&said)),
            number(all.error),
            number(all.floor),
            number(first.error),
            number(first.floor)
        )
    })
}

impl MeasuredScene for SceneAnswers {
    fn seed(&self) -> u64 {
        self.seed
    }

    fn other_length(&self) -> Option<String> {
        other_length(names().len(), self.measures.iter())
    }

    fn outcome_hash(&self) -> Option<&str> {
        self.outcome_hash.as_deref()
    }
}
