//! The report of `evaluate arrange`: JSON with the contract's keys, and a table for people.

use std::collections::BTreeMap;

use comfy_table::Table;
use serde_json::{Value, json};

use crate::report::text::{legend, paragraph, table};
use crate::scenes::arrangement::carried_out::PlanFault;
use crate::scenes::arrangement::trial::TaskRecord;
use crate::tables::arrange::{ArrangeRow, LookingFigures};

/// What the figures are of; part of the JSON.
const DEFINITION: &str = "tasks with a known solution that was tried; planned once on the first view, every move let go in the true world from where the object \
                          truly stands; solved: all goals held by ground truth at the end, no object moved 5 cm or tipped 15 degrees where it was let go, nothing \
                          else moved 2 cm, nothing was pressed 5 mm; moves_over_fewest: moves of the solved tasks' plans in percent of the fewest known; looking: \
                          the first move of a plan is made, the same camera looks again, and the rest is planned anew; a fault ends it, too";

/// The JSON: a row for each kind and size, those of all kinds below `all`, every task below `records`.
pub fn document(rows: &[ArrangeRow], records: &[TaskRecord], head: &Value) -> Value {
    let of = |whole: bool| rows.iter().filter(|row| row.kind.is_none() == whole).map(row).collect::<Vec<_>>();
    json!({"rows": of(false), "all": of(true), "settings": head, "definition": DEFINITION, "records": records})
}

fn row(row: &ArrangeRow) -> Value {
    json!({
        "kind": row.kind, "goals": row.goals, "shapes": row.shapes,
        "solved": row.solved.percent(), "solved_interval": row.solved.interval_percent(),
        "moves_over_fewest": row.moves_of_fewest.map(|share| 100.0 * share),
        "p50_ms": row.p50_ms, "p50_processor_ms": row.p50_processor_ms, "searches": row.searches,
        "looking": row.looking.as_ref().map(looking),
        "in_order": row.in_order.percent(), "random_order": row.random_order.percent(),
        "faults": row.faults, "counts": {"solved": row.solved, "in_order": row.in_order, "random_order": row.random_order},
    })
}

fn looking(figures: &LookingFigures) -> Value {
    json!({
        "solved": figures.solved.percent(), "solved_interval": figures.solved.interval_percent(), "counts": {"solved": figures.solved},
        "moves_over_fewest": figures.moves_of_fewest.map(|share| 100.0 * share),
        "p50_ms": figures.p50_ms, "p50_longest_ms": figures.p50_longest_ms, "plans": figures.plans, "faults": figures.faults,
    })
}

const LEGEND: [(&str, &str); 7] = [
    ("shapes", "what the planner was given of the objects: all of their surfaces (true), or what one camera sees (observed)"),
    ("solved", "planned once: all goals held at the end, and every object stayed where it was put; 95 % interval"),
    (
        "with looks",
        "where the same camera looks after every move and the rest is planned anew; p50 and slowest: medians of a task's first and slowest plan",
    ),
    ("moves", "moves of the solved tasks' plans, in percent of the fewest known"),
    ("p50, processor, searches", "medians of planning: time, processor time, placements searched for"),
    ("in order, random", "solved by the goals one after another, in the given order and in the best of three random ones"),
    ("what failed", "what was wrong with the plans that did not solve their task"),
];

/// The table for people.
pub fn text_of(rows: &[ArrangeRow]) -> String {
    let mut table =
        table(["shapes", "goals", "kind", "solved", "moves", "p50", "processor", "searches", "in order", "random", "what failed"]);
    for row in rows {
        table.add_row([
            row.shapes.name().to_owned(),
            row.goals.to_string(),
            row.kind.map_or("all", |kind| kind.name()).to_owned(),
            row.solved.short(),
            percent(row.moves_of_fewest.map(|share| 100.0 * share)),
            format!("{:.1} s", row.p50_ms / 1e3),
            row.p50_processor_ms.map_or_else(|| "-".to_owned(), |ms| format!("{:.1} s", ms / 1e3)),
            format!("{:.0}", row.searches),
            percent(row.in_order.percent()),
            percent(row.random_order.percent()),
            named(&row.faults),
        ]);
    }
    let looked: Vec<_> = rows.iter().filter_map(|row| Some((row, row.looking.as_ref()?))).collect();
    let with_looks = if looked.is_empty() { String::new() } else { format!("\n{}", table_with_looks(&looked)) };
    format!(
        "{}\n{table}{with_looks}\n{}",
        paragraph("Several goals at once, planned on one view and carried out without another look, and with one after every move."),
        legend(&LEGEND)
    )
}

fn table_with_looks(rows: &[(&ArrangeRow, &LookingFigures)]) -> Table {
    let mut table = table(["with looks", "goals", "kind", "solved", "moves", "p50", "slowest", "plans", "what failed"]);
    for (row, figures) in rows {
        table.add_row([
            row.shapes.name().to_owned(),
            row.goals.to_string(),
            row.kind.map_or("all", |kind| kind.name()).to_owned(),
            figures.solved.short(),
            percent(figures.moves_of_fewest.map(|share| 100.0 * share)),
            format!("{:.1} s", figures.p50_ms / 1e3),
            format!("{:.1} s", figures.p50_longest_ms / 1e3),
            format!("{:.0}", figures.plans),
            named(&figures.faults),
        ]);
    }
    table
}

fn named(faults: &BTreeMap<PlanFault, usize>) -> String {
    faults.iter().map(|(fault, count)| format!("{} {count}", fault.name())).collect::<Vec<_>>().join(", ")
}

fn percent(of: Option<f64>) -> String {
    of.map_or_else(|| "-".to_owned(), |percent| format!("{percent:.0} %"))
}
