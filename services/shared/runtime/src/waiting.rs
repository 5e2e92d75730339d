//! The jobs that wait: who is let in, and who goes next.
//!
//! Interactive jobs go before batch ones, which get a turn after some were let by, and when they would be late otherwise: what was let in is done.
//! Batch leaves half of the places to interactive jobs, of which one takes the youngest batch job's place where there is none left. A job that could
//! not be done by its deadline is refused at once. Among jobs of one priority cells take turns ([`Line`]), and one that floods leaves places to the
//! others.

use std::sync::Arc;

use repose_proto::{CallError, ErrorCode, Priority};

use crate::gauge::LoadGauge;
use crate::job::{Job, JobContext};
use crate::line::{Line, Running};
use crate::shares::{ForCell, Shares, leaves_room};

/// Interactive jobs that may be taken before a batch job that waits: no more, or a busy service would never come to it.
pub(crate) const LET_BY: usize = 16;
/// How much longer than expected the jobs before one may take and it still is in time: what is expected follows a machine that others use, too.
const WAIT_MARGIN: f64 = 1.5;
/// How many times their smoothed distance from the mean a job may take longer than that: one in a hundred does, of times that are spread as usual.
const SPREADS: f64 = 3.0;
/// Weight of the newest job in the share of interactive ones: about the last sixteen count.
const SMOOTHING: f64 = 1.0 / 16.0;
/// The most that interactive jobs can take, since batch ones get a turn after some were let by.
const MOST_INTERACTIVE: f64 = LET_BY as f64 / (LET_BY + 1) as f64;

/// How long a job may take that waits for so many rounds of others, with a margin, milliseconds.
fn needed_ms(rounds: f64, gauge: &LoadGauge) -> f64 {
    (rounds * WAIT_MARGIN + 1.0) * gauge.service_ms() + SPREADS * gauge.spread_ms()
}

/// How many jobs may wait before one of a priority is refused: batch leaves half of the places to interactive jobs.
fn places(capacity: usize, priority: Priority) -> usize {
    match priority {
        Priority::Interactive => capacity,
        Priority::Batch => capacity.div_ceil(2),
    }
}

/// Why a job cannot be taken.
#[derive(Debug, PartialEq)]
pub(crate) enum Refusal {
    /// There is no place.
    Full { waiting: usize },
    /// There is none for its cell.
    CellFull { cell: Arc<str>, waiting: usize },
    /// It could not be done by its deadline.
    TooLate { expected_ms: f64, left_ms: f64 },
}

impl From<&Refusal> for CallError {
    fn from(refusal: &Refusal) -> Self {
        let exhausted = |message| Self::new(ErrorCode::ResourceExhausted, message);
        match refusal {
            Refusal::Full { waiting } => exhausted(format!("{waiting} calls wait already")),
            Refusal::CellFull { cell, waiting } => {
                exhausted(format!("{waiting} calls of cell {cell} wait already, as many as it may have here")).at("cell")
            }
            Refusal::TooLate { expected_ms, left_ms } => {
                exhausted(format!("it would take about {expected_ms:.0} ms and {left_ms:.0} ms are left"))
            }
        }
    }
}

/// The jobs that wait.
pub(crate) struct WaitingJobs<R, T> {
    interactive: Line<R, T>,
    batch: Line<R, T>,
    running: Running,
    weigh: fn(&R) -> usize,
    shares: Arc<Shares>,
    /// Interactive jobs taken while a batch job waited, since the last batch job.
    let_by: usize,
    /// The smoothed share of interactive jobs among those taken.
    interactive_share: f64,
}

impl<R, T> WaitingJobs<R, T> {
    /// None yet. `weigh` says what a job costs its cell, and how much of a batch it takes.
    pub(crate) fn new(weigh: fn(&R) -> usize, shares: Arc<Shares>) -> Self {
        let line = || Line::new(weigh, shares.clone());
        let (interactive, batch, running) = (line(), line(), Running::none(shares.clone()));
        Self { interactive, batch, running, weigh, shares, let_by: 0, interactive_share: 0.0 }
    }

    pub(crate) fn waiting(&self) -> usize {
        self.interactive.len() + self.batch.len()
    }

    /// Jobs that go before a new one.
    fn ahead(&self, context: &JobContext) -> usize {
        match context.priority {
            Priority::Interactive => self.interactive.ahead_of(&context.cell),
            Priority::Batch => self.interactive.len() + self.batch.ahead_of(&context.cell),
        }
    }

    /// The youngest batch job, where an interactive one needs its place.
    pub(crate) fn displaced_by(&mut self, priority: Priority, capacity: usize) -> Option<Job<R, T>> {
        match (self.waiting() >= places(capacity, priority), priority) {
            (true, Priority::Interactive) => self.batch.pop_last(),
            _ => None,
        }
    }

    /// Puts a displaced job back.
    pub(crate) fn restore(&mut self, displaced: Option<Job<R, T>>) {
        displaced.into_iter().for_each(|job| self.batch.push(job));
    }

    /// Why a job cannot be taken, if it cannot.
    pub(crate) fn refusal(&self, context: &JobContext, capacity: usize, threads: usize, gauge: &LoadGauge) -> Option<Refusal> {
        let (waiting, places) = (self.waiting(), places(capacity, context.priority));
        if waiting >= places {
            return Some(Refusal::Full { waiting });
        }
        if let Some(cell) = &context.cell {
            let held = self.interactive.held_by(&context.cell) + self.batch.held_by(&context.cell);
            if held >= self.shares.max_waiting(cell) || !leaves_room(held, waiting, places) {
                return Some(Refusal::CellFull { cell: cell.clone(), waiting: held });
            }
        }
        let ahead = self.ahead(context);
        if ahead == 0 && gauge.running() < threads.max(1) {
            // An idle queue takes anything: a deadline that looks too short may do, and a smoothed time has to be able to fall again.
            return None;
        }
        // Those that run are half done, in the mean.
        let rounds = (ahead as f64 + gauge.running().min(threads.max(1)) as f64 / 2.0) / threads.max(1) as f64;
        let expected_ms = match context.priority {
            // Somebody waits for it: it is refused where it would be late, not where it might be.
            Priority::Interactive => (rounds + 1.0) * gauge.service_ms(),
            // It also waits for the interactive ones that are still to come.
            Priority::Batch => needed_ms(rounds / (1.0 - self.interactive_share.min(MOST_INTERACTIVE)), gauge),
        };
        let left_ms = context.remaining().as_secs_f64() * 1e3;
        (expected_ms > left_ms).then_some(Refusal::TooLate { expected_ms, left_ms })
    }

    pub(crate) fn push(&mut self, job: Job<R, T>) {
        self.line(job.context.priority).push(job);
    }

    fn line(&mut self, priority: Priority) -> &mut Line<R, T> {
        match priority {
            Priority::Interactive => &mut self.interactive,
            Priority::Batch => &mut self.batch,
        }
    }

    /// Whether a batch job that may run has let enough by, or one would be late if it, and those before it, let more by.
    fn is_batch_due(&self, threads: usize, gauge: &LoadGauge) -> bool {
        let is_late = |before: usize, job: &Job<R, T>| {
            let rounds = (before as f64 + 0.5) / threads.max(1) as f64;
            job.context.remaining().as_secs_f64() * 1e3 <= needed_ms(rounds, gauge)
        };
        self.batch.front(&self.running).is_some() && (self.let_by >= LET_BY || self.batch.any(is_late))
    }

    /// The next job to go with those taken already, if there is room for it: the next interactive one, unless a batch job is due. A batch job
    /// that is not due would only delay the interactive ones beside it.
    pub(crate) fn pop(&mut self, taken: &mut JobBatch<R, T>, threads: usize, gauge: &LoadGauge) -> Option<Job<R, T>> {
        let has_interactive = self.interactive.front(&self.running).is_some();
        // Only where an interactive job would have to let it by.
        let is_due = (has_interactive || taken.is_interactive()) && self.is_batch_due(threads, gauge);
        let is_interactive = !is_due && has_interactive;
        if !is_interactive && !is_due && taken.is_interactive() {
            return None;
        }
        let line = if is_interactive { &mut self.interactive } else { &mut self.batch };
        taken.is_full |= line.front(&self.running).is_some_and(|job| !taken.has_room_for((self.weigh)(&job.request)));
        let job = if taken.is_full { None } else { line.pop(&self.running) }?;
        self.let_by = if is_interactive && !self.batch.is_empty() { self.let_by + 1 } else { 0 };
        self.interactive_share += SMOOTHING * (f64::from(u8::from(is_interactive)) - self.interactive_share);
        Some(job)
    }

    /// Counts a job that was taken as one that runs, for its cell.
    pub(crate) fn start(&mut self, job: &Job<R, T>) {
        self.line(job.context.priority).charge(job);
        self.running.start(&job.context.cell);
    }

    /// Counts a job for a cell as done.
    pub(crate) fn finish(&mut self, cell: &ForCell) {
        self.running.finish(cell);
    }

    /// Forgets those nobody waits for: they take no place, of all or of their cell, and no time from those behind them.
    pub(crate) fn drop_abandoned(&mut self) {
        for line in [&mut self.interactive, &mut self.batch] {
            drop(line.remove_where(|job| !job.reply.is_awaited()));
        }
    }
}

/// Jobs handed to a worker thread together.
pub(crate) struct JobBatch<R, T> {
    pub(crate) jobs: Vec<Job<R, T>>,
    weight: usize,
    max_weight: usize,
    /// No more jobs, or none as heavy as the next.
    pub(crate) is_full: bool,
}

impl<R, T> JobBatch<R, T> {
    /// None yet; `max_weight` of them at most.
    pub(crate) fn none(max_weight: usize) -> Self {
        Self { jobs: Vec::new(), weight: 0, max_weight, is_full: false }
    }

    fn has_room_for(&self, weight: usize) -> bool {
        self.jobs.is_empty() || self.weight.saturating_add(weight) <= self.max_weight
    }

    fn is_interactive(&self) -> bool {
        self.jobs.iter().any(|job| job.context.priority == Priority::Interactive)
    }

    pub(crate) fn push(&mut self, job: Job<R, T>, weight: usize, most: usize) {
        self.weight = self.weight.saturating_add(weight);
        self.jobs.push(job);
        self.is_full = self.jobs.len() >= most;
    }

    /// The jobs, interactive ones first.
    pub(crate) fn in_order(mut self) -> Vec<Job<R, T>> {
        self.jobs.sort_by_key(|job| job.context.priority == Priority::Batch);
        self.jobs
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::sync::oneshot;

    use super::*;
    use crate::job::JobReply;

    fn waiting() -> WaitingJobs<(), ()> {
        WaitingJobs::new(|()| 1, Arc::default())
    }

    fn push(waiting: &mut WaitingJobs<(), ()>, priority: Priority) -> oneshot::Receiver<Result<(), CallError>> {
        push_within(waiting, Duration::from_secs(60), priority)
    }

    fn push_within(waiting: &mut WaitingJobs<(), ()>, within: Duration, priority: Priority) -> oneshot::Receiver<Result<(), CallError>> {
        let (reply, answer) = oneshot::channel();
        let context = JobContext::within(within).with_priority(priority);
        waiting.push(Job { queued: std::time::Instant::now(), request: (), context, reply: JobReply(reply) });
        answer
    }

    #[test]
    fn a_batch_job_reckons_with_the_interactive_ones_that_will_go_before_it() {
        let (mut waiting, gauge) = (waiting(), LoadGauge::default());
        gauge.started(1);
        gauge.finished(1, Duration::from_millis(1000));
        gauge.started(1);
        let _awaited = [push(&mut waiting, Priority::Batch), push(&mut waiting, Priority::Batch)];
        let within_5_s = |priority| JobContext::within(Duration::from_secs(5)).with_priority(priority);
        let refusal = |waiting: &WaitingJobs<(), ()>, priority| waiting.refusal(&within_5_s(priority), 64, 1, &gauge);
        assert_eq!(refusal(&waiting, Priority::Batch), None, "half a job and two before it, and itself: 4.75 s");
        for _ in 0..8 {
            let _answer = push(&mut waiting, Priority::Interactive);
            assert!(waiting.pop(&mut JobBatch::none(usize::MAX), 1, &gauge).is_some());
        }
        let too_late = refusal(&waiting, Priority::Batch);
        assert!(matches!(too_late, Some(Refusal::TooLate { left_ms, .. }) if (4900.0..=5000.0).contains(&left_ms)), "{too_late:?}");
        assert_eq!(refusal(&waiting, Priority::Interactive), None, "those go before what waits");
    }

    #[test]
    fn a_batch_job_that_was_let_in_is_done_by_its_deadline_whoever_comes() {
        let gauge = LoadGauge::default();
        gauge.started(1);
        gauge.finished(1, Duration::from_secs(10));
        // Half of one that runs, one before it, with a margin, and itself: 32.5 s.
        for (left_s, first) in [(35, Priority::Interactive), (30, Priority::Batch)] {
            let mut waiting = waiting();
            let within = |waiting: &mut _, left_s, priority| push_within(waiting, Duration::from_secs(left_s), priority);
            let _awaited = [(60, Priority::Batch), (left_s, Priority::Batch), (60, Priority::Interactive)]
                .map(|(left_s, priority)| within(&mut waiting, left_s, priority));
            let popped = waiting.pop(&mut JobBatch::none(usize::MAX), 1, &gauge).map(|job| job.context.priority);
            assert_eq!(popped, Some(first), "{left_s} s left");
        }
    }
}
