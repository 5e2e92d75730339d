//! `repose train --network stability`: what `best` makes of the outcome network together with what geometry measures.
//!
//! How good the fit is is told on scenes that it has not seen, part by part. Whether the outcome network has learned from them is not known here: of a
//! folder that it was trained on both figures are higher than on new scenes.

use std::collections::BTreeMap;
use std::path::Path;

use repose_dataset::{ReleaseRecord, Split, read_proposals};
use repose_evaluation::scenes::problem::{Problem, ProblemSettings};
use repose_evaluation::scenes::stability_samples::stability_samples;
use repose_evaluation::statistics::correlation::area_under_curve;
use repose_evaluation::statistics::forecast_fit::{FitSample, FitSettings};
use repose_inference::Engine;
use repose_networks::serving::spread;
use repose_planner::learned::forecast::STABILITY;
use repose_planner::learned::stability::names;
use repose_proto::CallError;
use serde_json::json;

use super::tried::{FitArgs, fitted};
use super::with_forecasts;
use crate::embedded::engine;
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::progress::Progress;

/// Fits, writes and reports.
pub fn run(args: &FitArgs<'_>, output: Output) -> CommandResult {
    let engine = engine(args.start.map(Path::to_owned))?;
    let proposals = proposals_by_scene(&args.data.join(Split::Train.name()))?;
    let wanted = (args.first as usize, usize::try_from(args.scenes).unwrap_or(usize::MAX));
    let scenes: Vec<(u64, Vec<ReleaseRecord>)> = proposals.into_iter().skip(wanted.0).take(wanted.1).collect();
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
    let measured: Vec<Vec<FitSample>> = measured.into_iter().collect::<Result<_, CallError>>()?;
    let fitting = FitSettings { seed: args.seed, ..FitSettings::default() };
    let fitted = fitted(&names(), &measured, engine.outcome_hash(), &fitting)?;
    let network: Vec<(f64, bool)> = measured.iter().flatten().map(|s| (f64::from(s.measures[0]), s.came_true)).collect();
    let (with_geometry, network) = (area_under_curve(&fitted.held_out.concat()), area_under_curve(&network));
    with_forecasts(args.start, args.out, &[(STABILITY, &fitted.forecast)])?;
    let releases = measured.iter().map(Vec::len).sum::<usize>();
    let document = json!({
        "out": args.out, "scenes": scenes.len(), "releases": releases, "area_network": network, "area_held_out": with_geometry,
    });
    output.print(&document, || {
        let area = |area: Option<f64>| area.map_or_else(|| "undefined".to_owned(), |a| format!("{a:.3}"));
        format!(
            "{}: fitted on {releases} releases of {} scenes\narea under the curve on scenes held out from this fit: {} (the outcome network alone: {}); \
             if the outcome network was trained on these scenes, both are too high",
            args.out.display(),
            scenes.len(),
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
fn samples_of(releases: &[ReleaseRecord], seed: u64, settings: &ProblemSettings, engine: &Engine) -> Result<Vec<FitSample>, CallError> {
    match Problem::of_seed(seed, settings) {
        Some(problem) => stability_samples(&problem, engine, releases),
        None => Ok(Vec::new()),
    }
}
