//! The table of arrangements: how many tasks of a kind and size are solved, in how many moves and how fast, beside the two bars.

use std::collections::BTreeMap;

use repose_dataset::Split;
use repose_inference::Engine;
use repose_networks::serving::spread;
use repose_proto::CallError;
use repose_proto::place::Variant;
use serde::Serialize;

use crate::scenes::arrangement::carried_out::PlanFault;
use crate::scenes::arrangement::looking::LookingRecord;
use crate::scenes::arrangement::task::{ArrangementTask, Shapes, TaskKind};
use crate::scenes::arrangement::trial::{ArrangementTrialSettings, TaskRecord, try_task};
use crate::scenes::held_scenes::forecasts_of;
use crate::statistics::quantile::Sorted;
use crate::statistics::rate::Rate;

/// The tasks of a table.
#[derive(Debug, Clone)]
pub struct ArrangeTableSettings {
    /// Whose seeds.
    pub split: Split,
    /// The first slot of each kind and size.
    pub first: u64,
    /// Tasks of each kind and size.
    pub tasks: usize,
    /// The kinds.
    pub kinds: Vec<TaskKind>,
    /// The sizes: how many goals.
    pub goals: Vec<usize>,
    /// What is given of the objects' shapes.
    pub shapes: Vec<Shapes>,
    /// Which method finds each placement.
    pub variant: Variant,
    /// Whether a look after every move is tried, too.
    pub looks: bool,
    /// Whether the bars are tried, too.
    pub bars: bool,
    /// Threads; the table does not depend on it, but for times.
    pub threads: usize,
}

/// Tries every task; `seen` is given each record as it ends, in the order of kinds, sizes and slots.
///
/// # Errors
/// The planner's or the engine's, on a task that they should have been able to take; what `seen` returns.
pub fn evaluate_arrange<E: From<CallError>>(
    settings: &ArrangeTableSettings,
    engine: &Engine,
    mut seen: impl FnMut(TaskRecord) -> Result<(), E>,
) -> Result<(), E> {
    let forecasts = forecasts_of(engine).map_err(E::from)?;
    let slots = || settings.first..settings.first + settings.tasks as u64;
    let sizes = settings.kinds.iter().flat_map(|kind| settings.goals.iter().map(move |goals| (*kind, *goals)));
    let open: Vec<((TaskKind, usize), u64)> = sizes.flat_map(|size| slots().map(move |slot| (size, slot))).collect();
    for batch in open.chunks(settings.threads.max(1)) {
        let tried = spread(
            batch.len(),
            settings.threads,
            || (),
            |(), k| {
                let (size, slot) = batch[k];
                let Some(task) = ArrangementTask::of_slot(settings.split, size, slot) else { return Ok(Vec::new()) };
                let of_shapes = |shapes: &Shapes| {
                    let ArrangeTableSettings { variant, looks, bars, .. } = *settings;
                    let settings = ArrangementTrialSettings { shapes: *shapes, variant, looks, bars };
                    try_task(&task, slot, &settings, engine, &forecasts)
                };
                settings.shapes.iter().map(of_shapes).collect::<Result<Vec<_>, CallError>>()
            },
        );
        for records in tried {
            records.map_err(E::from)?.into_iter().try_for_each(&mut seen)?;
        }
    }
    Ok(())
}

/// The figures of a kind and size.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ArrangeRow {
    /// What makes the tasks hard; none for all kinds.
    pub kind: Option<TaskKind>,
    /// How many goals each has.
    pub goals: usize,
    /// What was given of the objects' shapes.
    pub shapes: Shapes,
    /// All goals held at the end, and every object stayed where it was put.
    pub solved: Rate,
    /// Moves of the plans that solved their task, of the fewest known for these tasks: 1 is as few.
    pub moves_of_fewest: Option<f64>,
    /// Median time of planning, milliseconds.
    pub p50_ms: f64,
    /// Median processor time of planning, milliseconds; none where it is not known.
    pub p50_processor_ms: Option<f64>,
    /// Median number of placements searched for.
    pub searches: f64,
    /// The same with a look after every move; none where that was not tried.
    pub looking: Option<LookingFigures>,
    /// The first bar: the goals one after another in the given order.
    pub in_order: Rate,
    /// The second bar: the same in a few random orders.
    pub random_order: Rate,
    /// What was wrong with the plans that failed.
    pub faults: BTreeMap<PlanFault, usize>,
}

/// The figures of tasks that were carried out with a look after every move.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LookingFigures {
    /// All goals held at the end, and every object stayed where it was put.
    pub solved: Rate,
    /// Moves made in the tasks that were solved, of the fewest known.
    pub moves_of_fewest: Option<f64>,
    /// Median time of the first plan, milliseconds.
    pub p50_ms: f64,
    /// Median time of each task's slowest plan, milliseconds.
    pub p50_longest_ms: f64,
    /// Median number of plans.
    pub plans: f64,
    /// What went wrong in those that were not.
    pub faults: BTreeMap<PlanFault, usize>,
}

/// One row a kind, size and shapes, and one for all kinds of a size.
pub fn arrange_rows(records: &[TaskRecord]) -> Vec<ArrangeRow> {
    let mut groups: BTreeMap<(Shapes, usize, Option<TaskKind>), Vec<&TaskRecord>> = BTreeMap::new();
    for record in records {
        for kind in [Some(record.kind), None] {
            groups.entry((record.shapes, record.goals, kind)).or_default().push(record);
        }
    }
    groups.into_iter().map(|((shapes, goals, kind), own)| row(kind, goals, shapes, &own)).collect()
}

fn row(kind: Option<TaskKind>, goals: usize, shapes: Shapes, records: &[&TaskRecord]) -> ArrangeRow {
    let solved = records.iter().filter(|r| r.solved()).map(|r| (r.known_moves, r.moves));
    let median = |of: &dyn Fn(&TaskRecord) -> f64| middle(records.iter().map(|r| of(r)));
    let bars = || records.iter().filter_map(|r| r.bars.as_ref());
    ArrangeRow {
        kind,
        goals,
        shapes,
        solved: records.iter().map(|r| r.solved()).collect(),
        moves_of_fewest: moves_of_fewest(solved),
        p50_ms: median(&|r| r.plan_ms),
        p50_processor_ms: Sorted::new(records.iter().filter_map(|r| r.processor_ms).collect()).at(0.5),
        searches: median(&|r| f64::from(r.searches)),
        looking: looking(records),
        in_order: bars().map(|b| b.in_order.is_none()).collect(),
        random_order: bars().map(|b| b.random_order.is_none()).collect(),
        faults: counted(records.iter().filter_map(|r| r.fault)),
    }
}

fn looking(records: &[&TaskRecord]) -> Option<LookingFigures> {
    let tried: Vec<(usize, &LookingRecord)> = records.iter().filter_map(|r| Some((r.known_moves, r.looking.as_ref()?))).collect();
    let solved = tried.iter().filter(|(_, l)| l.solved()).map(|(known, l)| (*known, l.moves));
    (!tried.is_empty()).then(|| LookingFigures {
        solved: tried.iter().map(|(_, l)| l.solved()).collect(),
        moves_of_fewest: moves_of_fewest(solved),
        p50_ms: middle(tried.iter().map(|(_, l)| l.first_plan_ms)),
        p50_longest_ms: middle(tried.iter().map(|(_, l)| l.longest_plan_ms)),
        plans: middle(tried.iter().map(|(_, l)| l.plans as f64)),
        faults: counted(tried.iter().filter_map(|(_, l)| l.fault)),
    })
}

/// Moves made of the fewest known, of tasks with their known moves and those that were made: a shorter way is the fewest known.
fn moves_of_fewest(solved: impl Iterator<Item = (usize, usize)>) -> Option<f64> {
    let (fewest, moves) = solved.fold((0, 0), |(fewest, moves), (known, made)| (fewest + known.min(made), moves + made));
    (fewest > 0).then(|| moves as f64 / fewest as f64)
}

fn middle(of: impl Iterator<Item = f64>) -> f64 {
    Sorted::new(of.collect()).at(0.5).unwrap_or(0.0)
}

fn counted(faults: impl Iterator<Item = PlanFault>) -> BTreeMap<PlanFault, usize> {
    let mut counts = BTreeMap::new();
    faults.for_each(|fault| *counts.entry(fault).or_default() += 1);
    counts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::arrangement::trial::Bars;

    fn record(kind: TaskKind, fault: Option<PlanFault>, moves: usize) -> TaskRecord {
        TaskRecord {
            kind,
            goals: 2,
            shapes: Shapes::Observed,
            slot: 0,
            seed: 1,
            asked: Vec::new(),
            known_moves: 3,
            moves,
            fault,
            at_move: None,
            failure: None,
            successes: Vec::new(),
            probability: None,
            searches: 4,
            plan_ms: 100.0,
            processor_ms: None,
            looking: None,
            bars: Some(Bars { in_order: Some(PlanFault::Goal), random_order: None }),
        }
    }

    #[test]
    fn moves_are_those_of_solved_tasks_and_a_shorter_way_is_the_fewest_known() {
        let records = [
            record(TaskKind::Swap, None, 4),
            record(TaskKind::Swap, None, 2),
            record(TaskKind::Swap, Some(PlanFault::Tipped), 9),
            record(TaskKind::Free, None, 3),
        ];
        let rows = arrange_rows(&records);
        let of = |kind: Option<TaskKind>| rows.iter().find(|r| r.kind == kind).expect("a row");
        let swap = of(Some(TaskKind::Swap));
        assert_eq!((swap.solved, swap.moves_of_fewest), (Rate { of: 2, n: 3 }, Some(6.0 / 5.0)));
        assert_eq!(swap.faults, BTreeMap::from([(PlanFault::Tipped, 1)]));
        let all = of(None);
        assert_eq!((all.solved.n, all.in_order.of, all.random_order.of), (4, 0, 4));
    }
}
