//! `repose train --network standing`: whether objects stand by themselves, and whether their neighbours stay when they are taken away, from what
//! becomes of them in training scenes.
//!
//! How good the fits are is told on scenes that they have not seen, part by part.

use std::path::Path;

use repose_evaluation::scenes::standing_samples::{FIRST_SEED, SceneStances};
use repose_evaluation::statistics::calibration::Calibration;
use repose_evaluation::statistics::correlation::area_under_curve;
use repose_evaluation::statistics::forecast_fit::{FitSample, FitSettings};
use repose_planner::learned::forecast::{NEIGHBOUR_STAYS, STANDS};
use repose_planner::learned::{neighbours, standing};
use serde::Serialize;
use serde_json::json;

use super::made_with::of_beliefs;
use super::tried::{FitArgs, MeasuredScene, fitted, other_length};
use super::with_forecasts;
use crate::embedded::engine;
use crate::failure::{CommandResult, Failure};
use crate::output::Output;

/// Probabilities below which things are refused, to show what that would catch.
const THRESHOLDS: [f64; 4] = [0.1, 0.2, 0.3, 0.5];

/// Tries, fits, writes and reports.
pub fn run(args: &FitArgs<'_>, output: Output) -> CommandResult {
    let engine = engine(args.start.map(Path::to_owned))?;
    let made_with = of_beliefs(&[]);
    let tried = args.scenes_in("stances.jsonl", FIRST_SEED, &made_with);
    let stances = tried.tried(|index| Ok(SceneStances::of(index)))?;
    let fit = |names: &[&'static str], of: &dyn Fn(&SceneStances) -> Vec<FitSample>| {
        let scenes: Vec<Vec<FitSample>> = stances.values().map(of).filter(|samples| !samples.is_empty()).collect();
        let fitted = fitted(names, &scenes, engine.outcome_hash(), &FitSettings::of_objects(args.seed))?;
        Ok::<_, Failure>((fitted.forecast, HeldOut::of(&fitted.held_out.concat())))
    };
    let (stands, of_stands) = fit(&standing::names(), &SceneStances::samples)?;
    let (stays, of_stays) = fit(&neighbours::names(), &SceneStances::neighbour_samples)?;
    with_forecasts(args.start, args.out, &[(STANDS, &stands), (NEIGHBOUR_STAYS, &stays)])?;
    let document = json!({ "out": args.out, "scenes": stances.len(), STANDS: of_stands, NEIGHBOUR_STAYS: of_stays });
    output.print(&document, || {
        let head = format!("{}: fitted on {} scenes, figures of scenes held out", args.out.display(), stances.len());
        [head, of_stands.text("objects that stand by themselves"), of_stays.text("neighbours that stay")].join("\n")
    })
}

/// How good a fit is, on scenes that it has not seen.
#[derive(Debug, Clone, Serialize)]
struct HeldOut {
    /// Samples.
    samples: usize,
    /// Those that did not come true.
    failures: usize,
    /// The area under the curve.
    area: Option<f64>,
    /// The reliability diagram.
    calibration: Calibration,
    /// For each of [`THRESHOLDS`]: how many of the failures are below it, and how many others.
    below: [(f64, usize, usize); THRESHOLDS.len()],
}

impl HeldOut {
    fn of(said: &[(f64, bool)]) -> Self {
        let below = |threshold: f64, came_true: bool| said.iter().filter(|(p, true_)| *p < threshold && *true_ == came_true).count();
        Self {
            samples: said.len(),
            failures: said.iter().filter(|(_, came_true)| !came_true).count(),
            area: area_under_curve(said),
            calibration: Calibration::of(said, 1),
            below: THRESHOLDS.map(|threshold| (threshold, below(threshold, false), below(threshold, true))),
        }
    }

    fn text(&self, what: &str) -> String {
        let number = |value: Option<f64>| value.map_or_else(|| "undefined".to_owned(), |v| format!("{v:.3}"));
        let below = self.below.map(|(threshold, failures, others)| format!("{failures} and {others} others below {threshold}"));
        format!(
            "{what}: all but {} of {}; area under the curve {}, calibration error {} (floor {}); of those that do not {}",
            self.failures,
            self.samples,
            number(self.area),
            number(self.calibration.error),
            number(self.calibration.floor),
            below.join(", ")
        )
    }
}

impl MeasuredScene for SceneStances {
    fn seed(&self) -> u64 {
        self.seed
    }

    fn other_length(&self) -> Option<String> {
        let of_objects = other_length(standing::names().len(), self.stands.iter().map(|(measures, _)| measures));
        of_objects.or_else(|| other_length(neighbours::names().len(), self.stays.iter().map(|(measures, _)| measures)))
    }
}
