//! The report of `evaluate robot`: JSON with the contract's keys, and a table beside the paper's figures.

use crate::report::final_runs::ledger;
use crate::report::own_commit::own_commit;
use crate::report::text;
use crate::scenes::robot_scene::{Excluded, TableCondition};
use crate::statistics::rate::Rate;
use crate::tables::robot::{RobotRow, RobotTable, RobotTableSettings};

/// The paper's plan, grasp and placement rates, percent, each of those that came so far.
fn of_paper(condition: TableCondition) -> [f64; 3] {
    match condition {
        TableCondition::Table => [95.0, 75.0, 100.0],
        TableCondition::LargeBox => [75.0, 56.0, 60.0],
    }
}

/// The JSON, with what the table was made with.
pub fn document(table: &RobotTable, settings: &RobotTableSettings, weights_hash: &str) -> serde_json::Value {
    let row = |row: &RobotRow| {
        let mut value = serde_json::json!({
            "condition": row.condition, "plan": row.plan.percent(), "grasp": row.grasp.percent(), "place": row.place.percent(),
            "end_to_end": row.end_to_end.percent(), "end_to_end_interval": row.end_to_end.interval_percent(), "causes": row.causes,
            "excluded": row.excluded,
            "counts": {"plan": row.plan, "grasp": row.grasp, "place": row.place, "end_to_end": row.end_to_end, "first_attempt": row.first_attempt},
        });
        match &row.object {
            Some(object) => value["object"] = object.as_str().into(),
            None => value["paper"] = of_paper(row.condition).into_iter().collect(),
        }
        value
    };
    serde_json::json!({
        "commit": own_commit(&ledger()), "weights_hash": weights_hash, "seed": settings.seed, "attempts": settings.trial.attempts,
        "rows": table.rows.iter().map(row).collect::<Vec<_>>(),
        "overall": table.overall.iter().map(row).collect::<Vec<_>>(),
        "trials": table.trials,
        "undrawn": table.undrawn,
    })
}

/// The table for people.
pub fn text_of(table: &RobotTable) -> String {
    let mut text = text::table(["object", "condition", "plan", "grasp", "place", "end to end", "at once", "failures", "not asked"]);
    for row in &table.rows {
        text.add_row(cells(row, |rate| format!("{}/{}", rate.of, rate.n)));
    }
    for row in &table.overall {
        text.add_row(cells(row, |rate| rate.short()));
        let [plan, grasp, place] = of_paper(row.condition).map(|p| format!("{p:.0} %"));
        text.add_row([
            "the paper's".to_owned(),
            row.condition.name().to_owned(),
            plan,
            grasp,
            place,
            String::new(),
            String::new(),
            String::new(),
            String::new(),
        ]);
    }
    let undrawn: Vec<String> = table
        .undrawn
        .iter()
        .map(|trial| format!("no scene with {} ({}) for seed {}: in no rate\n", trial.object, trial.condition.name(), trial.seed))
        .collect();
    format!("{text}\n{}{}", undrawn.concat(), text::legend(&LEGEND))
}

/// The columns, in their order.
const LEGEND: [(&str, &str); 7] = [
    (
        "plan",
        "a placement and a motion to it were found, at one attempt or more; successes of trials, with 95 % intervals over all objects",
    ),
    ("grasp", "of those, at the last attempt that was carried out: the object was in the hand when the lift had ended"),
    (
        "place",
        "of those: it stands within 5 cm of where it was to stand, not tipped by 15 degrees, nothing else moved by 2 cm, and the goal holds",
    ),
    (
        "end to end",
        "all three, of all trials; what was lost, or is seen not to meet the goal, is tried again as often as `--attempts` allows",
    ),
    ("at once", "end to end at the first attempt"),
    (
        "not asked",
        "drawn and counted in no rate, by the truth alone: goals that no place within the arm's reach makes true, and scenes in which the hand does not get to the object",
    ),
    ("ground truth", "masks, the camera's pose and the outcomes; depth is disturbed by the sensor model"),
];

fn cells(row: &RobotRow, show: impl Fn(&Rate) -> String) -> Vec<String> {
    let Excluded { out_of_reach, no_place } = row.excluded;
    let causes: Vec<String> = row.causes.iter().map(|(cause, count)| format!("{} {count}", cause.name())).collect();
    vec![
        row.object.clone().unwrap_or_else(|| "all".to_owned()),
        row.condition.name().to_owned(),
        show(&row.plan),
        show(&row.grasp),
        show(&row.place),
        show(&row.end_to_end),
        show(&row.first_attempt),
        causes.join(", "),
        format!("{no_place} goals, {out_of_reach} scenes"),
    ]
}
