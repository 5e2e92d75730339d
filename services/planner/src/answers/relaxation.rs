//! The one goal term to give up where nothing passes.

use repose_proto::CallError;
use repose_proto::place::{PlaceRequest, Relaxation};

use crate::judge::Judge;
use crate::judge::problem::PlacementProblem;
use crate::judge::scorer::Question;
use crate::search::findings::Findings;
use crate::settings::Realism;

/// The goal term whose removal would have admitted the most candidates; never the only one that must hold, which offsets are taken from.
///
/// Where networks decide what is realistic, a sample of each term's candidates is put to them, and stands for all; once time has ended
/// they cannot be asked, and no term is named.
pub fn relaxation(judge: &mut Judge<'_>, findings: &Findings, stopped: bool) -> Result<Option<Relaxation>, CallError> {
    let PlacementProblem { request: PlaceRequest { goal, .. }, settings, .. } = judge.problem();
    let asks = matches!(settings.recipe.realism, Realism::Discriminator | Realism::OutcomeRanks);
    if asks && stopped {
        return Ok(None);
    }
    let positive = goal.iter().filter(|t| t.holds).count();
    let mut best: Option<Relaxation> = None;
    for (position, kept_out) in &findings.kept_out {
        let term = goal[*position];
        if term.holds && positive == 1 {
            continue;
        }
        let mut admits = kept_out.count;
        if asks {
            let mut sample = kept_out.sample.clone();
            let all: Vec<usize> = (0..sample.len()).collect();
            judge.scorer_mut().ask(Question::Realism, &mut sample, &all)?;
            let believed = sample.iter().filter(|j| j.realism.is_some_and(|f| f64::from(f) > settings.realism_threshold)).count();
            admits = (kept_out.count as f64 * believed as f64 / sample.len().max(1) as f64).round() as u64;
        }
        if admits > best.as_ref().map_or(0, |b| b.admits) {
            best = Some(Relaxation { term, admits });
        }
    }
    Ok(best)
}
