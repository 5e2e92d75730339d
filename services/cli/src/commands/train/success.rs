//! `repose train --network success`: how likely placements of `best` succeed, from its own answers in training scenes.
//!
//! How good the fit is is told on scenes that it has not seen, part by part.

use std::path::Path;
use std::sync::Arc;

use repose_evaluation::scenes::success_samples::{FIRST_SEED, SceneAnswers};
use repose_evaluation::statistics::calibration::Calibration;
use repose_evaluation::statistics::correlation::area_under_curve;
use repose_evaluation::statistics::forecast_fit::{FitSample, FitSettings};
use repose_planner::Forecasts;
use repose_planner::learned::forecast::SUCCESS;
use repose_planner::learned::success::names;
use serde_json::json;

use super::made_with::of_weights;
use super::tried::{FitArgs, MeasuredScene, fitted, other_length};
use super::{weights_of, with_forecasts};
use crate::embedded::engine;
use crate::failure::CommandResult;
use crate::output::Output;

/// Tries, fits, writes and reports.
pub fn run(args: &FitArgs<'_>, output: Output) -> CommandResult {
    let engine = engine(args.start.map(Path::to_owned))?;
    // The answers that are learned from are ranked without the forecast that is fitted: what they were made with leaves it out, and one of another
    // version of the program need not be read.
    let mut others = engine.forecasts().forecasts;
    others.remove(SUCCESS);
    let forecasts = Forecasts::read(&others).map(Arc::new)?;
    let made_with = of_weights(&weights_of(args.start)?, &[SUCCESS]);
    let answers = args.scenes_in("answers.jsonl", FIRST_SEED, &made_with).tried(|index| SceneAnswers::of(index, &engine, &forecasts))?;
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
}

#[cfg(test)]
mod tests {
    use repose_networks::Weights;
    use repose_planner::learned::forecast::STANDS;

    use super::*;

    #[test]
    fn answers_chosen_with_another_forecast_are_refused_though_the_outcome_network_is_the_same() {
        let folder = tempfile::tempdir().expect("a folder");
        let [start, out] = ["start.safetensors", "out.safetensors"].map(|name| folder.path().join(name));
        let own = Weights::embedded().expect("the program's weights");
        let mut other = own.clone();
        other.info.forecasts.get_mut(STANDS).expect("the program's weights have it")["logit"]["bias"] = json!(0.25);
        std::fs::write(&start, Weights::to_bytes(&other.values, &other.info).expect("weights")).expect("written");
        let scene = SceneAnswers { seed: FIRST_SEED, measures: Vec::new(), succeeded: Vec::new() };
        let row = json!({"made_with": of_weights(&own, &[SUCCESS]), "scene": scene});
        std::fs::write(folder.path().join("answers.jsonl"), format!("{row}\n")).expect("written");
        let args = FitArgs { data: folder.path(), start: Some(&start), out: &out, first: 0, scenes: 0, threads: 1, seed: 1 };
        let refused = run(&args, Output { json: false }).expect_err("other forecasts");
        assert_eq!((refused.exit_code(), refused.error().and_then(|e| e.field.as_deref())), (2, Some("data")));
        assert!(refused.into_error().message.contains("answers.jsonl: its scenes were measured with"));
        assert!(!out.exists());
    }

    #[test]
    fn the_forecast_that_is_fitted_anew_may_be_of_another_version() {
        let folder = tempfile::tempdir().expect("a folder");
        let [start, out] = ["start.safetensors", "out.safetensors"].map(|name| folder.path().join(name));
        let mut older = Weights::embedded().expect("the program's weights");
        let success = older.info.forecasts.get_mut(SUCCESS).expect("the program's weights have it");
        success["measures"].as_array_mut().expect("names").pop();
        std::fs::write(&start, Weights::to_bytes(&older.values, &older.info).expect("weights")).expect("written");
        let args = FitArgs { data: folder.path(), start: Some(&start), out: &out, first: 0, scenes: 0, threads: 1, seed: 1 };
        let failed = run(&args, Output { json: false }).expect_err("there is nothing to learn from").into_error();
        assert!(failed.field.as_deref() == Some("data") && failed.message.contains("samples"), "{failed:?}");
    }
}
