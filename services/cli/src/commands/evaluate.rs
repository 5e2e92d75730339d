//! `repose evaluate`: the paper's tables.

use comfy_table::Table;
use nalgebra::Isometry3;
use repose_evaluation::evaluate_planner;
use repose_geometry::transform::from_row_major;

use crate::args::{self, EvaluateArgs, EvaluatePlannerArgs};
use crate::commands::evaluate_segmentation;
use crate::commands::generate::split_of;
use crate::embedded::EmbeddedModels;
use crate::failure::Outcome;
use crate::frames;
use crate::output::Output;
use crate::picture::{Coloring, scene_picture, side_by_side};

/// Runs the command.
pub fn run(args: &EvaluateArgs, output: Output) -> Outcome {
    match &args.table {
        args::Table::Planner(args) => planner(args, output),
        args::Table::World(args) => super::evaluate_world::run(args, output),
        args::Table::Relations(args) => super::evaluate_relations::run(args, output),
        args::Table::Discriminator(args) => super::evaluate_discriminator::run(args, output),
        args::Table::Segmentation(args) => evaluate_segmentation::run(args, output),
        args::Table::Robot(args) => super::evaluate_robot::run(args, output),
    }
}

fn planner(args: &EvaluatePlannerArgs, output: Output) -> Outcome {
    let models = EmbeddedModels::load()?;
    let mut picture_failure = None;
    let table = evaluate_planner(split_of(&args.split)?, args.scenes, &args.variants, &models, |problem, result, trial| {
        let outcome = match &trial.judged {
            Some(j) => format!("moved {:.0} mm, goal {}, clean {}", j.moved_m * 1e3, j.goal, j.clean),
            None => "none".to_owned(),
        };
        tracing::info!(seed = trial.seed, variant = %trial.variant, feasible = trial.feasible, ms = trial.plan_ms.round(), "{outcome}");
        if let Some(folder) = &args.pictures {
            let placed: Option<Isometry3<f64>> = result.placements.first().and_then(|p| from_row_major(&p.placed_from_observed.0).ok());
            let before = scene_picture(&problem.observed, Coloring::Seen, None);
            let after = scene_picture(&problem.observed, Coloring::Seen, placed.as_ref().map(|t| (problem.query, t)));
            let good = trial.judged.as_ref().is_some_and(|j| j.stable && j.goal);
            let name = format!("{}_{}_{}_{}.png", trial.seed, trial.variant, problem.goal.relation, if good { "good" } else { "bad" });
            picture_failure = frames::write_picture(&folder.join(name), &side_by_side(&[before, after]).into()).err();
        }
    });
    let table = table?;
    if let Some(failure) = picture_failure {
        return Err(failure);
    }
    let rows: Vec<_> = table
        .rows
        .iter()
        .map(|row| {
            serde_json::json!({
                "variant": row.variant, "returned": row.returned.percent(), "stable": row.stable.percent(), "goal": row.goal.percent(),
                "returned_stayed_goal": row.returned_stayed_goal.percent(), "returned_stayed_goal_of_all": row.returned_stayed_goal_of_all,
                "joint": row.joint.percent(), "joint_interval": row.joint.interval_percent(),
                "none_precision": row.none_precision.percent(), "none_recall": row.none_recall.percent(), "p50_ms": row.p50_ms,
            })
        })
        .collect();
    let document = serde_json::json!({"scenes": table.scenes, "feasible": table.feasible, "rows": rows, "trials": table.trials});
    output.print(&document, || {
        let mut text = Table::new();
        text.set_header([
            "variant",
            "returned",
            "stable",
            "goal",
            "returned, stayed, goal",
            "… of all scenes",
            "joint",
            "none right",
            "none found",
            "p50 ms",
        ]);
        for row in &table.rows {
            let rates = [
                row.returned,
                row.stable,
                row.goal,
                row.returned_stayed_goal,
                row.returned_stayed_goal_of_all,
                row.joint,
                row.none_precision,
                row.none_recall,
            ];
            let mut cells = vec![row.variant.to_string()];
            cells.extend(rates.iter().map(ToString::to_string));
            cells.push(format!("{:.0}", row.p50_ms));
            text.add_row(cells);
        }
        format!(
            "{} scenes, {} with an answer (ground truth: masks, gravity, meshes; observed: depth)\n{text}",
            table.scenes, table.feasible
        )
    })
}
