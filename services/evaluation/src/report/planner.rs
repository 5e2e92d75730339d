//! The report of `evaluate planner`: JSON with the contract's keys, tables for people with the paper's figures beside, bars as SVG.

use crate::report::plots::{BarSeries, DrawError, grouped_bars};
use crate::report::text::{legend, paragraph, table};
use crate::scenes::planner_scene::SceneRecord;
use crate::statistics::paired::Paired;
use crate::statistics::rate::Rate;
use crate::tables::paper;
use crate::tables::planner::{Columns, PlannerRow, RiskCoveragePoint, SceneGroup, SetTable};
use comfy_table::Table;
use repose_proto::place::Variant;
use serde_json::{Value, json};

/// What the figures are of; part of the JSON.
const DEFINITION: &str = "ground truth: masks, camera pose, meshes, and what 500 physics steps do; observed: depth with the sensor model; \
                          predicates p > 0.5, realistic f > 0.5 (best: by boosted trees on the outcome network's word and geometry), successful both, stable (centre moved < 5 cm): each variant's lowest-cost feasible candidate, \
                          or where none is feasible the one of lowest cost among the 20 in view that violate the constraints least; \
                          joint: of the scenes with an answer, those where a placement was returned, the object stayed, the goal held by ground truth after settling, \
                          nothing else moved 2 cm, tilt < 15 degrees, penetration <= 5 mm; a scene has an answer where a search with the truth, any variant or the script found one; script: boxes, planes and random draws (evaluation/src/script.rs); intervals 95 %";

/// The JSON: the first set's rows on top, every set below `sets`, every scene below `records`.
pub fn document(tables: &[SetTable], records: &[SceneRecord], head: &Value) -> Value {
    let set = |table: &SetTable| {
        let mut value = part(&table.all);
        value["kinds"] = table.kinds.iter().map(part).collect();
        value
    };
    let sets: Vec<Value> = tables.iter().map(set).collect();
    let first = |key: &str| sets.first().map_or(Value::Null, |s| s[key].clone());
    json!({
        "scenes": first("scenes"), "feasible": first("feasible"), "rows": first("rows"),
        "curve": tables.first().and_then(|t| t.all.rows.first()).map_or_else(Vec::new, |row| row.curve.clone()),
        "sets": sets, "paper": paper::VARIANTS, "settings": head, "definition": DEFINITION, "records": records,
    })
}

fn part(part: &SceneGroup) -> Value {
    json!({
        "name": part.name, "scenes": part.scenes, "feasible": part.answerable, "found_by_variants_only": part.found_by_variants_only,
        "script_joint": part.script_joint.percent(),
        "rows": part.rows.iter().map(row).collect::<Vec<_>>(),
    })
}

fn row(row: &PlannerRow) -> Value {
    let all = &row.of_all;
    json!({
        "variant": row.variant,
        "predicates": all.predicates.percent(), "realistic": all.realistic.percent(), "successful": all.successful.percent(), "stable": all.stable.percent(),
        "success_calibration": row.success_calibration.error, "success_calibration_floor": row.success_calibration.floor,
        "wrong": row.right_when_returned.percent().map(|right| 100.0 - right),
        "joint": row.joint.percent(), "joint_interval": row.joint.interval_percent(),
        "joint_of_self_standing": row.joint_of_self_standing.percent(),
        "none_precision": row.none_precision.percent(), "none_recall": row.none_recall.percent(),
        "of_answerable": {
            "predicates": row.of_answerable.predicates.percent(), "realistic": row.of_answerable.realistic.percent(),
            "successful": row.of_answerable.successful.percent(), "stable": row.of_answerable.stable.percent(),
        },
        "against_geometric": row.against_geometric, "against_script": row.against_script,
        "p50_ms": row.times_ms[0], "p95_ms": row.times_ms[1],
        "counts": row,
    })
}

/// Bars for every set: the paper's columns, and the joint rate by kind.
///
/// # Errors
/// When a picture cannot be drawn.
pub fn pictures(tables: &[SetTable]) -> Result<Vec<(String, String)>, DrawError> {
    let mut pictures = Vec::new();
    for table in tables {
        let rows = &table.all.rows;
        let groups: Vec<&str> = rows.iter().map(|r| r.variant.as_str()).collect();
        let rates = |pick: &dyn Fn(&PlannerRow) -> Rate, name: &'static str| {
            let of: Vec<Rate> = rows.iter().map(pick).collect();
            BarSeries {
                name,
                values: of.iter().map(|r| r.percent().map(|p| p / 100.0)).collect(),
                intervals: of.iter().map(|r| Some(r.interval_percent().map(|p| p / 100.0))).collect(),
            }
        };
        let successful = rates(&|r| r.of_answerable.successful, "successful (networks)");
        let stable = rates(&|r| r.of_answerable.stable, "stable");
        let joint = rates(&|r| r.joint, "joint");
        let papers = rows.iter().map(|r| paper::VARIANTS.iter().find(|p| p.variant == r.variant).map(|p| p.stable / 100.0)).collect();
        let papers = BarSeries { name: "stable, paper", values: papers, intervals: vec![None; rows.len()] };
        let title = format!("Planner variants, {}: {} of {} scenes with an answer", table.all.name, table.all.answerable, table.all.scenes);
        let svg = grouped_bars(&title, &groups, &[stable, successful, papers, joint])?;
        pictures.push((format!("planner_{}", table.all.name), svg));
        if !table.kinds.is_empty() {
            pictures.push((format!("planner_{}_kinds", table.all.name), by_kind(table)?));
        }
    }
    Ok(pictures)
}

fn by_kind(table: &SetTable) -> Result<String, DrawError> {
    let groups: Vec<&str> = table.kinds.iter().map(|k| k.name.as_str()).collect();
    let shown = [Variant::Best, Variant::Geometric, Variant::Full];
    let bars = |variant: Variant| {
        let of: Vec<Option<Rate>> = table.kinds.iter().map(|k| k.rows.iter().find(|r| r.variant == variant).map(|r| r.joint)).collect();
        BarSeries {
            name: variant.as_str(),
            values: of.iter().map(|r| r.and_then(|r| r.percent()).map(|p| p / 100.0)).collect(),
            intervals: of.iter().map(|r| r.map(|r| r.interval_percent().map(|p| p / 100.0))).collect(),
        }
    };
    let series: Vec<BarSeries<'_>> = shown.map(bars).into();
    grouped_bars(&format!("Joint rate by kind of scene, {}", table.all.name), &groups, &series)
}

/// The tables for people.
pub fn text_of(tables: &[SetTable]) -> String {
    let mut text = String::new();
    for table in tables {
        let all = &table.all;
        text += &paragraph(&format!(
            "{}: {} scenes, {} with an answer ({} of them found by a variant only). Rates have 95 % intervals.",
            all.name, all.scenes, all.answerable, all.found_by_variants_only
        ));
        text += &format!("\n\nThe paper's columns (its Table 1)\n{}", papers_columns(all));
        text += &format!("\n\nWhat was returned\n{}", returned(all));
        text += &format!("\n\nHow sure answers are of themselves, and what is wrong with those that fail\n{}", sureness(all));
        text += &format!("\n\nScene by scene against others; the script's joint rate is {}\n{}", all.script_joint, comparisons(all));
        if !table.kinds.is_empty() {
            text += &format!("\n\nJoint rate by kind of scene\n{}\n{}", joint_by_kind(table), best_by_kind(table));
        }
        text += "\n\n";
    }
    text + &legend(&LEGEND)
}

/// The columns, in the order of the tables.
const LEGEND: [(&str, &str); 17] = [
    ("predicates, realistic, successful", "the networks' word on each variant's cheapest candidate: p > 0.5, f > 0.5, both"),
    (
        "stable",
        "its centre moved less than 5 cm in 500 physics steps. Where no candidate is feasible, it is the cheapest of the 20 in view that \
                violate the constraints least",
    ),
    ("with an answer", "a search with the truth, a variant or the script placed the object successfully"),
    ("answered", "a placement was returned, of the scenes with an answer"),
    (
        "joint",
        "of the scenes with an answer: a placement was returned, the object stayed, the goal held after settling, nothing else moved \
               2 cm, it tilted less than 15 degrees and went at most 5 mm into anything",
    ),
    (
        "of self-standing",
        "joint, of the scenes in which the object stands by itself in the attitude in which it was seen, and the search with the truth finds an \
               answer that has nine tenths of its base right over what carries it: a planner that sets nothing over an edge, and nothing down that tips, \
               is to answer these",
    ),
    ("right of answers", "of all placements returned, those that succeed as `joint` demands"),
    (
        "calibration error",
        "how far the probability of success that answers give themselves is from the share that succeeds, mean over ten bins; in brackets \
               what probabilities that are right would have with as few answers. Variants without such a probability: their realism",
    ),
    (
        "wrong of the surest",
        "of the answers that are surest of themselves, those that fail; in brackets the --min-success that gives these",
    ),
    (
        "faults",
        "the worst of each wrong answer: fell (its centre came down 5 cm), pressed (5 mm into something), tipped (15 degrees), moved_others \
               (2 cm), slid (5 cm), goal (does not hold)",
    ),
    ("none right", "of the scenes answered with none, those without an answer"),
    ("none found", "of the scenes without an answer, those answered with none"),
    (
        "missed by",
        "of the scenes answered with none in which the search with the truth finds an answer: what the planner refuses the object by (tips, unsettles), or \
               else its best true answer, on what it believes; unsure where that passes all that needs no network",
    ),
    ("two supports, two good", "of the scenes with answers on two supports: the answers stand on two; on both of them one succeeds"),
    ("against …", "difference of the joint rates in points [interval], scenes where only this one : only the other succeeds, McNemar's p"),
    ("script", "boxes, planes and random draws (services/evaluation/src/scenes/script.rs)"),
    ("realistic of best", "by boosted trees on the outcome network's word and geometry"),
];

fn papers_columns(part: &SceneGroup) -> Table {
    let mut table = table(["variant", "of the scenes", "predicates", "realistic", "successful", "stable"]);
    for row in &part.rows {
        let cells = |of: &str, c: &Columns| {
            let mut cells = vec![row.variant.to_string(), of.to_owned()];
            cells.extend([c.predicates, c.realistic, c.successful, c.stable].map(|r| r.short()));
            cells
        };
        table.add_row(cells("all", &row.of_all));
        table.add_row(cells("with an answer", &row.of_answerable));
        if let Some(p) = paper::VARIANTS.iter().find(|p| p.variant == row.variant) {
            let mut cells = vec![String::new(), "the paper's".to_owned()];
            cells.extend([p.predicates, p.realistic, p.successful, p.stable].map(|v| format!("{v:.0} %")));
            table.add_row(cells);
        }
    }
    table
}

fn returned(part: &SceneGroup) -> Table {
    let mut table =
        table(["variant", "answered", "joint", "of self-standing", "right of answers", "none right", "none found", "p50 / p95 ms"]);
    for row in &part.rows {
        table.add_row(vec![
            row.variant.to_string(),
            row.returned.short(),
            row.joint.short(),
            row.joint_of_self_standing.short(),
            row.right_when_returned.short(),
            row.none_precision.short(),
            row.none_recall.short(),
            format!("{:.0} / {:.0}", row.times_ms[0], row.times_ms[1]),
        ]);
    }
    table
}

/// What is wrong with answers, and how many would be if only the surest were given.
fn sureness(part: &SceneGroup) -> Table {
    let shares = [100.0, 95.0, 90.0, 80.0];
    let header = ["variant", "calibration error (floor)"].map(str::to_owned).into_iter();
    let columns = shares.iter().map(|share| format!("wrong of the surest {share:.0} %")).chain(["faults".to_owned()]);
    let mut table = table(header.chain(columns));
    for row in &part.rows {
        let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"));
        let of = &row.success_calibration;
        let mut cells = vec![row.variant.to_string(), format!("{} ({})", number(of.error), number(of.floor))];
        let wrong = |share: &f64| row.curve.iter().find(|point| point.answered == *share);
        cells.extend(shares.iter().map(|share| {
            let text = |p: &RiskCoveragePoint| format!("{} of {}, {:.1} % (from {:.2})", p.wrong_answers, p.answers, p.wrong, p.least);
            wrong(share).map_or_else(|| "-".to_owned(), text)
        }));
        cells.push(row.faults.iter().map(|(fault, count)| format!("{} {count}", fault.name())).collect::<Vec<_>>().join(", "));
        table.add_row(cells);
    }
    table
}

fn comparisons(part: &SceneGroup) -> Table {
    let mut table = table(["variant", "against geometric", "against the script", "two supports", "two good", "missed by"]);
    for row in &part.rows {
        table.add_row(vec![
            row.variant.to_string(),
            against(row.against_geometric),
            against(row.against_script),
            row.two_supports.short(),
            row.two_good_supports.short(),
            row.missed_by
                .iter()
                .map(|(reason, count)| format!("{} {count}", json!(reason).as_str().unwrap_or_default()))
                .collect::<Vec<_>>()
                .join(", "),
        ]);
    }
    table
}

fn joint_by_kind(set: &SetTable) -> Table {
    let header = ["kind".to_owned(), "with an answer".to_owned()];
    let variants = set.all.rows.iter().map(|r| r.variant.to_string());
    let mut table = table(header.into_iter().chain(variants).chain(["script".to_owned()]));
    let percent = |rate: Rate| rate.percent().map_or_else(|| "-".to_owned(), |p| format!("{p:.0} %"));
    for kind in &set.kinds {
        let mut cells = vec![kind.name.clone(), format!("{} of {}", kind.answerable, kind.scenes)];
        cells.extend(kind.rows.iter().map(|r| percent(r.joint)));
        cells.push(percent(kind.script_joint));
        table.add_row(cells);
    }
    table
}

fn best_by_kind(set: &SetTable) -> Table {
    let mut table = table(["kind", "best", "against geometric", "against the script"]);
    for kind in &set.kinds {
        for row in kind.rows.iter().filter(|row| row.variant == Variant::Best) {
            table.add_row([kind.name.clone(), row.joint.to_string(), against(row.against_geometric), against(row.against_script)]);
        }
    }
    table
}

fn against(paired: Option<Paired>) -> String {
    let Some(paired) = paired else { return String::new() };
    let interval = paired.interval.map_or_else(String::new, |[low, high]| format!(" [{low:+.0}, {high:+.0}]"));
    format!("{:+.1}{interval}, {}:{}, p {:.2}", paired.difference, paired.only_first, paired.only_second, paired.p)
}
