//! `repose train --network stability`: what `best` makes of the outcome network together with what geometry measures.

use std::collections::BTreeMap;
use std::path::Path;

use repose_dataset::{ReleaseRecord, Split, read_proposals};
use repose_evaluation::scenes::problem::{Problem, ProblemSettings};
use repose_evaluation::scenes::stability_samples::stability_samples;
use repose_evaluation::statistics::correlation::area_under_curve;
use repose_evaluation::statistics::forecast_fit::{FitSettings, Sample, fit_forecast};
use repose_inference::Engine;
use repose_networks::serving::spread;
use repose_planner::learned::forecast::{FittedOn, STABILITY};
use repose_planner::learned::stability::names;
use repose_proto::CallError;
use serde_json::json;

use super::with_forecasts;
use crate::embedded::engine;
use crate::failure::{Failure, Outcome};
use crate::output::Output;
use crate::progress::Progress;

/// Of this many scenes one is held out, to tell how good the fit is.
const HELD_OUT: usize = 8;

/// What is fitted on what.
#[derive(Debug, Clone, Copy)]
pub struct StabilitySettings<'a> {
    /// The folder of shards, with proposals beside those of training scenes.
    pub data: &'a Path,
    /// Weights in place of those that come with the program.
    pub start: Option<&'a Path>,
    /// The weights file that is written: those of `start` with the forecast in it.
    pub out: &'a Path,
    /// The most scenes.
    pub scenes: Option<u64>,
    /// Threads that measure.
    pub threads: usize,
    /// Seed of what each tree sees.
    pub seed: u64,
}

/// Fits, writes and reports.
pub fn run(args: &StabilitySettings<'_>, output: Output) -> Outcome {
    let engine = engine(args.start.map(Path::to_owned))?;
    let proposals = proposals_by_scene(&args.data.join(Split::Train.name()))?;
    // As many scenes as steps say, the first ones.
    let scenes: Vec<(u64, Vec<ReleaseRecord>)> = proposals.into_iter().take(args.scenes.map_or(usize::MAX, |s| s as usize)).collect();
    let bar = Progress::new(scenes.len() as u64, "scenes measured");
    let settings = ProblemSettings::default();
    let measured = spread(
        scenes.len(),
        args.threads,
        || (),
        |(), i| {
            bar.add(1);
            samples_of(&scenes[i].1, scenes[i].0, &settings, &engine)
        },
    );
    bar.finish();
    let measured: Vec<Vec<Sample>> = measured.into_iter().collect::<Result<_, CallError>>()?;
    let of = |keep: &dyn Fn(usize) -> bool| -> Vec<Sample> {
        measured.iter().enumerate().filter(|(i, _)| keep(*i)).flat_map(|(_, samples)| samples.clone()).collect()
    };
    let fitted_on = |releases: &[Sample]| FittedOn {
        scenes: scenes.len() as u64,
        releases: releases.len(),
        outcome_hash: engine.outcome_hash().to_owned(),
    };
    let fitting = FitSettings { seed: args.seed, ..FitSettings::default() };
    let fit = |samples: &[Sample]| fit_forecast(&names(), samples, fitted_on(samples), &fitting).map_err(|e| Failure::bad_input("data", e));
    let (kept, held_out) = (of(&|i| i % HELD_OUT != 0), of(&|i| i % HELD_OUT == 0));
    let tried = fit(&kept)?;
    let area = |said: &dyn Fn(&Sample) -> f64| area_under_curve(&held_out.iter().map(|s| (said(s), s.came_true)).collect::<Vec<_>>());
    let (with_geometry, network) = (area(&|s| tried.of(&s.measures)), area(&|s| f64::from(s.measures[0])));
    let whole = fit(&of(&|_| true))?;
    with_forecasts(args.start, args.out, &[(STABILITY, &whole)])?;
    let document = json!({
        "out": args.out, "scenes": scenes.len(), "releases": measured.iter().map(Vec::len).sum::<usize>(),
        "held_out": held_out.len(), "area_network": network, "area": with_geometry,
    });
    output.print(&document, || {
        let area = |area: Option<f64>| area.map_or_else(|| "undefined".to_owned(), |a| format!("{a:.3}"));
        format!(
            "{}: fitted on {} releases of {} scenes\narea under the curve on {} held-out releases: {} (the outcome network alone: {})",
            args.out.display(),
            document["releases"],
            scenes.len(),
            held_out.len(),
            area(with_geometry),
            area(network)
        )
    })
}

/// The proposals under a folder by their scene's seed.
fn proposals_by_scene(folder: &Path) -> Result<BTreeMap<u64, Vec<ReleaseRecord>>, Failure> {
    let bad = |e: &dyn std::fmt::Display| Failure::bad_input("data", format!("{}: {e}", folder.display()));
    let mut by_scene: BTreeMap<u64, Vec<ReleaseRecord>> = BTreeMap::new();
    for record in read_proposals(folder).map_err(|e| bad(&e))? {
        by_scene.entry(record.scene_seed).or_default().push(record);
    }
    if by_scene.is_empty() { Err(bad(&"there are no proposals in it; `generate --proposals` writes them")) } else { Ok(by_scene) }
}

/// The samples of one scene; none where its seed gives no problem.
fn samples_of(releases: &[ReleaseRecord], seed: u64, settings: &ProblemSettings, engine: &Engine) -> Result<Vec<Sample>, CallError> {
    match Problem::of_seed(seed, settings) {
        Some(problem) => stability_samples(&problem, engine, releases),
        None => Ok(Vec::new()),
    }
}
