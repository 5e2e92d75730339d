//! `repose train --network cut`: how far objects go on where they are cut off, from training scenes in which that is known.
//!
//! How good the fit is is told on scenes that it has not seen, part by part: of all ends, and of those at which two centimetres and more are missing.

use repose_belief::boosted_trees::log_of_length;
use repose_belief::cut::{Cut, CutFitData, End, MEASURES};
use repose_evaluation::scenes::cut_samples::{FIRST_SEED, SceneCuts};
use repose_evaluation::statistics::forecast_fit::{FitSettings, fit_lengths};
use repose_evaluation::statistics::quantile::Sorted;
use serde_json::json;

use super::CUT;
use super::made_with::of_beliefs;
use super::tried::{FitArgs, MeasuredScene, held_out, other_length};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;

/// From so much on, metres, the report counts an end as cut off.
const CUT_OFF_M: f32 = 0.02;

/// Tries, fits, writes and reports.
pub fn run(args: &FitArgs<'_>, output: Output) -> CommandResult {
    args.refuse_start()?;
    let made_with = of_beliefs(&[CUT]);
    let tried = args.scenes_in("cuts.jsonl", FIRST_SEED, &made_with);
    let scenes: Vec<SceneCuts> = tried.tried(|index| Ok(SceneCuts::of(index)))?.into_values().collect();
    let fit = |learned: &[&SceneCuts]| {
        let objects = || learned.iter().flat_map(|scene| &scene.objects);
        let trees = |ends: &[usize]| {
            let samples = objects().flat_map(|object| ends.iter().map(|end| &object[*end]));
            let samples: Vec<(Vec<f32>, f64)> =
                samples.map(|(measures, missing_m)| (measures.clone(), log_of_length(*missing_m))).collect();
            fit_lengths(&samples, &FitSettings::of_lengths(args.seed)).map_err(|e| Failure::bad_input("data", e))
        };
        // In the order of `End::ALL`.
        let data = CutFitData { scenes: scenes.len(), objects: objects().count() };
        Cut::new(trees(&[0])?, trees(&[1, 2])?, data).map_err(Failure::other)
    };
    let said = |cut: &Cut, scene: &SceneCuts| {
        let ends = scene.objects.iter().flat_map(|object| End::ALL.into_iter().zip(object));
        ends.map(|(end, (measures, missing_m))| (cut.missing_m(end, measures), *missing_m)).collect()
    };
    let said: Vec<(f32, f32)> = held_out(&scenes, fit, said)?.concat();
    let whole = fit(&scenes.iter().collect::<Vec<_>>())?;
    args.write(&whole)?;
    let error_mm = |(said_m, missing_m): &(f32, f32)| f64::from((said_m - missing_m.max(0.0)) * 1e3);
    let figures = |wanted: &dyn Fn(f32) -> bool| {
        let of_ends = || said.iter().filter(|(_, missing_m)| wanted(*missing_m));
        let (errors, sizes): (Sorted, Sorted) = (of_ends().map(error_mm).collect(), of_ends().map(|end| error_mm(end).abs()).collect());
        let without: Sorted = of_ends().map(|(_, missing_m)| f64::from(missing_m.max(0.0) * 1e3)).collect();
        (
            of_ends().count(),
            [errors.at_or_nan(0.5), sizes.at_or_nan(0.5), sizes.at_or_nan(0.9), without.at_or_nan(0.5), without.at_or_nan(0.9)],
        )
    };
    let (all, of_all) = figures(&|_| true);
    let (cut_off, of_cut_off) = figures(&|missing_m| missing_m >= CUT_OFF_M);
    let told = |ends: usize, [middle, p50, p90, before_p50, before_p90]: [f64; 5]| json!({"ends": ends, "middle_mm": middle, "p50_mm": p50, "p90_mm": p90, "p50_without_mm": before_p50, "p90_without_mm": before_p90});
    let document = json!({
        "out": args.out, "scenes": scenes.len(), "held_out": {"all": told(all, of_all), "cut_off": told(cut_off, of_cut_off)},
    });
    let line = |what: &str, ends: usize, [middle, p50, p90, before_p50, before_p90]: [f64; 5]| {
        format!(
            "{ends} {what}: off by {middle:+.1} mm (median), by {p50:.1} mm or less in half of them and {p90:.1} mm in nine of ten; were nothing \
             said, {before_p50:.1} and {before_p90:.1} mm"
        )
    };
    output.print(&document, || {
        [
            format!("{}: fitted on {} scenes; on scenes held out", args.out.display(), scenes.len()),
            line("ends", all, of_all),
            line("ends that are cut off by 20 mm and more", cut_off, of_cut_off),
        ]
        .join("\n")
    })
}

impl MeasuredScene for SceneCuts {
    fn seed(&self) -> u64 {
        self.seed
    }

    fn other_length(&self) -> Option<String> {
        other_length(MEASURES.len(), self.objects.iter().flatten().map(|(measures, _)| measures))
    }
}
