//! `repose train --network foot`: how high objects' bottoms are, from training scenes in which that is known.
//!
//! How good the fit is is told on scenes that it has not seen, part by part, beside the rule's word.

use repose_belief::foot::{Foot, FootFitData};
use repose_belief::foot_levels::Level;
use repose_evaluation::scenes::foot_samples::{FIRST_SEED, SceneFeet, TrueLevel};
use repose_evaluation::statistics::forecast_fit::{FitSample, FitSettings, fit_log_odds};
use repose_evaluation::statistics::rate::Rate;
use serde_json::json;

use super::FOOT;
use super::made_with::of_beliefs;
use super::tried::{FitArgs, MeasuredScene, held_out, other_length};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;

/// Of the feet held out: whether the rule was right, whether the chosen level is, and how likely that was said to be.
type Said = (bool, bool, f64);

/// Tries, fits, writes and reports.
pub fn run(args: &FitArgs<'_>, output: Output) -> CommandResult {
    args.refuse_start()?;
    // The network that looks at feet corrects the trees, and no level is measured by it.
    let made_with = of_beliefs(&[FOOT, "feet"]);
    let tried = args.scenes_in("feet.jsonl", FIRST_SEED, &made_with);
    let scenes: Vec<SceneFeet> = tried.tried(|index| Ok(SceneFeet::of(index)))?.into_values().collect();
    let fit = |learned: &[&SceneFeet]| {
        let levels: Vec<FitSample> = learned.iter().flat_map(|scene| scene.samples()).collect();
        let right = levels.iter().filter(|level| level.came_true).count();
        let trees = fit_log_odds(&levels, &FitSettings::of_levels(args.seed)).map_err(|e| Failure::bad_input("data", e))?;
        let objects = learned.iter().map(|scene| scene.objects.len()).sum();
        Foot::new(trees, FootFitData { scenes: learned.len(), objects, levels: levels.len(), right }).map_err(Failure::other)
    };
    let said = |foot: &Foot, scene: &SceneFeet| scene.objects.iter().filter_map(|levels| said_of(foot, levels)).collect();
    let said: Vec<Said> = held_out(&scenes, fit, said)?.concat();
    let whole = fit(&scenes.iter().collect::<Vec<_>>())?;
    args.write(&whole)?;
    let rule: Rate = said.iter().map(|(rule, _, _)| *rule).collect();
    let learned: Rate = said.iter().map(|(_, learned, _)| *learned).collect();
    let lost = said.iter().filter(|(rule, learned, _)| *rule && !learned).count();
    let said_right = said.iter().map(|(_, _, probability)| probability).sum::<f64>() / said.len().max(1) as f64;
    let mut by_sureness = said.clone();
    by_sureness.sort_by(|a, b| b.2.total_cmp(&a.2));
    let surest: Rate = by_sureness[..by_sureness.len() * 9 / 10].iter().map(|(_, learned, _)| *learned).collect();
    let held_out = json!({"rule": rule, "learned": learned, "lost": lost, "said": said_right, "surest_90_percent": surest});
    let document = json!({"out": args.out, "scenes": scenes.len(), "objects": said.len(), "held_out": held_out});
    output.print(&document, || {
        format!(
            "{}: fitted on {} objects of {} scenes; on scenes held out the rule is right of {rule}, the level that is chosen of {learned} (said: {:.1} %; \
             right by the rule alone: {lost}), of the surest 90 % of {surest}",
            args.out.display(),
            said.len(),
            scenes.len(),
            100.0 * said_right
        )
    })
}

/// What is said of an object; none without levels.
fn said_of(foot: &Foot, levels: &[TrueLevel]) -> Option<Said> {
    // The place in the list stands for the height.
    let numbered: Vec<Level> =
        levels.iter().enumerate().map(|(i, (measures, _))| Level { height_m: i as f32, measures: measures.clone() }).collect();
    let chosen = foot.choice(&numbered)?;
    Some((levels[0].1, levels[chosen.height_m as usize].1, chosen.probability))
}

impl MeasuredScene for SceneFeet {
    fn seed(&self) -> u64 {
        self.seed
    }

    fn other_length(&self) -> Option<String> {
        other_length(repose_belief::foot_levels::MEASURES.len(), self.objects.iter().flatten().map(|(measures, _)| measures))
    }
}
