//! `repose train --network bearing`: which objects bear which, from training scenes in which that is known.
//!
//! How good the fit is is told on scenes that it has not seen, part by part.

use repose_belief::bearing::{Bearing, BearingFitData};
use repose_evaluation::scenes::bearing_samples::{FIRST_SEED, SceneBearings};
use repose_evaluation::statistics::correlation::area_under_curve;
use repose_evaluation::statistics::forecast_fit::{FitSample, FitSettings, fit_log_odds};
use repose_evaluation::statistics::rate::Rate;
use serde_json::json;

use super::BEARING;
use super::made_with::of_beliefs;
use super::tried::{FitArgs, MeasuredScene, held_out, other_length};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;

/// Probabilities from which on one is held to bear the other, to show what that would catch.
const THRESHOLDS: [f64; 6] = [0.3, 0.5, 0.6, 0.7, 0.8, 0.9];

/// Tries, fits, writes and reports.
pub fn run(args: &FitArgs<'_>, output: Output) -> CommandResult {
    args.refuse_start()?;
    let made_with = of_beliefs(&[BEARING]);
    let tried = args.scenes_in("bearings.jsonl", FIRST_SEED, &made_with);
    let scenes: Vec<SceneBearings> = tried.tried(|index| Ok(SceneBearings::of(index)))?.into_values().collect();
    let fit = |learned: &[&SceneBearings]| {
        let pairs: Vec<FitSample> = learned.iter().flat_map(|scene| scene.samples()).collect();
        let borne = pairs.iter().filter(|pair| pair.came_true).count();
        let trees = fit_log_odds(&pairs, &FitSettings::of_objects(args.seed)).map_err(|e| Failure::bad_input("data", e))?;
        Bearing::new(trees, BearingFitData { scenes: learned.len(), pairs: pairs.len(), borne }).map_err(Failure::other)
    };
    let said = |bearing: &Bearing, scene: &SceneBearings| scene.pairs.iter().map(|(m, bears)| (bearing.probability(m), *bears)).collect();
    let said: Vec<(f64, bool)> = held_out(&scenes, fit, said)?.concat();
    let whole = fit(&scenes.iter().collect::<Vec<_>>())?;
    args.write(&whole)?;
    let area = area_under_curve(&said);
    let at = THRESHOLDS.map(|threshold| {
        let recall: Rate = said.iter().filter(|(_, bears)| *bears).map(|(p, _)| *p >= threshold).collect();
        let precision: Rate = said.iter().filter(|(p, _)| *p >= threshold).map(|(_, bears)| *bears).collect();
        (threshold, recall, precision)
    });
    let rates = at.map(|(threshold, recall, precision)| json!({"from": threshold, "recall": recall, "precision": precision}));
    let document = json!({"out": args.out, "scenes": scenes.len(), "pairs": said.len(), "held_out": {"area": area, "rates": rates}});
    output.print(&document, || {
        let head = format!(
            "{}: fitted on {} pairs of {} scenes; on scenes held out the area under the curve is {:.3}",
            args.out.display(),
            said.len(),
            scenes.len(),
            area.unwrap_or(f64::NAN)
        );
        let rates = at.map(|(threshold, recall, precision)| format!("from {threshold}: recall {recall}, precision {precision}"));
        [head].into_iter().chain(rates).collect::<Vec<_>>().join("\n")
    })
}

impl MeasuredScene for SceneBearings {
    fn seed(&self) -> u64 {
        self.seed
    }

    fn other_length(&self) -> Option<String> {
        other_length(repose_belief::bearing::MEASURES.len(), self.pairs.iter().map(|(measures, _)| measures))
    }
}
