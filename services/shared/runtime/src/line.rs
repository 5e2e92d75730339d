//! The jobs of one priority that wait, in the order that shares a worker out among cells.
//!
//! Start-time fair queueing (Goyal, Vin and Cheng 1996): every cell has a virtual time at which its next job starts; the cell whose is the earliest has
//! its turn, and each job that it has computed puts it off by the job's cost over the cell's weight. A cell that comes, or comes back, starts now:
//! it has saved up no turns, and waits behind none that others have queued. Within a cell the oldest goes first, and so it does where there is one.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Instant;

use crate::job::Job;
use crate::shares::{ForCell, Shares};

/// Cells without a job that are remembered, so that they do not have their turn again at once.
const REMEMBERED: usize = 1024;

/// Jobs that are being computed, by cell.
pub(crate) struct Running {
    counts: BTreeMap<Arc<str>, usize>,
    shares: Arc<Shares>,
}

impl Running {
    pub(crate) fn none(shares: Arc<Shares>) -> Self {
        Self { counts: BTreeMap::new(), shares }
    }

    /// How many a cell has.
    pub(crate) fn of(&self, cell: &str) -> usize {
        self.counts.get(cell).copied().unwrap_or(0)
    }

    fn has_room_for(&self, cell: &ForCell) -> bool {
        cell.as_ref().is_none_or(|cell| self.of(cell) < self.shares.max_running(cell))
    }

    pub(crate) fn start(&mut self, cell: &ForCell) {
        if let Some(cell) = cell {
            *self.counts.entry(cell.clone()).or_default() += 1;
        }
    }

    pub(crate) fn finish(&mut self, cell: &ForCell) {
        if let Some(cell) = cell
            && let Some(count) = self.counts.get_mut(cell)
        {
            *count -= 1;
            if *count == 0 {
                self.counts.remove(cell);
            }
        }
    }
}

/// The jobs of one priority that wait.
pub(crate) struct Line<R, T> {
    cells: BTreeMap<ForCell, CellLine<R, T>>,
    /// The virtual time: when the newest of the jobs that are computed started.
    now: f64,
    weigh: fn(&R) -> usize,
    shares: Arc<Shares>,
}

struct CellLine<R, T> {
    jobs: VecDeque<Job<R, T>>,
    /// The virtual time at which the first of them starts.
    next: f64,
}

/// A job that waits, and when its turn is.
struct Turn<'a, R, T> {
    start: f64,
    cell: &'a ForCell,
    /// Its place among its cell's.
    index: usize,
    job: &'a Job<R, T>,
}

impl<R, T> Line<R, T> {
    pub(crate) fn new(weigh: fn(&R) -> usize, shares: Arc<Shares>) -> Self {
        Self { cells: BTreeMap::new(), now: 0.0, weigh, shares }
    }

    pub(crate) fn len(&self) -> usize {
        self.cells.values().map(|line| line.jobs.len()).sum()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many jobs of a cell wait.
    pub(crate) fn held_by(&self, cell: &ForCell) -> usize {
        self.cells.get(cell).map_or(0, |line| line.jobs.len())
    }

    pub(crate) fn push(&mut self, job: Job<R, T>) {
        let now = self.now;
        let line = self.cells.entry(job.context.cell.clone()).or_insert_with(|| CellLine { jobs: VecDeque::new(), next: now });
        if line.jobs.is_empty() {
            line.next = line.next.max(now);
        }
        line.jobs.push_back(job);
    }

    /// The job whose turn it is, of a cell that may have another one running.
    pub(crate) fn front(&self, running: &Running) -> Option<&Job<R, T>> {
        self.turn(running).and_then(|cell| self.cells[cell].jobs.front())
    }

    /// Takes it out. Nothing is charged for it: that is [`Line::charge`]'s, once somebody turns out to wait for it still.
    pub(crate) fn pop(&mut self, running: &Running) -> Option<Job<R, T>> {
        let cell = self.turn(running)?.clone();
        self.cells.get_mut(&cell)?.jobs.pop_front()
    }

    /// Counts a job that was taken out as computed for its cell.
    pub(crate) fn charge(&mut self, job: &Job<R, T>) {
        let cost = self.cost(job);
        if let Some(line) = self.cells.get_mut(&job.context.cell) {
            self.now = self.now.max(line.next);
            line.next += cost;
        }
        let now = self.now;
        self.cells.retain(|_, line| !line.jobs.is_empty() || line.next > now);
        if self.cells.len() > self.len() + REMEMBERED {
            self.cells.retain(|_, line| !line.jobs.is_empty());
        }
    }

    /// How many of the jobs that wait go before a new one for a cell.
    pub(crate) fn ahead_of(&self, cell: &ForCell) -> usize {
        let start = match self.cells.get(cell) {
            Some(line) => line.next.max(self.now) + line.jobs.iter().map(|job| self.cost(job)).sum::<f64>(),
            None => self.now,
        };
        self.in_order().iter().filter(|turn| turn.start <= start).count()
    }

    /// Takes out the job that would go last.
    pub(crate) fn pop_last(&mut self) -> Option<Job<R, T>> {
        let cell = self.in_order().last()?.cell.clone();
        // The last of all is the last of its cell.
        self.cells.get_mut(&cell)?.jobs.pop_back()
    }

    /// Takes out those of which `is_gone` says so; it is asked in the order in which they go.
    pub(crate) fn remove_where(&mut self, mut is_gone: impl FnMut(&Job<R, T>) -> bool) -> Vec<Job<R, T>> {
        let gone = self.in_order().into_iter().filter(|turn| is_gone(turn.job));
        let mut gone: Vec<(ForCell, usize)> = gone.map(|turn| (turn.cell.clone(), turn.index)).collect();
        // From the back, so that the places of those before stay.
        gone.sort_by_key(|(_, index)| std::cmp::Reverse(*index));
        gone.into_iter().filter_map(|(cell, index)| self.cells.get_mut(&cell)?.jobs.remove(index)).collect()
    }

    /// Whether something holds of one of them, and of how many go before it.
    pub(crate) fn any(&self, mut holds: impl FnMut(usize, &Job<R, T>) -> bool) -> bool {
        self.in_order().iter().enumerate().any(|(before, turn)| holds(before, turn.job))
    }

    fn turn(&self, running: &Running) -> Option<&ForCell> {
        let first = |line: &CellLine<R, T>| line.jobs.front().map(|job| (line.next, job.queued));
        let waiting = self.cells.iter().filter_map(|(cell, line)| Some((first(line)?, cell)));
        waiting.filter(|(_, cell)| running.has_room_for(cell)).min_by(|(a, _), (b, _)| earlier(*a, *b)).map(|(_, cell)| cell)
    }

    fn in_order(&self) -> Vec<Turn<'_, R, T>> {
        let mut turns = Vec::with_capacity(self.len());
        for (cell, line) in &self.cells {
            let mut start = line.next;
            for (index, job) in line.jobs.iter().enumerate() {
                turns.push(Turn { start, cell, index, job });
                start += self.cost(job);
            }
        }
        turns.sort_by(|a, b| earlier((a.start, a.job.queued), (b.start, b.job.queued)));
        turns
    }

    /// By how much a job puts off its cell's next.
    fn cost(&self, job: &Job<R, T>) -> f64 {
        let weight = job.context.cell.as_ref().map_or(1.0, |cell| self.shares.weight(cell));
        (self.weigh)(&job.request).max(1) as f64 / weight
    }
}

/// By virtual time, and the older one first where that is the same.
fn earlier(a: (f64, Instant), b: (f64, Instant)) -> std::cmp::Ordering {
    a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
}
