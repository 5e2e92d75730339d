//! `repose train --network back`: how far objects go on behind what was seen of them, from training scenes in which that is known.
//!
//! How good the fit is is told on scenes that it has not seen, part by part.

use repose_belief::BeliefSettings;
use repose_belief::back::{Back, BackFitData};
use repose_belief::boosted_trees::log_of_length;
use repose_evaluation::scenes::back_samples::{FIRST_SEED, SceneBacks};
use repose_evaluation::scenes::believed::DOUBT_SLACK_M;
use repose_evaluation::statistics::forecast_fit::{FitSettings, fit_lengths};
use repose_evaluation::statistics::quantile::Sorted;
use serde_json::json;

use super::BACK;
use super::made_with::of_beliefs;
use super::tried::{FitArgs, MeasuredScene, held_out, other_length};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;

/// Tries, fits, writes and reports.
pub fn run(args: &FitArgs<'_>, output: Output) -> CommandResult {
    args.refuse_start()?;
    let made_with = of_beliefs(&[BACK]);
    let tried = args.scenes_in("backs.jsonl", FIRST_SEED, &made_with);
    let scenes: Vec<SceneBacks> = tried.tried(|index| Ok(SceneBacks::of(index)))?.into_values().collect();
    let fit = |learned: &[&SceneBacks]| {
        let seen = learned.iter().flat_map(|scene| &scene.objects);
        let objects: Vec<(Vec<f32>, f64)> = seen.map(|(measures, missing_m)| (measures.clone(), log_of_length(*missing_m))).collect();
        let trees = fit_lengths(&objects, &FitSettings::of_lengths(args.seed)).map_err(|e| Failure::bad_input("data", e))?;
        Back::new(trees, BackFitData { scenes: scenes.len(), objects: objects.len() }).map_err(Failure::other)
    };
    let said = |back: &Back, scene: &SceneBacks| scene.objects.iter().map(|(m, missing_m)| (back.missing_m(m), *missing_m)).collect();
    let said: Vec<(f32, f32)> = held_out(&scenes, fit, said)?.concat();
    let shape = BeliefSettings::default().shape;
    let is_beyond = |(said_m, missing_m): &&(f32, f32)| *missing_m > said_m + shape.doubt_m(*said_m) + DOUBT_SLACK_M;
    let beyond = said.iter().filter(is_beyond).count();
    let errors: Vec<f64> = said.iter().map(|(said_m, missing_m)| f64::from((said_m - missing_m) * 1e3)).collect();
    let whole = fit(&scenes.iter().collect::<Vec<_>>())?;
    args.write(&whole)?;
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

impl MeasuredScene for SceneBacks {
    fn seed(&self) -> u64 {
        self.seed
    }

    fn other_length(&self) -> Option<String> {
        other_length(repose_belief::back::MEASURES.len(), self.objects.iter().map(|(measures, _)| measures))
    }
}
