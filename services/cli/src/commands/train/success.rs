//! `repose train --network success`: how likely placements of `best` succeed, from its own answers in training scenes.
//!
//! What came of each scene's answers goes to `answers.jsonl` in the data folder, so that a run that was stopped goes on, and parts made on
//! several machines can be put together. How good the fit is is told on scenes that it has not seen, part by part.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::Path;

use repose_evaluation::scenes::one_scene::forecasts_of;
use repose_evaluation::scenes::success_samples::SceneAnswers;
use repose_evaluation::statistics::calibration::Calibration;
use repose_evaluation::statistics::correlation::area_under_curve;
use repose_evaluation::statistics::forecast_fit::{FitSettings, Sample, fit_forecast};
use repose_networks::serving::spread;
use repose_planner::learned::forecast::{FittedOn, SUCCESS};
use repose_planner::learned::success::names;
use serde_json::json;

use super::with_forecast;
use crate::embedded::engine;
use crate::failure::{Failure, Outcome};
use crate::output::Output;
use crate::progress::Progress;

/// In so many parts the scenes are held out in turn, to tell how good the fit is.
const FOLDS: usize = 8;

/// What is fitted on what.
#[derive(Debug, Clone, Copy)]
pub struct SuccessSettings<'a> {
    /// The folder of `answers.jsonl`.
    pub data: &'a Path,
    /// Weights in place of those that come with the program.
    pub start: Option<&'a Path>,
    /// The weights file that is written: those of `start` with the forecast in it.
    pub out: &'a Path,
    /// The first scene that is tried, counted from the first of those that are learned from.
    pub first: u64,
    /// Scenes tried, if they are not in the folder yet; whatever else is there is learned from too.
    pub scenes: u64,
    /// Threads.
    pub threads: usize,
    /// Seed of what each tree sees.
    pub seed: u64,
}

/// Tries, fits, writes and reports.
pub fn run(args: &SuccessSettings<'_>, output: Output) -> Outcome {
    let engine = engine(args.start.map(Path::to_owned))?;
    let answers = tried(args, &engine)?;
    let scenes: Vec<Vec<Sample>> = answers.values().map(|scene| scene.samples().collect()).collect();
    let fitting = FitSettings::of_few(args.seed);
    let fit = |keep: &dyn Fn(usize) -> bool| {
        let kept: Vec<Sample> = scenes.iter().enumerate().filter(|(i, _)| keep(*i)).flat_map(|(_, samples)| samples.clone()).collect();
        let fitted_on = FittedOn { scenes: scenes.len() as u64, releases: kept.len(), outcome_hash: engine.outcome_hash().to_owned() };
        fit_forecast(&names(), &kept, fitted_on, &fitting).map_err(|e| Failure::bad_input("data", e))
    };
    let (mut said, mut said_of_first) = (Vec::new(), Vec::new());
    for fold in 0..FOLDS {
        let forecast = fit(&|i| i % FOLDS != fold)?;
        for samples in scenes.iter().skip(fold).step_by(FOLDS) {
            let of = |sample: &Sample| (forecast.of(&sample.measures), sample.came_true);
            said.extend(samples.iter().map(of));
            said_of_first.extend(samples.first().map(of));
        }
    }
    with_forecast(args.start, args.out, SUCCESS, &fit(&|_| true)?)?;
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

/// The answers of all scenes by seed: those in the folder, and those that are tried now.
fn tried(args: &SuccessSettings<'_>, engine: &repose_inference::Engine) -> Result<BTreeMap<u64, SceneAnswers>, Failure> {
    let path = args.data.join("answers.jsonl");
    let bad = |e: &dyn std::fmt::Display| Failure::bad_input("data", format!("{}: {e}", path.display()));
    std::fs::create_dir_all(args.data).map_err(|e| bad(&e))?;
    let text = if path.exists() { std::fs::read_to_string(&path).map_err(|e| bad(&e))? } else { String::new() };
    let mut all = BTreeMap::new();
    // A last line that was being written when the program was stopped is tried again.
    let whole = text.rfind('\n').map_or(0, |end| end + 1);
    for line in text[..whole].lines() {
        let scene: SceneAnswers = serde_json::from_str(line).map_err(|e| bad(&e))?;
        if let Some(measures) = scene.measures.iter().find(|measures| measures.len() != names().len()) {
            return Err(bad(&format!("expected {} measures, got {}: made by another program", names().len(), measures.len())));
        }
        all.insert(scene.seed, scene);
    }
    let mut file = File::options().create(true).append(true).open(&path).map_err(|e| bad(&e))?;
    file.set_len(whole as u64).map_err(|e| bad(&e))?;
    let forecasts = forecasts_of(engine)?;
    let open: Vec<u64> = (args.first..args.first + args.scenes)
        .filter(|i| !all.contains_key(&(repose_evaluation::scenes::success_samples::FIRST_SEED + i)))
        .collect();
    let bar = Progress::new(open.len() as u64, "scenes");
    for batch in open.chunks(args.threads.max(1) * 2) {
        let tried = spread(batch.len(), args.threads, || (), |(), k| SceneAnswers::of(batch[k], engine, &forecasts));
        for scene in tried {
            let scene = scene?;
            writeln!(file, "{}", serde_json::to_string(&scene).map_err(Failure::other)?).map_err(|e| bad(&e))?;
            all.insert(scene.seed, scene);
            bar.add(1);
        }
    }
    bar.finish();
    all.retain(|_, scene| !scene.measures.is_empty());
    Ok(all)
}
