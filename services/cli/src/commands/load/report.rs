//! What a load run found: outcomes, rates, goodput, and latencies by outcome, priority and stage.

use std::collections::BTreeMap;
use std::time::Duration;

use hdrhistogram::Histogram;
use repose_proto::Priority;
use serde::{Deserialize, Serialize};

use super::own::Happened;
use crate::failure::Failure;

/// The outcome of a request that never ended.
const LOST: &str = "lost";
/// The longest latency that is told apart from longer ones, microseconds: the longest deadline, and some.
const LONGEST_US: u64 = 700_000_000;

/// The stages of an answered request, in their order.
pub const STAGES: [&str; 4] = ["client", "network", "queue", "compute"];

/// One request, ended.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Ended {
    /// Its kind, by its place in the mix.
    pub kind: usize,
    /// `result`, `none`, an error's code, or `lost`.
    pub outcome: String,
    /// Who waited.
    pub priority: Priority,
    /// Who answered.
    pub worker: Option<String>,
    /// When it was due, from the start of the run.
    pub due: Duration,
    /// From when it was due.
    pub took: Duration,
    /// Whether it ended after its deadline.
    pub late: bool,
    /// Milliseconds by stage; empty without an answer.
    pub stages_ms: BTreeMap<String, f64>,
}

impl Ended {
    /// A request of which nothing was heard.
    pub fn lost() -> Self {
        Self {
            kind: 0,
            outcome: LOST.to_owned(),
            priority: Priority::Interactive,
            worker: None,
            due: Duration::ZERO,
            took: Duration::ZERO,
            late: false,
            stages_ms: BTreeMap::new(),
        }
    }
}

/// What became of requests that were asked.
pub struct Asked {
    /// Each of them.
    pub ended: Vec<Ended>,
    /// Those that could not even begin.
    pub dropped: usize,
    /// Terminal replies beyond a call's one.
    pub duplicates: usize,
    /// How long all of it took.
    pub elapsed: Duration,
}

/// An answered request's time by stage: the client (from when it was due until it was sent), the network and whatever else is between the two
/// ends, the worker's queue, and computing.
pub fn stages(took: Duration, on_the_wire: Duration, worker_ms: &BTreeMap<String, f64>) -> BTreeMap<String, f64> {
    let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
    let of_worker = |stage: &str| worker_ms.get(stage).copied().unwrap_or(0.0);
    let (total, queue) = (of_worker("total"), of_worker("queue"));
    let times = [ms(took.saturating_sub(on_the_wire)), (ms(on_the_wire) - total).max(0.0), queue, (total - queue).max(0.0)];
    STAGES.into_iter().map(str::to_owned).zip(times).collect()
}

/// Percentiles, milliseconds.
pub type Percentiles = BTreeMap<&'static str, f64>;

/// Requests of one priority, or of one kind.
#[derive(Debug, Default, Serialize)]
pub struct OfSome {
    /// How many.
    pub requests: usize,
    /// How they ended.
    pub outcomes: BTreeMap<String, usize>,
    /// Latency of those that were answered.
    pub answered_ms: Percentiles,
}

/// What a run's light cells did.
#[derive(Debug, Default, Serialize)]
pub struct LightReport {
    /// How many there are.
    pub cells: usize,
    /// How long it took to start them, all at once, until the last was there.
    pub up_ms: f64,
    /// How long a client that came then took from its start until it had found all workers of the pool, and heard their loads.
    pub discovery_ms: Percentiles,
    /// Robot states that all cells put, and that their other sessions heard, a second.
    pub states_put_per_s: f64,
    /// Those heard.
    pub states_heard_per_s: f64,
    /// Summaries of scenes put, a second.
    pub summaries_put_per_s: f64,
    /// Times that a scene went to the pool, whole.
    pub scenes_sent: u64,
    /// The longest of the cells' median latencies over the shortest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slowest_over_fastest: Option<f64>,
}

/// What a run found.
#[derive(Debug, Default, Serialize)]
pub struct Report {
    /// Requests that began.
    pub requests: usize,
    /// `result`, `none`, error codes; `lost`: requests that never ended; `duplicate`: terminal replies beyond a call's one.
    pub outcomes: BTreeMap<String, usize>,
    /// Requests a second that were due.
    pub offered_per_s: f64,
    /// Requests a second that ended.
    pub achieved_per_s: f64,
    /// Requests that were answered within their deadline.
    #[serde(skip)]
    pub answered_in_time: usize,
    /// The same, a second.
    pub goodput_per_s: f64,
    /// The highest rate that kept the objective.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub capacity_per_s: Option<f64>,
    /// Requests of an open loop that could not begin, because too many were under way.
    pub dropped: usize,
    /// Requests that ended after their deadline.
    pub late: usize,
    /// Latency of all requests.
    pub latency_ms: Percentiles,
    /// Latency by outcome.
    pub outcome_latency_ms: BTreeMap<String, Percentiles>,
    /// Where the time of answered requests went.
    pub stages_ms: BTreeMap<&'static str, Percentiles>,
    /// By priority.
    pub priorities: BTreeMap<&'static str, OfSome>,
    /// By kind, where there are several.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub kinds: BTreeMap<String, OfSome>,
    /// What light cells did, where the run has them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light: Option<LightReport>,
    /// Answers by worker.
    pub per_worker: BTreeMap<String, usize>,
    /// Faults that the run caused, and processes that ended without it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<Happened>,
}

impl OfSome {
    fn of<'a>(ended: impl Iterator<Item = &'a Ended> + Clone) -> Result<Self, Failure> {
        let mut sum = Self { requests: ended.clone().count(), ..Self::default() };
        ended.clone().for_each(|end| *sum.outcomes.entry(end.outcome.clone()).or_default() += 1);
        sum.answered_ms = percentiles(ended.filter(|end| end.worker.is_some()).map(milliseconds))?;
        Ok(sum)
    }
}

impl Report {
    /// Sums up; `kinds` names the kinds of requests.
    pub fn new(asked: &Asked, rate: Option<f64>, kinds: &[String]) -> Result<Self, Failure> {
        let Asked { ended, dropped, duplicates, elapsed } = asked;
        let mut report = Self { requests: ended.len(), dropped: *dropped, ..Self::default() };
        report.outcomes = BTreeMap::from([(LOST.to_owned(), 0), ("duplicate".to_owned(), *duplicates)]);
        for end in ended {
            *report.outcomes.entry(end.outcome.clone()).or_default() += 1;
            if let Some(worker) = &end.worker {
                *report.per_worker.entry(worker.clone()).or_default() += 1;
            }
            report.late += usize::from(end.late);
        }
        let is_answered = |end: &&Ended| end.worker.is_some();
        let seconds = elapsed.as_secs_f64();
        report.achieved_per_s = ended.len() as f64 / seconds;
        report.offered_per_s = rate.unwrap_or(report.achieved_per_s);
        report.answered_in_time = ended.iter().filter(is_answered).filter(|end| !end.late).count();
        report.goodput_per_s = report.answered_in_time as f64 / seconds;
        report.latency_ms = percentiles(ended.iter().map(milliseconds))?;
        for outcome in ended.iter().map(|end| &end.outcome) {
            if !report.outcome_latency_ms.contains_key(outcome) {
                let of_it = percentiles(ended.iter().filter(|end| end.outcome == *outcome).map(milliseconds))?;
                report.outcome_latency_ms.insert(outcome.clone(), of_it);
            }
        }
        for stage in STAGES {
            report.stages_ms.insert(stage, percentiles(ended.iter().filter_map(|end| end.stages_ms.get(stage).copied()))?);
        }
        for (name, priority) in [("interactive", Priority::Interactive), ("batch", Priority::Batch)] {
            report.priorities.insert(name, OfSome::of(ended.iter().filter(|end| end.priority == priority))?);
        }
        for name in kinds.iter().filter(|_| kinds.len() > 1) {
            // Two of one name are the same kind, with a share each.
            report.kinds.insert(name.clone(), OfSome::of(ended.iter().filter(|end| kinds.get(end.kind) == Some(name)))?);
        }
        Ok(report)
    }

    /// The share of the requests that were answered, and not late.
    pub fn answered_share(&self) -> f64 {
        self.answered_in_time as f64 / (self.requests + self.dropped).max(1) as f64
    }
}

fn milliseconds(end: &Ended) -> f64 {
    end.took.as_secs_f64() * 1e3
}

/// Percentiles of times in milliseconds; empty of none.
pub fn percentiles(times_ms: impl Iterator<Item = f64>) -> Result<Percentiles, Failure> {
    let mut histogram = Histogram::<u64>::new_with_bounds(1, LONGEST_US, 3).map_err(Failure::other)?;
    times_ms.for_each(|ms| histogram.saturating_record((ms * 1e3) as u64));
    if histogram.is_empty() {
        return Ok(Percentiles::new());
    }
    let at = |quantile: f64| histogram.value_at_quantile(quantile) as f64 / 1e3;
    Ok(BTreeMap::from([("p50", at(0.5)), ("p90", at(0.9)), ("p95", at(0.95)), ("p99", at(0.99)), ("max", histogram.max() as f64 / 1e3)]))
}

fn counts(of: &BTreeMap<String, usize>) -> String {
    of.iter().map(|(name, count)| format!("{name} {count}")).collect::<Vec<_>>().join(", ")
}

fn in_words(of: &Percentiles) -> String {
    ["p50", "p90", "p95", "p99", "max"]
        .iter()
        .filter_map(|name| Some(format!("{name} {:.0}", of.get(name)?)))
        .collect::<Vec<_>>()
        .join(", ")
}

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{} requests: {}", self.requests, counts(&self.outcomes))?;
        if let Some(capacity) = self.capacity_per_s {
            writeln!(f, "capacity {capacity:.1}/s")?;
        }
        let (offered, achieved, goodput) = (self.offered_per_s, self.achieved_per_s, self.goodput_per_s);
        writeln!(
            f,
            "offered {offered:.1}/s, ended {achieved:.1}/s, answered in time {goodput:.1}/s; late {}, dropped {}",
            self.late, self.dropped
        )?;
        writeln!(f, "latency in ms: {}", in_words(&self.latency_ms))?;
        for (outcome, latency) in &self.outcome_latency_ms {
            writeln!(f, "  {outcome}: {}", in_words(latency))?;
        }
        for (stage, times) in self.stages_ms.iter().filter(|(_, times)| !times.is_empty()) {
            writeln!(f, "  in {stage}: {}", in_words(times))?;
        }
        let some =
            self.priorities.iter().map(|(name, of_it)| (*name, of_it)).chain(self.kinds.iter().map(|(name, of_it)| (name.as_str(), of_it)));
        for (name, of_it) in some.filter(|(_, of_it)| of_it.requests > 0) {
            writeln!(f, "{name}, {}: {}; answered in ms: {}", of_it.requests, counts(&of_it.outcomes), in_words(&of_it.answered_ms))?;
        }
        self.light.iter().try_for_each(|light| writeln!(f, "{light}"))?;
        if !self.faults.is_empty() {
            let mut faults: BTreeMap<String, usize> = BTreeMap::new();
            self.faults.iter().for_each(|fault| *faults.entry(fault.what.clone()).or_default() += 1);
            writeln!(f, "faults: {}", counts(&faults))?;
        }
        write!(f, "answers by worker: {}", counts(&self.per_worker))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_that_is_lost_or_late_is_missing_once_from_what_was_answered() {
        let answered = Ended { outcome: "result".to_owned(), worker: Some("planner-1".to_owned()), ..Ended::lost() };
        let mut ended = vec![answered.clone(); 97];
        // Who hears of nothing waits beyond the deadline.
        ended.extend([Ended { late: true, ..Ended::lost() }, Ended { late: true, ..answered }]);
        let asked = Asked { ended, dropped: 1, duplicates: 0, elapsed: Duration::from_secs(10) };
        let report = Report::new(&asked, None, &[]).unwrap_or_else(|e| panic!("{e:?}"));
        assert_eq!((report.late, report.goodput_per_s, report.answered_share()), (2, 9.7, 0.97));
    }

    #[test]
    fn kinds_of_one_name_are_told_together() {
        let ended = [0, 0, 1].map(|kind| Ended { kind, ..Ended::lost() }).to_vec();
        let asked = Asked { ended, dropped: 0, duplicates: 0, elapsed: Duration::from_secs(1) };
        let report = Report::new(&asked, None, &["count=2", "count=2"].map(str::to_owned)).unwrap_or_else(|e| panic!("{e:?}"));
        assert_eq!(report.kinds.values().map(|kind| kind.requests).collect::<Vec<_>>(), [3]);
    }
}
