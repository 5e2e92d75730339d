//! The report of `evaluate discriminator`: JSON with the contract's keys, a table beside the paper's figures, and plots as SVG.

use serde_json::{Value, json};

use crate::report::plots::{DrawError, Points, reliability, scatter};
use crate::report::text;
use crate::tables::discriminator::{Correlation, DiscriminatorTable, Forecaster, OUTLIER_M, ReleaseTrial};
use crate::tables::paper;

/// What the figures are of; part of the JSON.
const DEFINITION: &str = "kitchen scenes, one open goal each; ground truth: masks, camera pose, meshes, and what 500 physics steps do; observed: depth with the sensor model; \
                          stable: the centre moved less than 5 cm, of scenes where a placement was returned; goal: by ground truth after settling; \
                          pearson: realism against distance moved of random prior samples, all of every scene's, movements of 0.5 m and more left out; pearson_p takes them for independent, which samples of one scene are not: \
                          pearson_one_a_scene is of the first sample of each scene, as the paper's is, and intervals are over scenes; auc_random: all samples, stable or not; \
                          calibration: realism of placements that the planner returned against stable, ten bins";

/// The JSON; `made_with` names split, weights and stability.
pub fn document(table: &DiscriminatorTable, made_with: &Value) -> Value {
    let rows: Vec<Value> = table
        .rows
        .iter()
        .map(|row| {
            json!({
                "variant": row.variant,
                "confident": row.confident.percent(), "confident_interval": row.confident.interval_percent(),
                "stable": row.stable.percent(), "stable_interval": row.stable.interval_percent(),
                "stable_with_goal": row.stable_with_goal.percent(), "stable_with_goal_interval": row.stable_with_goal.interval_percent(),
                "answers": row.stable.n,
                "pearson": row.correlation, "calibration_error": row.calibration.error, "calibration_floor": row.calibration.floor,
                "calibration_bins": row.calibration.bins,
            })
        })
        .collect();
    let main = table.rows.first();
    // The contract's figures are of the network that the main variant goes by; both are in `random`.
    let random = table.random.iter().find(|row| row.by == main_forecaster(table)).or(table.random.first());
    json!({
        "scenes": table.scenes,
        "variant": main.map(|row| row.variant),
        "stable": main.map(|row| row.stable.percent()),
        "stable_with_goal": main.map(|row| row.stable_with_goal.percent()),
        "pearson_r": random.and_then(|row| row.all.r), "pearson_p": random.and_then(|row| row.all.p),
        "auc_random": random.and_then(|row| row.auc),
        "random_by": random.map(|row| row.by),
        "calibration_error": main.and_then(|row| row.calibration.error),
        "pearson_r_interval": random.and_then(|row| row.all.interval),
        "pearson_one_a_scene": random.map(|row| row.one_a_scene),
        "auc_random_interval": random.and_then(|row| row.auc_interval),
        "random": table.random, "random_stable": table.random_stable.percent(),
        "rows": rows,
        "paper": {
            "stable": paper::STABLE_PERCENT, "stable_with_goal": paper::STABLE_WITH_GOAL_PERCENT,
            "random_r": paper::RANDOM_R.0, "random_p": paper::RANDOM_R.1, "planned_r": paper::PLANNED_R.0, "planned_p": paper::PLANNED_R.1,
        },
        "split": made_with["split"], "block": made_with["block"], "commit": made_with["commit"], "objects": made_with["objects"],
        "weights_hash": made_with["weights_hash"], "stability": made_with["stability"], "definition": DEFINITION,
        "trials": table.trials,
    })
}

/// Who says how realistic the main variant's placements are.
fn main_forecaster(table: &DiscriminatorTable) -> Forecaster {
    table.rows.first().map_or(Forecaster::Discriminator, |row| Forecaster::of(row.variant))
}

/// The scatter plot, and a reliability diagram of every variant: names and SVG.
///
/// # Errors
/// When a picture cannot be drawn.
pub fn pictures(table: &DiscriminatorTable) -> Result<Vec<(String, String)>, DrawError> {
    let diagrams = table
        .rows
        .iter()
        .map(|row| Ok((format!("reliability_{}", row.variant), reliability(&format!("Reliability, {}", row.variant), &row.calibration)?)));
    std::iter::once(Ok(("discriminator".to_owned(), scatter_plot(table)?))).chain(diagrams).collect()
}

/// Realism against distance moved: random samples first, so that placements lie over them.
fn scatter_plot(table: &DiscriminatorTable) -> Result<String, DrawError> {
    let by = main_forecaster(table);
    // A placement carries what its answer said.
    let said = |t: &ReleaseTrial| if t.variant.is_none() { by.said(t) } else { t.realism };
    let of = |keep: &dyn Fn(&ReleaseTrial) -> bool| -> Vec<(f64, f64)> {
        let kept = table.trials.iter().filter(|t| keep(t) && t.judged.moved_m < OUTLIER_M);
        kept.filter_map(|t| Some((t.judged.moved_m, said(t)?))).collect()
    };
    let random = Points { name: "random prior samples", points: of(&|t| t.variant.is_none()) };
    let planned =
        table.rows.iter().map(|row| Points { name: row.variant.as_str(), points: of(&|t| t.variant == Some(row.variant) && t.rank == 0) });
    let series: Vec<Points<'_>> = std::iter::once(random).chain(planned).collect();
    scatter(&format!("Realism against distance moved, {} scenes", table.scenes), OUTLIER_M, &series)
}

/// The table for people.
pub fn text_of(table: &DiscriminatorTable) -> String {
    let mut text = text::table(["", "ours", "paper"]);
    for row in &table.rows {
        let calibration = match (row.calibration.error, row.calibration.floor) {
            (Some(error), Some(floor)) => format!("{error:.3} (a perfect forecaster: {floor:.3})"),
            _ => "-".to_owned(),
        };
        text.add_row([format!("{}: scenes with an answer", row.variant), row.confident.to_string(), "-".to_owned()]);
        text.add_row([format!("{}: stable", row.variant), row.stable.to_string(), format!("{} %", paper::STABLE_PERCENT)]);
        let with_goal = format!("{} %", paper::STABLE_WITH_GOAL_PERCENT);
        text.add_row([format!("{}: stable, with the goal", row.variant), row.stable_with_goal.to_string(), with_goal]);
        text.add_row([format!("{}: r", row.variant), correlation_text(&row.correlation), papers(paper::PLANNED_R)]);
        text.add_row([format!("{}: calibration error", row.variant), calibration, "-".to_owned()]);
    }
    text.add_row(["random: stable".to_owned(), table.random_stable.to_string(), "-".to_owned()]);
    for row in &table.random {
        let by = match row.by {
            Forecaster::Discriminator => "discriminator",
            Forecaster::Outcome => "outcome network",
            Forecaster::Best => "best (outcome network and geometry)",
        };
        text.add_row([format!("random, {by}: r"), correlation_text(&row.all), "-".to_owned()]);
        text.add_row([format!("random, {by}: r, one a scene"), correlation_text(&row.one_a_scene), papers(paper::RANDOM_R)]);
        let interval = row.auc_interval.map_or_else(String::new, |[low, high]| format!(" [{low:.3}, {high:.3}]"));
        let area = row.auc.map_or_else(|| "-".to_owned(), |a| format!("{a:.3}{interval}"));
        text.add_row([format!("random, {by}: area under the curve"), area, "-".to_owned()]);
    }
    format!("{} kitchen scenes, one open goal each\n{text}\n{}", table.scenes, text::legend(&LEGEND))
}

/// The rows, in their order.
const LEGEND: [(&str, &str); 7] = [
    ("scenes with an answer", "a placement was returned; the paper's confident scenes"),
    ("stable", "the object's centre moved less than 5 cm in 500 physics steps, of the scenes with an answer"),
    ("with the goal", "the goal held by ground truth after settling, too"),
    ("random", "draws of the learned prior, without planning"),
    (
        "r",
        "Pearson's correlation of realism with the distance moved, movements of 0.5 m and more left out. Its p takes draws for \
           independent, which those of one scene are not: one a scene is as the paper has it. Intervals are over scenes",
    ),
    ("area under the curve", "of realism for moving less than 5 cm, all draws; 0.5 is chance"),
    ("calibration error", "mean distance of realism from the share that was stable, over ten bins, of all placements returned"),
];

fn papers((r, p): (f64, f64)) -> String {
    format!("{r:.3}, p {p:.3}")
}

fn correlation_text(correlation: &Correlation) -> String {
    let Some(r) = correlation.r else { return format!("- (n {})", correlation.n) };
    let interval = correlation.interval.map_or_else(String::new, |[low, high]| format!(" [{low:.3}, {high:.3}]"));
    let p = correlation.p.map_or_else(|| "-".to_owned(), |p| format!("{p:.2e}"));
    format!("{r:.3}{interval}, p {p} (n {}, {} left out)", correlation.n, correlation.outliers)
}
