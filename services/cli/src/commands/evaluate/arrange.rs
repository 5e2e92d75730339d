//! `repose evaluate arrange`: several goals at once, on generated tasks with a known solution.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use repose_evaluation::report::arrange::{document, text_of};
use repose_evaluation::report::written::{FileError, can_write, write_report};
use repose_evaluation::scenes::arrangement::carried_out::PlanFault;
use repose_evaluation::scenes::arrangement::task::{ArrangementTask, Shapes, TaskKind};
use repose_evaluation::scenes::arrangement::trial::TaskRecord;
use repose_evaluation::tables::arrange::{ArrangeTableSettings, arrange_rows, evaluate_arrange};
use repose_proto::place::Variant;
use serde::Serialize;

use super::shared::{TableArgs, can_report, check_slots, told};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::progress::Progress;
use crate::values::{distinct_or, parse_count, parse_variant};

/// Arguments of `evaluate arrange`.
#[derive(Debug, Args)]
pub struct EvaluateArrangeArgs {
    /// Tasks of each kind and size.
    #[arg(long, default_value_t = 25, value_parser = parse_count)]
    pub tasks: usize,
    /// The first task of each kind and size, to make a table in parts.
    #[arg(long, default_value_t = 0)]
    pub first: u64,
    /// How many goals the tasks have, 2 to 8; repeat for more. Default: 2, 3, 4, 6 and 8.
    #[arg(long, value_parser = clap::value_parser!(u8).range(2..=8))]
    pub goals: Vec<u8>,
    /// Kind of task: free, ordered, swap or unstack; repeat for more. Default: all four.
    #[arg(long = "kind", value_parser = parse_task_kind)]
    pub kinds: Vec<TaskKind>,
    /// Object shapes that the planner gets: true or observed; repeat for both. Default: both.
    #[arg(long, value_parser = parse_shapes)]
    pub shapes: Vec<Shapes>,
    /// The method that finds each placement.
    #[arg(long, default_value = "best", value_parser = parse_variant)]
    pub variant: Variant,
    /// Judge only plans made once on the first view, not what comes of it with a look and a new plan after every move.
    #[arg(long)]
    pub without_looks: bool,
    /// Skip the two baselines, which place the goals one after another and take most of the time.
    #[arg(long)]
    pub without_bars: bool,
    /// Split, weights and threads.
    #[command(flatten)]
    pub common: TableArgs,
    /// A folder for the table as JSON, and for each task's record as soon as it is done.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &EvaluateArrangeArgs, output: Output) -> CommandResult {
    can_report(args.out.as_deref(), "arrange")?;
    let mut lines = TaskLines::new(args.out.as_deref())?;
    check_slots(args.first, args.tasks, ArrangementTask::SLOTS)?;
    let engine = args.common.engine()?;
    let goals: Vec<usize> = distinct_or(&args.goals, &[2, 3, 4, 6, 8]).into_iter().map(usize::from).collect();
    let kinds = distinct_or(&args.kinds, &TaskKind::ALL);
    let shapes = distinct_or(&args.shapes, &Shapes::ALL);
    let made_with = serde_json::json!({
        "weights_hash": engine.weights_hash(), "variant": args.variant, "goals": goals, "kinds": kinds, "shapes": shapes,
        "tasks": args.tasks, "looks": !args.without_looks, "bars": !args.without_bars,
    });
    let scenes = args.common.first("arrange", &made_with)?;
    let settings = ArrangeTableSettings {
        split: scenes.seeds_of,
        first: scenes.first + args.first,
        tasks: args.tasks,
        kinds,
        goals,
        shapes,
        variant: args.variant,
        looks: !args.without_looks,
        bars: !args.without_bars,
        threads: args.common.threads(),
    };
    let bar = Progress::new((settings.kinds.len() * settings.goals.len() * settings.shapes.len() * settings.tasks) as u64, "tasks");
    let mut records: Vec<TaskRecord> = Vec::new();
    evaluate_arrange(&settings, &engine, |record: TaskRecord| {
        bar.add(1);
        let end = |fault: Option<PlanFault>| fault.map_or("solved", |fault| fault.name());
        let looking = record.looking.as_ref().map(|looking| end(looking.fault));
        let TaskRecord { kind, goals, slot, fault, .. } = &record;
        tracing::info!(kind = kind.name(), goals, slot, ms = record.plan_ms.round(), looking, "{}", end(*fault));
        lines.add(&record);
        records.push(record);
        Ok::<(), Failure>(())
    })?;
    bar.finish();
    let rows = arrange_rows(&records);
    let document = document(&rows, &records, &scenes.named(&made_with));
    let written = args.out.as_deref().map_or(Ok(()), |folder| write_report(folder, "arrange", &document, &[]));
    told(written, || output.print(&document, || text_of(&rows)))?;
    if lines.is_cut_short { Err(Failure::NotAchieved) } else { Ok(()) }
}

/// The file with each task's record as soon as it is done.
struct TaskLines {
    path: Option<PathBuf>,
    /// Whether a record could not be written. None is written after it: it may have left half of a line.
    is_cut_short: bool,
}

impl TaskLines {
    /// The file in a folder, where there is one; refused where it cannot be written.
    fn new(folder: Option<&Path>) -> Result<Self, FileError> {
        let path = folder.map(|folder| folder.join("tasks.jsonl"));
        path.as_deref().map_or(Ok(()), can_write)?;
        Ok(Self { path, is_cut_short: false })
    }

    /// Adds a record. A disk that fills up takes the rest of the records, and not the table: that is said once.
    fn add(&mut self, record: &impl Serialize) {
        let Some(path) = self.path.as_deref().filter(|_| !self.is_cut_short) else { return };
        if let Err(failure) = append(path, record) {
            tracing::error!(%failure, "this task's record and those after it are missing; the table is made all the same");
            self.is_cut_short = true;
        }
    }
}

fn append(path: &Path, record: &impl Serialize) -> Result<(), FileError> {
    let line = serde_json::to_string(record).map_err(|e| FileError::new(path, e))?;
    let mut file = std::fs::File::options().append(true).create(true).open(path).map_err(|e| FileError::new(path, e))?;
    writeln!(file, "{line}").map_err(|e| FileError::new(path, e))
}

fn parse_task_kind(text: &str) -> Result<TaskKind, String> {
    let named = TaskKind::ALL.into_iter().find(|kind| kind.name() == text);
    named.ok_or_else(|| format!("expected free, ordered, swap or unstack, got {text:?}"))
}

fn parse_shapes(text: &str) -> Result<Shapes, String> {
    let named = Shapes::ALL.into_iter().find(|shapes| shapes.name() == text);
    named.ok_or_else(|| format!("expected true or observed, got {text:?}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_that_cannot_be_written_ends_the_file_and_not_the_table() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut lines = TaskLines::new(Some(folder.path())).unwrap_or_else(|e| panic!("{e}"));
        let path = folder.path().join("tasks.jsonl");
        lines.add(&1);
        assert!(!lines.is_cut_short && std::fs::read_to_string(&path).expect("a file") == "1\n");
        // Nothing can be appended to a folder, as to a disk that is full.
        std::fs::remove_file(&path).expect("removed");
        std::fs::create_dir(&path).expect("a folder");
        lines.add(&2);
        assert!(TaskLines::new(Some(folder.path())).is_err(), "the next table is not begun");
        std::fs::remove_dir(&path).expect("removed");
        lines.add(&3);
        assert!(lines.is_cut_short && !path.exists());
    }
}
