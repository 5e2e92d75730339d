//! `repose evaluate robot`: the paper's Table 3 with the simulated Panda.

use std::path::PathBuf;

use clap::Args;
use repose_evaluation::report;
use repose_evaluation::report::written::{can_write, write_picture};
use repose_evaluation::scenes::robot_scene::TableCondition;
use repose_evaluation::scenes::robot_settings::DEFAULT_ATTEMPTS;
use repose_evaluation::scenes::robot_trial::Cause;
use repose_evaluation::tables::robot::{OBJECTS, RobotTableError, RobotTableSettings, evaluate_robot};
use repose_local::picture::{rgb_image, side_by_side};
use repose_simulator::objects::{MeshLibrary, MeshSettings};

use super::shared::told;
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::values::{distinct_or, parse_count};
use repose_local::LocalModels;

/// Arguments of `evaluate robot`.
#[derive(Debug, Args)]
pub struct EvaluateRobotArgs {
    /// The folder with the YCB objects' meshes, one folder an object: `003_cracker_box/mesh.obj` and so on.
    #[arg(long, value_name = "DIR")]
    pub objects: PathBuf,
    /// Trials for each object and condition.
    #[arg(long, default_value_t = 3, value_parser = parse_count)]
    pub trials: usize,
    /// Attempts at each placement, as `place --execute` makes them: what is lost, or does not meet its goal in a view afterwards, is tried again.
    #[arg(long, default_value_t = DEFAULT_ATTEMPTS, value_parser = parse_count)]
    pub attempts: usize,
    /// Only this object of the eight; repeat for more.
    #[arg(long = "only", value_name = "OBJECT", value_parser = OBJECTS)]
    pub only: Vec<String>,
    /// Only this condition.
    #[arg(long, value_parser = parse_condition)]
    pub condition: Option<TableCondition>,
    /// Seed of the scenes.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// A folder for a strip of pictures per trial: before, and of each attempt lifted, lowered, placed.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
}

fn parse_condition(name: &str) -> Result<TableCondition, String> {
    let names = TableCondition::ALL.map(TableCondition::name).join(", ");
    TableCondition::ALL.into_iter().find(|c| c.name() == name).ok_or_else(|| format!("the conditions are {names}"))
}

/// Runs the command.
pub fn run(args: &EvaluateRobotArgs, output: Output) -> CommandResult {
    // A trial takes a while: what cannot be written is said before the first.
    args.pictures.as_deref().map_or(Ok(()), |folder| can_write(&folder.join("strip.png")))?;
    let models = LocalModels::embedded()?;
    let library = MeshLibrary::load(&args.objects, &MeshSettings::default()).map_err(|e| Failure::bad_input("objects", e))?;
    let mut settings = RobotTableSettings { trials: args.trials, seed: args.seed, ..RobotTableSettings::default() };
    settings.trial.attempts = args.attempts;
    settings.objects = distinct_or(&args.only, &settings.objects);
    if let Some(condition) = args.condition {
        settings.conditions = vec![condition];
    }
    let mut picture_failure = None;
    let table = evaluate_robot(&library, &settings, &models, |_, trial, strip| {
        let outcome = trial.cause.map_or("placed", Cause::name);
        let millimetres = |m: Option<f64>| m.map(|m| (m * 1e3).round());
        let in_hand = trial.in_hand.map(|s| format!("{:.0} mm {:.2} rad", s.by_m * 1e3, s.turn_rad));
        let incidents: Vec<String> = trial.incidents.iter().map(|i| format!("{} {:.1} s: {}", i.phase, i.at_s, i.what)).collect();
        tracing::info!(
            object = trial.object, condition = trial.condition.name(), seed = trial.seed, goal = %trial.goal, off_mm = ?millimetres(trial.off_m),
            tilt_rad = ?trial.tilt_rad, ?in_hand, disturbed = trial.disturbed, plan_ms = ?trial.plan_ms.map(f64::round), robot_s = trial.robot_s.round(),
            detail = trial.detail, failed_attempts = ?trial.failed_attempts, incidents = incidents.join("; "), "{outcome}"
        );
        if let Some(folder) = &args.pictures {
            let name = format!("{}_{}_{}_{}.png", trial.object, trial.condition.name(), trial.seed, outcome.replace(' ', "_"));
            let pictures: Vec<_> = strip.iter().map(rgb_image).collect();
            picture_failure = write_picture(&folder.join(name), &side_by_side(&pictures).into()).err().or(picture_failure.take());
        }
    });
    let table = table.map_err(|e| match e {
        RobotTableError::NoObject(_) => Failure::bad_input("objects", format!("{}: {e}", args.objects.display())),
        other => Failure::other(other),
    })?;
    let document = report::robot::document(&table, &settings, models.engine().weights_hash());
    told(picture_failure.map_or(Ok(()), Err), || output.print(&document, || report::robot::text_of(&table)))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    type Line = crate::testing::Line<EvaluateRobotArgs>;

    #[test]
    fn pictures_that_cannot_be_written_are_refused_before_anything_else() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let below = file.path().join("strips").display().to_string();
        let line = ["x", "--objects", "no/such/folder", "--pictures", &below];
        let failed = run(&Line::parse_from(line).args, Output { json: false }).expect_err("a failure");
        assert_eq!((failed.exit_code(), failed.error().and_then(|e| e.field.as_deref())), (2, Some(&*below)));
    }
}
