//! The highest open-loop rate that keeps an objective: doubled until it does not, then halved between.

use std::str::FromStr;
use std::time::Duration;

use repose_proto::limits;

use super::Run;
use super::report::{Ended, Report};
use crate::failure::Failure;

/// A percentile of the latency and its bound, `p99<1s`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Objective {
    percentile: &'static str,
    bound_ms: f64,
}

impl FromStr for Objective {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("expected a percentile and a bound, such as p99<1s or p50<200ms, got {text:?}");
        let (percentile, bound) = text.split_once('<').ok_or_else(wrong)?;
        let percentile = ["p50", "p90", "p95", "p99", "max"].into_iter().find(|known| *known == percentile.trim()).ok_or_else(wrong)?;
        let bound = bound.trim();
        let (number, unit_ms) = match (bound.strip_suffix("ms"), bound.strip_suffix('s')) {
            (Some(number), _) => (number, 1.0),
            (None, Some(number)) => (number, 1e3),
            (None, None) => return Err(wrong()),
        };
        let bound_ms = number.trim().parse::<f64>().map_err(|_| wrong())? * unit_ms;
        // No request lasts longer, and no rate would be offered for long enough to notice.
        let longest_ms = limits::MAX_REMAINING_MS as f64;
        if bound_ms > 0.0 && bound_ms <= longest_ms { Ok(Self { percentile, bound_ms }) } else { Err(wrong()) }
    }
}

impl Objective {
    /// How many requests a rate must be offered for: at a rate that is too high by a share, the latency grows by that share of the time, so that a run
    /// which is to notice [`NEARNESS`] lasts until that has grown to the bound.
    fn requests(&self, rate: f64) -> usize {
        (rate * self.bound_ms / 1e3 / NEARNESS).ceil() as usize
    }

    /// Whether a run kept it, and answered at least 99 %.
    fn is_kept(&self, report: &Report) -> bool {
        report.latency_ms.get(self.percentile).is_some_and(|ms| *ms < self.bound_ms) && report.answered_share() >= 0.99
    }
}

/// How near the capacity is found, as a share of it.
const NEARNESS: f64 = 0.05;
/// The rest between two rates: what one left in queues is not the next one's.
const REST: Duration = Duration::from_secs(1);

/// Finds the capacity; the report is of the highest rate that kept the objective, or of the lowest tried.
pub async fn find(run: &Run) -> Result<(Report, Vec<Ended>), Failure> {
    // A closed loop says about where it is.
    let about = run.ask(run.args.requests, None).await?.0.goodput_per_s.max(0.1);
    let (mut kept, mut failed, mut rate) = (None::<(f64, Report, Vec<Ended>)>, None::<f64>, about / 2.0);
    loop {
        tokio::time::sleep(REST).await;
        let requests = run.args.slo.requests(rate).max(run.args.requests);
        let (report, ended) = run.ask(requests, Some(rate)).await?;
        let is_kept = run.args.slo.is_kept(&report);
        tracing::info!(rate, is_kept, goodput = report.goodput_per_s, "tried");
        match is_kept {
            true => kept = Some((rate, report, ended)),
            false if rate < about / 64.0 => return Ok((Report { capacity_per_s: Some(0.0), ..report }, ended)),
            false => failed = Some(rate),
        }
        rate = match (&kept, failed) {
            (Some((low, ..)), Some(high)) if high - low <= NEARNESS * high => break,
            (Some((low, ..)), Some(high)) => (low + high) / 2.0,
            (Some((low, ..)), None) => low * 2.0,
            (None, _) => rate / 2.0,
        };
    }
    match kept {
        Some((rate, report, ended)) => Ok((Report { capacity_per_s: Some(rate), ..report }, ended)),
        None => Err(Failure::other("no rate kept the objective")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_offered_for_long_enough_to_notice_that_it_is_too_high() {
        let objective: Objective = "p99<1s".parse().unwrap();
        assert_eq!((objective.requests(7.0), objective.requests(1000.0)), (140, 20_000));
        assert_eq!("p50<100ms".parse::<Objective>().unwrap().requests(50.0), 100);
    }

    #[test]
    fn objectives_are_read_with_their_unit() {
        assert_eq!("p99<1s".parse(), Ok(Objective { percentile: "p99", bound_ms: 1000.0 }));
        assert_eq!("p50 < 20ms".parse(), Ok(Objective { percentile: "p50", bound_ms: 20.0 }));
        for wrong in ["p98<1s", "p99", "p99<1", "p99<-1s", "p99<s", "p99<infs", "p99<601s"] {
            assert!(wrong.parse::<Objective>().is_err(), "{wrong}");
        }
    }
}
