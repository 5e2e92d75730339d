//! `repose bench motion`: the arm's path planning on a file of problems, as the published planners report it.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use repose_evaluation::report::text::{legend, table};
use repose_evaluation::report::written::can_write;
use repose_evaluation::statistics::quantile::Sorted;
use repose_motion::benchmark::{ProblemFile, Solution, Unsolved, solve};
use repose_motion::path::joint_path::length;
use repose_motion::path::rrt_connect::RrtSettings;
use repose_motion::path::simplify::SimplifySettings;
use serde::Serialize;

use crate::failure::{CommandResult, Failure};
use crate::output::Output;

/// Arguments of `bench motion`.
#[derive(Debug, Args)]
pub struct BenchMotionArgs {
    /// The problems, in the format of MotionBenchMaker's JSON.
    #[arg(long, value_name = "FILE")]
    pub problems: PathBuf,
    /// A file for the paths found (JSON: joint vectors per problem).
    #[arg(long, value_name = "FILE")]
    pub paths: Option<PathBuf>,
    /// Seed of the searches.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// What is told of a set, or of all.
#[derive(Debug, Serialize)]
struct Row {
    problems: usize,
    /// Without those whose ends cannot be.
    valid: usize,
    solved: usize,
    plan_us: Times,
    plan_simplify_us: Times,
    /// Radians, simplified paths.
    length_mean: f64,
}

#[derive(Debug, Serialize)]
struct Times {
    mean: f64,
    p50: f64,
    p95: f64,
}

#[derive(Debug, Serialize)]
struct Report {
    #[serde(flatten)]
    all: Row,
    sets: BTreeMap<String, Row>,
    /// Problems whose ends cannot be, and those that were not solved, with the reason.
    unsolved: Vec<Failed>,
    /// How the shapes are checked.
    cylinders: &'static str,
    seed: u64,
}

#[derive(Debug, Serialize)]
struct Failed {
    set: String,
    index: usize,
    invalid: bool,
    reason: String,
}

#[derive(Debug, Serialize)]
struct FoundPath<'a> {
    index: usize,
    path: &'a [[f64; 7]],
}

type Solved = BTreeMap<String, Vec<(usize, Result<Solution, Unsolved>)>>;

/// Runs the command.
pub fn run(args: &BenchMotionArgs, output: Output) -> CommandResult {
    // What cannot be written is said before the minutes that the searches take.
    args.paths.as_deref().map_or(Ok(()), can_write)?;
    let text = std::fs::read_to_string(&args.problems).map_err(|e| unreadable(&args.problems, &e))?;
    let file = ProblemFile::parse(&text).map_err(|e| unreadable(&args.problems, &e))?;
    // The first pass brings code and allocator to where a running service has them.
    solved(&file, args.seed);
    let solved = solved(&file, args.seed);
    if let Some(path) = &args.paths {
        write_paths(path, &solved)?;
    }
    let report = Report {
        all: row(solved.values().flatten()),
        sets: solved.iter().map(|(set, solved)| (set.clone(), row(solved))).collect(),
        unsolved: failed(&solved),
        cylinders: "exact",
        seed: args.seed,
    };
    output.print(&report, || text_of(&report))
}

fn unreadable(path: &std::path::Path, error: &dyn std::fmt::Display) -> Failure {
    Failure::bad_input("problems", format!("{}: {error}", path.display()))
}

fn solved(file: &ProblemFile, seed: u64) -> Solved {
    let (rrt, simplify) = (RrtSettings::default(), SimplifySettings::default());
    let one = |p: &repose_motion::benchmark::PathProblem| (p.index, solve(p, file.arm(), &rrt, &simplify, seed));
    file.problems.iter().map(|(set, problems)| (set.clone(), problems.iter().map(one).collect())).collect()
}

fn row<'a>(solved: impl IntoIterator<Item = &'a (usize, Result<Solution, Unsolved>)>) -> Row {
    let (mut problems, mut valid, mut found) = (0, 0, Vec::new());
    for (_, result) in solved {
        problems += 1;
        valid += usize::from(!result.as_ref().is_err_and(Unsolved::is_invalid));
        found.extend(result.as_ref().ok());
    }
    Row {
        problems,
        valid,
        solved: found.len(),
        plan_us: times(found.iter().map(|s| s.plan)),
        plan_simplify_us: times(found.iter().map(|s| s.plan_simplify)),
        length_mean: found.iter().map(|s| length(&s.path)).collect::<Sorted>().mean(),
    }
}

fn times(durations: impl Iterator<Item = Duration>) -> Times {
    let us: Sorted = durations.map(|d| d.as_secs_f64() * 1e6).collect();
    Times { mean: us.mean(), p50: us.at_or_nan(0.5), p95: us.at_or_nan(0.95) }
}

fn failed(solved: &Solved) -> Vec<Failed> {
    let one = |set: &String, (index, result): &(usize, Result<Solution, Unsolved>)| {
        let reason = result.as_ref().err()?;
        Some(Failed { set: set.clone(), index: *index, invalid: reason.is_invalid(), reason: reason.to_string() })
    };
    solved.iter().flat_map(|(set, problems)| problems.iter().filter_map(move |p| one(set, p))).collect()
}

fn write_paths(to: &std::path::Path, solved: &Solved) -> CommandResult {
    let found = |(index, result): &'_ (usize, Result<Solution, Unsolved>)| Some((*index, result.as_ref().ok()?.path.clone()));
    let sets: BTreeMap<&String, Vec<_>> = solved.iter().map(|(set, problems)| (set, problems.iter().filter_map(found).collect())).collect();
    let sets: BTreeMap<&String, Vec<FoundPath<'_>>> =
        sets.iter().map(|(set, paths)| (*set, paths.iter().map(|(index, path)| FoundPath { index: *index, path }).collect())).collect();
    let text = serde_json::to_string(&serde_json::json!({ "paths": sets })).map_err(Failure::other)?;
    std::fs::write(to, text).map_err(|e| Failure::bad_input("paths", format!("{}: {e}", to.display())))
}

fn text_of(report: &Report) -> String {
    let mut table = table(["set", "solved", "valid", "plan µs mean", "p50", "p95", "simplified µs mean", "p50", "p95", "length rad"]);
    let rows = report.sets.iter().map(|(set, row)| (set.as_str(), row)).chain([("all", &report.all)]);
    for (set, row) in rows {
        let times = |t: &Times| [t.mean, t.p50, t.p95].map(|us| format!("{us:.0}"));
        let mut cells = vec![set.to_owned(), row.solved.to_string(), row.valid.to_string()];
        cells.extend(times(&row.plan_us));
        cells.extend(times(&row.plan_simplify_us));
        cells.push(format!("{:.3}", row.length_mean));
        table.add_row(cells);
    }
    let unsolved = report.unsolved.iter().map(|f| {
        let kind = if f.invalid { "invalid" } else { "not solved" };
        format!("\n{} {}: {kind}: {}", f.set, f.index, f.reason)
    });
    let legend = legend(&[
        ("valid", "problems whose start and goal are within limits and touch nothing"),
        ("plan, simplified", "time to a path, and to a path that has been shortened, too"),
        ("length", "of shortened paths in joint space, on average"),
    ]);
    format!("{table}\n{legend}{}", unsolved.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_means_and_quantiles_in_microseconds() {
        let times = times([3, 1, 2].into_iter().map(Duration::from_micros));
        assert_eq!((times.mean, times.p50, times.p95), (2.0, 2.0, 3.0));
        assert_eq!(row(&[]).problems, 0);
    }

    #[test]
    fn paths_that_cannot_be_written_are_refused_before_anything_is_searched() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let paths = file.path().join("paths.json");
        let args = BenchMotionArgs { problems: PathBuf::from("no/such/file"), paths: Some(paths), seed: 0 };
        let refused = run(&args, Output { json: false }).expect_err("a file is no folder");
        let field = refused.error().and_then(|e| e.field.as_deref());
        assert_eq!((refused.exit_code(), field), (2, file.path().to_str()));
    }
}
