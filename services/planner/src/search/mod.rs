//! Algorithm 1 of the paper: the cross-entropy method over placements, one search per mode, the best of all seen wins.
//!
//! Iteration 0 draws from the prior (or the goal's geometry), later ones from the refitted Gaussians. (The pseudocode's range(1, N) with
//! s = 0 is a slip: iteration 0 is the prior's.) Everything depends on the request's seed alone.
//!
//! Iteration 0 draws `batch` candidates at a time until `batch` have passed every constraint or `draws_per_batch` × `batch` were drawn;
//! the prior is asked once, for at most as many draws as one request may have, and without proposals from geometry their end is the
//! iteration's. In later iterations every mode has its share of `batch`, rounded down but at least one, and draws its whole share at a
//! time until as many have passed or `draws_per_batch` times as many were drawn. What rounding leaves over, or a mode that has its fill,
//! goes to no other mode; and as the last draws are whole shares too, more than `batch` may pass.
//!
//! An object that no place can be found for, as it tips or unsettles a neighbour, is tried in one batch, for the reason to be told.

pub mod findings;
pub mod levels;
pub mod modes;
pub mod proposals;
pub mod ranking;
pub mod source;
pub mod stop;
pub mod surrogate;

use std::ops::ControlFlow;

use rand_pcg::Pcg64;
use repose_proto::CallError;

use crate::judge::Judge;
use crate::judge::judged::JudgedCandidate;
use crate::judge::problem::PlacementProblem;
use crate::scene::candidate::CandidatePose;
use crate::search::findings::Findings;
use crate::search::levels::assign_levels;
use crate::search::modes::{SearchMode, refit};
use crate::search::ranking::appraise;
use crate::search::source::CandidateSource;
use crate::search::stop::{StopReason, in_time};
use crate::settings::Realism;

/// Searches. `control` is asked before every batch (`None`) and told of every iteration done; it may stop the search.
///
/// Returns what was found, and why it stopped early if it did: time may also end while the networks are asked.
///
/// # Errors
/// What the networks answer; `deadline_exceeded` only before the first iteration was done.
pub fn search(
    judge: &mut Judge<'_>,
    mut source: CandidateSource<'_>,
    rng: &mut Pcg64,
    control: &mut dyn FnMut(Option<&Findings>) -> ControlFlow<StopReason>,
) -> Result<(Findings, Option<StopReason>), CallError> {
    let problem = judge.problem();
    let settings = problem.settings;
    let surrogate = &settings.fixed.surrogate;
    let mut findings = Findings::default();
    let mut modes: Vec<SearchMode> = Vec::new();
    for iteration in 0..settings.iterations {
        let mut judged: Vec<JudgedCandidate> = Vec::new();
        let mut quotas = vec![Quota::default(); modes.len().max(1)];
        loop {
            if let ControlFlow::Break(stop) = control(None) {
                return Ok((findings, Some(stop)));
            }
            let batch = if iteration == 0 {
                let count = quotas[0].next(settings.batch, settings.draws_per_batch);
                source.draw(count, &problem, rng)
            } else {
                // While next to nothing is feasible, the modes only lead to where least is missed or to one place: most draws still go where the
                // goal is.
                let few = findings.accepted.len() < settings.fixed.proposals.fresh_until;
                let fresh = (few && source.is_endless()).then_some(&mut source);
                draw_from_modes(&modes, &mut quotas, fresh, &problem, rng)
            };
            if batch.is_empty() {
                break;
            }
            let tried = match judge.judge(&batch) {
                tried if findings.iterations == 0 => tried?,
                tried => match in_time(tried)? {
                    Some(tried) => tried,
                    None => return Ok((findings, Some(StopReason::Deadline))),
                },
            };
            findings.record(&tried);
            for j in &tried {
                let slot = if iteration == 0 { 0 } else { modes.iter().position(|m| m.id == j.mode).unwrap_or(0) };
                quotas[slot].accepted += usize::from(j.feasible());
            }
            judged.extend(tried);
            if judge.refuses_all() {
                break;
            }
        }
        if iteration == 0 && settings.recipe.grounded {
            assign_levels(&mut judged, surrogate.level_gap_m);
        }
        modes = refit(modes, judged, settings.elites, settings.rotation, surrogate);
        findings.iterations = iteration + 1;
        // After the last iteration the whole shortlist is put to the networks.
        let last = iteration + 1 == settings.iterations && !findings.heard.is_empty();
        if settings.recipe.realism == Realism::OutcomeRanks && !last && in_time(appraise_best(judge, &mut findings))?.is_none() {
            return Ok((findings, Some(StopReason::Deadline)));
        }
        if let ControlFlow::Break(stop) = control(Some(&findings)) {
            let early = (iteration + 1 < settings.iterations).then_some(stop);
            return Ok((findings, early.or((stop == StopReason::Cancelled).then_some(stop))));
        }
        if modes.is_empty() || judge.refuses_all() {
            break;
        }
    }
    Ok((findings, None))
}

/// Puts the best so far to the networks, if they have not seen it before.
fn appraise_best(judge: &mut Judge<'_>, findings: &mut Findings) -> Result<(), CallError> {
    let is_new = |best: &&JudgedCandidate| findings.heard.iter().all(|heard| heard.candidate != best.candidate);
    let Some(best) = findings.best().filter(is_new) else { return Ok(()) };
    let mut best = [best.clone()];
    appraise(judge, &mut best)?;
    findings.heard.extend(best);
    Ok(())
}

/// How much of an iteration's draws a mode has had.
#[derive(Debug, Clone, Copy, Default)]
struct Quota {
    drawn: usize,
    accepted: usize,
}

impl Quota {
    /// How many to draw next, 0 when the mode has its accepted candidates or has drawn its fill.
    fn next(&mut self, wanted: usize, draws_per_batch: usize) -> usize {
        let missing = wanted.saturating_sub(self.accepted);
        let left = (wanted * draws_per_batch).saturating_sub(self.drawn);
        // A whole batch at a time where few pass: the networks like batches.
        let count = if missing == 0 { 0 } else { wanted.min(left) };
        self.drawn += count;
        count
    }
}

/// The next draws of every mode, within their quotas; with a source of fresh candidates, three of four are from there.
fn draw_from_modes(
    modes: &[SearchMode],
    quotas: &mut [Quota],
    mut fresh: Option<&mut CandidateSource<'_>>,
    problem: &PlacementProblem<'_>,
    rng: &mut Pcg64,
) -> Vec<(CandidatePose, usize)> {
    let settings = problem.settings;
    let mut out = Vec::new();
    let mut left = settings.batch;
    for (mode, quota) in modes.iter().zip(quotas) {
        let wanted = ((settings.batch as f64 * mode.share) as usize).max(1).min(left);
        left -= wanted;
        let count = quota.next(wanted, settings.draws_per_batch);
        let mut from_mode = count;
        if let Some(source) = fresh.as_deref_mut() {
            from_mode = count.div_ceil(4);
            out.extend(source.draw(count - from_mode, problem, rng).into_iter().map(|(candidate, _)| (candidate, mode.id)));
        }
        for _ in 0..from_mode {
            let drawn = mode.surrogate.draw(rng);
            out.push((problem.settled(&drawn, problem.ceiling_over(&drawn)), mode.id));
        }
    }
    out
}
