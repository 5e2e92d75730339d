//! `repose train --network farther`: how likely objects go on farther than is believed, from training scenes in which that is known.
//!
//! How good the fit is is told on scenes that it has not seen, step by step: how often it comes true, and how true what is said of that is.

use repose_belief::farther::{ENDS, Farther, FartherFitData};
use repose_belief::unseen_end::STEPS_M;
use repose_evaluation::scenes::farther_samples::{FIRST_SEED, SceneEnds};
use repose_evaluation::statistics::calibration::Calibration;
use repose_evaluation::statistics::forecast_fit::{FitSample, FitSettings, fit_log_odds};
use serde::Serialize;
use serde_json::json;

use super::FARTHER;
use super::made_with::of_beliefs;
use super::tried::{FitArgs, MeasuredScene, held_out, other_length};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;

/// What was said of an end at each step, and whether it came true.
type Said = [(f64, bool); STEPS_M.len()];

/// Tries, fits, writes and reports.
pub fn run(args: &FitArgs<'_>, output: Output) -> CommandResult {
    args.refuse_start()?;
    let made_with = of_beliefs(&[FARTHER]);
    let tried = args.scenes_in("ends.jsonl", FIRST_SEED, &made_with);
    let scenes: Vec<SceneEnds> = tried.tried(|index| Ok(SceneEnds::of(index)))?.into_values().collect();
    let objects = scenes.iter().map(|scene| scene.objects.len()).sum();
    let fit = |learned: &[&SceneEnds]| {
        let trees = |of_far_ends: bool| {
            let samples: Vec<FitSample> = learned.iter().flat_map(|scene| scene.samples(of_far_ends)).collect();
            fit_log_odds(&samples, &FitSettings::of_steps(args.seed)).map_err(|e| Failure::bad_input("data", e))
        };
        Farther::new(trees(true)?, trees(false)?, FartherFitData { scenes: scenes.len(), objects }).map_err(Failure::other)
    };
    let said = |farther: &Farther, scene: &SceneEnds| -> Vec<(bool, Said)> {
        let of_end = |(end, (measured, farther_m)): (usize, &(_, f32))| {
            let chances = farther.chances(end, measured);
            let said = std::array::from_fn(|k| (f64::from(chances[k]), *farther_m > STEPS_M[k]));
            (end == 0, said)
        };
        scene.objects.iter().flat_map(|ends| ends.iter().enumerate().map(of_end)).collect()
    };
    let said: Vec<(bool, Said)> = held_out(&scenes, fit, said)?.concat();
    args.write(&fit(&scenes.iter().collect::<Vec<_>>())?)?;
    let figures = |of_far_ends: bool| -> Vec<StepFigures> {
        let of_end = |at: usize| said.iter().filter(|(is_far, _)| *is_far == of_far_ends).map(|(_, said)| said[at]).collect::<Vec<_>>();
        STEPS_M.iter().enumerate().map(|(at, step_m)| StepFigures::of(*step_m, &of_end(at))).collect()
    };
    let (far, others) = (figures(true), figures(false));
    let document = json!({
        "out": args.out, "scenes": scenes.len(), "objects": objects, "held_out": {"far_ends": far, "other_ends": others},
    });
    output.print(&document, || {
        let head = format!("{}: fitted on {} ends of {} scenes; on scenes held out", args.out.display(), ENDS * objects, scenes.len());
        let lines = |ends: &str, figures: &[StepFigures]| figures.iter().map(|figures| figures.told(ends)).collect::<Vec<_>>();
        [vec![head], lines("far ends", &far), lines("other ends", &others)].concat().join("\n")
    })
}

/// How good what is said at one step is.
#[derive(Debug, Serialize)]
struct StepFigures {
    farther_than_m: f32,
    /// Share of the ends that are.
    share: f64,
    /// Mean logarithm of how unlikely what came true was said to be, and were that share said of all.
    log_loss: f64,
    log_loss_of_share: f64,
    calibration_error: Option<f64>,
}

impl StepFigures {
    fn of(farther_than_m: f32, said: &[(f64, bool)]) -> Self {
        const LEAST: f64 = 1e-9;
        let mean = |of: &dyn Fn(&(f64, bool)) -> f64| said.iter().map(of).sum::<f64>() / said.len().max(1) as f64;
        let loss = |chance: f64, came_true: bool| -(if came_true { chance } else { 1.0 - chance }).max(LEAST).ln();
        let share = mean(&|(_, came_true)| f64::from(u8::from(*came_true)));
        Self {
            farther_than_m,
            share,
            log_loss: mean(&|(chance, came_true)| loss(*chance, *came_true)),
            log_loss_of_share: mean(&|(_, came_true)| loss(share, *came_true)),
            calibration_error: Calibration::of(said, 1).error,
        }
    }

    fn told(&self, ends: &str) -> String {
        let calibration = self.calibration_error.map_or_else(String::new, |error| format!("; calibration error {error:.3}"));
        format!(
            "{ends} that are more than {:.0} mm farther out than believed: {:.1} %; log loss {:.3}, of that share alone {:.3}{calibration}",
            self.farther_than_m * 1e3,
            self.share * 100.0,
            self.log_loss,
            self.log_loss_of_share
        )
    }
}

impl MeasuredScene for SceneEnds {
    fn seed(&self) -> u64 {
        self.seed
    }

    fn other_length(&self) -> Option<String> {
        let [far, others] = [repose_belief::back::MEASURES.len(), repose_belief::cut::MEASURES.len()];
        let of = |ends: std::ops::Range<usize>| {
            self.objects.iter().flat_map(move |object| object[ends.clone()].iter().map(|(end, _)| &end.measures))
        };
        other_length(far, of(0..1)).or_else(|| other_length(others, of(1..ENDS)))
    }
}
