//! `repose evaluate robot`: the paper's Table 3 with the simulated Panda.

use std::path::PathBuf;

use clap::Args;
use comfy_table::Table;
use repose_evaluation::robot_scene::Condition;
use repose_evaluation::robot_table::{OBJECTS, RobotRow};
use repose_evaluation::{Rate, RobotTable, RobotTableSettings, evaluate_robot};
use repose_simulator::objects::{MeshLibrary, MeshSettings};

use crate::embedded::EmbeddedModels;
use crate::failure::{Failure, Outcome};
use crate::frames;
use crate::output::Output;
use crate::picture::{rgb_image, side_by_side};

/// Arguments of `evaluate robot`.
#[derive(Debug, Args)]
pub struct EvaluateRobotArgs {
    /// The folder with the YCB objects' meshes.
    #[arg(long, value_name = "DIR", default_value = "../shared/data/ycb")]
    pub objects: PathBuf,
    /// Trials for each object and condition.
    #[arg(long, default_value_t = 3)]
    pub trials: usize,
    /// Only this object of the eight; repeat for more.
    #[arg(long = "only", value_name = "OBJECT", value_parser = OBJECTS)]
    pub only: Vec<String>,
    /// Only this condition.
    #[arg(long, value_parser = parse_condition)]
    pub condition: Option<Condition>,
    /// The seed that all scenes follow from.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// A folder for a strip of pictures per trial: before, lifted, lowered, placed.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
}

fn parse_condition(name: &str) -> Result<Condition, String> {
    let names = Condition::ALL.map(Condition::name).join(", ");
    Condition::ALL.into_iter().find(|c| c.name() == name).ok_or_else(|| format!("the conditions are {names}"))
}

/// The paper's plan, grasp and placement rates, percent, each of those that came so far.
fn of_paper(condition: Condition) -> [f64; 3] {
    match condition {
        Condition::Table => [95.0, 75.0, 100.0],
        Condition::LargeBox => [75.0, 56.0, 60.0],
    }
}

/// Runs the command.
pub fn run(args: &EvaluateRobotArgs, output: Output) -> Outcome {
    let models = EmbeddedModels::load()?;
    let library = MeshLibrary::load(&args.objects, &MeshSettings::default()).map_err(|e| Failure::bad_input("objects", e))?;
    let mut settings = RobotTableSettings { trials: args.trials, seed: args.seed, ..RobotTableSettings::default() };
    if !args.only.is_empty() {
        settings.objects.clone_from(&args.only);
    }
    if let Some(condition) = args.condition {
        settings.conditions = vec![condition];
    }
    let mut picture_failure = None;
    let table = evaluate_robot(&library, &settings, &models, |_, trial, strip| {
        let outcome = trial.cause.map_or("placed", repose_evaluation::robot_trial::Cause::name);
        let millimetres = |m: Option<f64>| m.map(|m| (m * 1e3).round());
        let in_hand = trial.in_hand.map(|s| format!("{:.0} mm {:.2} rad", s.by_m * 1e3, s.turn_rad));
        let incidents: Vec<String> = trial.incidents.iter().map(|i| format!("{} {:.1} s: {}", i.phase, i.at_s, i.what)).collect();
        tracing::info!(
            object = trial.object, condition = trial.condition.name(), seed = trial.seed, goal = %trial.goal, off_mm = ?millimetres(trial.off_m),
            tilt_rad = ?trial.tilt_rad, ?in_hand, disturbed = trial.disturbed, plan_ms = ?trial.plan_ms.map(f64::round), robot_s = trial.robot_s.round(),
            detail = trial.detail, incidents = incidents.join("; "), "{outcome}"
        );
        if let Some(folder) = &args.pictures {
            let name = format!("{}_{}_{}_{}.png", trial.object, trial.condition.name(), trial.seed, outcome.replace(' ', "_"));
            let pictures: Vec<_> = strip.iter().map(rgb_image).collect();
            picture_failure = frames::write_picture(&folder.join(name), &side_by_side(&pictures).into()).err().or(picture_failure.take());
        }
    });
    let table = table.map_err(Failure::other)?;
    if let Some(failure) = picture_failure {
        return Err(failure);
    }
    output.print(&document_of(&table), || text_of(&table))
}

fn document_of(table: &RobotTable) -> serde_json::Value {
    let row = |row: &RobotRow| {
        let mut value = serde_json::json!({
            "condition": row.condition, "plan": row.plan.percent(), "grasp": row.grasp.percent(), "place": row.place.percent(),
            "end_to_end": row.end_to_end.percent(), "end_to_end_interval": row.end_to_end.interval_percent(), "causes": row.causes,
            "counts": {"plan": row.plan, "grasp": row.grasp, "place": row.place, "end_to_end": row.end_to_end},
        });
        match &row.object {
            Some(object) => value["object"] = object.as_str().into(),
            None => value["paper"] = of_paper(row.condition).into_iter().collect(),
        }
        value
    };
    serde_json::json!({
        "rows": table.rows.iter().map(row).collect::<Vec<_>>(),
        "overall": table.overall.iter().map(row).collect::<Vec<_>>(),
        "trials": table.trials,
    })
}

fn text_of(table: &RobotTable) -> String {
    let mut text = Table::new();
    text.set_header(["object", "condition", "plan", "grasp", "place", "end to end", "failures"]);
    for row in &table.rows {
        text.add_row(cells(row, |rate| format!("{}/{}", rate.of, rate.n)));
    }
    for row in &table.overall {
        text.add_row(cells(row, |rate| rate.to_string()));
        let [plan, grasp, place] = of_paper(row.condition).map(|p| format!("{p:.0} %"));
        text.add_row(["the paper's".to_owned(), row.condition.name().to_owned(), plan, grasp, place, String::new(), String::new()]);
    }
    format!(
        "{text}\nground truth: masks, camera pose, outcomes; observed: depth with the sensor model. Rates are of the trials that came so far"
    )
}

fn cells(row: &RobotRow, show: impl Fn(&Rate) -> String) -> Vec<String> {
    let causes: Vec<String> = row.causes.iter().map(|(cause, count)| format!("{} {count}", cause.name())).collect();
    vec![
        row.object.clone().unwrap_or_else(|| "all".to_owned()),
        row.condition.name().to_owned(),
        show(&row.plan),
        show(&row.grasp),
        show(&row.place),
        show(&row.end_to_end),
        causes.join(", "),
    ]
}
