//! From what passed to answers: ranked, distinct, each with its evidence, or the reason why there are none.

pub mod distinct;
pub mod placement;
pub mod relaxation;

use repose_proto::CallError;

use crate::answers::distinct::distinct;
use crate::judge::Judge;
use crate::judge::judged::JudgedCandidate;
use crate::search::findings::Findings;
use crate::search::ranking::{fill, rank};
use crate::search::stop::{StopReason, in_time};
use crate::settings::Realism;

/// The answers, once the search is over. Where networks only rank, they do so now; `control` is asked before each of their batches, and
/// `stopped` is told.
pub fn choose(
    judge: &mut Judge<'_>,
    findings: &mut Findings,
    stopped: &mut Option<StopReason>,
    control: &mut dyn FnMut() -> Option<StopReason>,
) -> Result<Vec<JudgedCandidate>, CallError> {
    let (settings, count) = (judge.problem().settings, judge.problem().request.count as usize);
    let apart = |accepted: &[JudgedCandidate]| distinct(accepted, count, settings.min_separation_m, settings.fixed.surrogate.level_gap_m);
    if settings.recipe.realism != Realism::OutcomeRanks {
        return Ok(apart(&findings.accepted));
    }
    let mut rest = Vec::new();
    if stopped.is_none() && !findings.accepted.is_empty() {
        // The shortlist is a batch like any other.
        *stopped = control();
        if stopped.is_none() {
            match in_time(rank(judge, findings, count))? {
                Some(unasked) => rest = unasked,
                None => *stopped = Some(StopReason::Deadline),
            }
        }
    }
    if stopped.is_some() {
        // Time ended before the networks ranked: what they have seen is one candidate at most, which they may not believe.
        let believed = |j: &&JudgedCandidate| j.realism.is_some_and(|f| f64::from(f) > settings.realism_threshold);
        return Ok(findings.appraised.iter().filter(believed).cloned().collect());
    }
    let mut chosen = apart(&findings.accepted);
    if !chosen.is_empty() {
        *stopped = fill(judge, findings, &mut chosen, rest, control)?;
    }
    Ok(chosen)
}
