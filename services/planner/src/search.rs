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

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use rand_pcg::Pcg64;
use repose_proto::place::Rejection;
use repose_proto::{CallError, ErrorCode};

use crate::candidate::Candidate;
use crate::judge::Judge;
use crate::judged::Judged;
use crate::modes::{Mode, assign_levels, refit};
use crate::proposals::Proposer;
use crate::ranking::appraise;
use crate::settings::Realism;

/// Why a search stops early.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// Nobody waits for the answer any more.
    Cancelled,
    /// Time is up.
    Deadline,
}

/// How many infeasible candidates are remembered as the nearest misses.
const NEAREST: usize = 20;
/// How many of the candidates that one goal term alone kept out are remembered, at most; even.
const SAMPLE: usize = 100;

/// Candidates that one goal term alone kept out: how many, and an even sample of them, so that the last iterations speak as the first do.
#[derive(Debug, Clone, Default)]
pub struct KeptOut {
    /// How many.
    pub count: u64,
    /// Every 2^`halvings`-th of them, in the order in which they were drawn.
    pub sample: Vec<Judged>,
    halvings: u32,
}

impl KeptOut {
    fn add(&mut self, judged: &Judged) {
        if self.count.is_multiple_of(1 << self.halvings) {
            if self.sample.len() == SAMPLE {
                // As the sample's size is even, this one still is in step.
                self.sample = self.sample.iter().step_by(2).cloned().collect();
                self.halvings += 1;
            }
            self.sample.push(judged.clone());
        }
        self.count += 1;
    }
}

/// What a search has found so far.
#[derive(Debug, Clone, Default)]
pub struct Findings {
    /// The feasible candidates of all iterations, in the order in which they were drawn.
    pub accepted: Vec<Judged>,
    /// Rejected candidates by reason.
    pub rejections: BTreeMap<Rejection, u64>,
    /// Candidates that one goal term alone kept out, by that term's position.
    pub kept_out: BTreeMap<usize, KeptOut>,
    /// In-view candidates that failed by least, best first.
    pub nearest: Vec<Judged>,
    /// Iterations done.
    pub iterations: u32,
    /// Candidates drawn.
    pub evaluated: u64,
    /// Where networks only rank: the best of the last iteration done, with what they say of it.
    pub appraised: Option<Judged>,
}

impl Findings {
    /// The lowest-cost feasible candidate, the first drawn of equals.
    pub fn best(&self) -> Option<&Judged> {
        self.accepted.iter().min_by(|a, b| a.cost.total_cmp(&b.cost))
    }

    fn record(&mut self, judged: &[Judged]) {
        self.evaluated += judged.len() as u64;
        let (accepted, rejected): (Vec<Judged>, Vec<Judged>) = judged.iter().cloned().partition(Judged::feasible);
        self.accepted.extend(accepted);
        self.reject(rejected);
    }

    /// Notes rejected candidates.
    pub fn reject(&mut self, rejected: Vec<Judged>) {
        for j in rejected {
            let Some(rejection) = j.rejection else { continue };
            *self.rejections.entry(rejection).or_default() += 1;
            if let (Rejection::Goal, [term]) = (rejection, &j.failing[..]) {
                self.kept_out.entry(*term).or_default().add(&j);
            }
            if rejection > Rejection::OutOfView {
                self.nearest.push(j);
            }
        }
        self.nearest.sort_by(Judged::better);
        self.nearest.truncate(NEAREST);
    }
}

/// Where iteration 0's candidates come from.
pub struct Source<'a> {
    /// Draws of the prior with their modes, to be used in order.
    pub drawn: std::vec::IntoIter<(Candidate, usize)>,
    /// Proposals from the goal's geometry.
    pub proposer: Option<Proposer<'a>>,
    /// How many of those were made.
    pub proposed: u64,
}

impl Source<'_> {
    /// Up to `count` candidates, settled: half of each where there are both.
    fn draw(&mut self, count: usize, judge: &Judge<'_>, rng: &mut Pcg64) -> Vec<(Candidate, usize)> {
        let from_prior = if self.proposer.is_some() { count / 2 } else { count };
        let mut out: Vec<(Candidate, usize)> = self.drawn.by_ref().take(from_prior).collect();
        for (candidate, _) in &mut out {
            *candidate = judge.settle(candidate, judge.ceiling_over(candidate));
        }
        if let Some(proposer) = &self.proposer {
            while out.len() < count {
                let proposal = proposer.draw(self.proposed, rng);
                self.proposed += 1;
                out.push((judge.settle(&proposal.drawn, proposal.ceiling_m), 0));
            }
        }
        out
    }
}

/// What the models answered; none when time ended while they were asked.
///
/// # Errors
/// Every other error of theirs.
pub fn in_time<T>(answered: Result<T, CallError>) -> Result<Option<T>, CallError> {
    match answered {
        Err(error) if error.code == ErrorCode::DeadlineExceeded => Ok(None),
        answered => answered.map(Some),
    }
}

/// Searches. `control` is asked before every batch (`None`) and told of every iteration done; it may stop the search.
///
/// Returns what was found, and why it stopped early if it did: time may also end while the networks are asked.
///
/// # Errors
/// What the networks answer; `deadline_exceeded` only before the first iteration was done.
pub fn search(
    judge: &mut Judge<'_>,
    mut source: Source<'_>,
    rng: &mut Pcg64,
    control: &mut dyn FnMut(Option<&Findings>, &Judge<'_>) -> ControlFlow<Stop>,
) -> Result<(Findings, Option<Stop>), CallError> {
    let settings = judge.settings;
    let surrogate = &settings.fixed.surrogate;
    let mut findings = Findings::default();
    let mut modes: Vec<Mode> = Vec::new();
    for iteration in 0..settings.iterations {
        let mut judged: Vec<Judged> = Vec::new();
        let mut quotas = vec![Quota::default(); modes.len().max(1)];
        loop {
            if let ControlFlow::Break(stop) = control(None, judge) {
                return Ok((findings, Some(stop)));
            }
            let batch = if iteration == 0 {
                let count = quotas[0].next(settings.batch, settings.draws_per_batch);
                source.draw(count, judge, rng)
            } else {
                // While nothing is feasible, the modes only lead to where least is missed: most draws still go where the goal is.
                let fresh = (findings.accepted.is_empty() && source.proposer.is_some()).then_some(&mut source);
                draw_from_modes(&modes, &mut quotas, fresh, judge, rng)
            };
            if batch.is_empty() {
                break;
            }
            let tried = match judge.judge(&batch) {
                tried if findings.iterations == 0 => tried?,
                tried => match in_time(tried)? {
                    Some(tried) => tried,
                    None => return Ok((findings, Some(Stop::Deadline))),
                },
            };
            findings.record(&tried);
            for j in &tried {
                let slot = if iteration == 0 { 0 } else { modes.iter().position(|m| m.id == j.mode).unwrap_or(0) };
                quotas[slot].accepted += usize::from(j.feasible());
            }
            judged.extend(tried);
        }
        if iteration == 0 && settings.recipe.grounded {
            assign_levels(&mut judged, surrogate.level_gap_m);
        }
        modes = refit(modes, judged, settings.elites, settings.rotation, surrogate);
        findings.iterations = iteration + 1;
        // After the last iteration the whole shortlist is put to the networks.
        let last = iteration + 1 == settings.iterations && findings.appraised.is_some();
        if settings.recipe.realism == Realism::OutcomeRanks
            && !last
            && let Some(best) = findings.best()
        {
            let mut best = [best.clone()];
            if in_time(appraise(judge, &mut best))?.is_none() {
                return Ok((findings, Some(Stop::Deadline)));
            }
            // What geometry finds better may please the networks less: the best so far stays.
            findings.appraised = findings.appraised.take().into_iter().chain(best).min_by(|a, b| a.cost.total_cmp(&b.cost));
        }
        if let ControlFlow::Break(stop) = control(Some(&findings), judge) {
            let early = (iteration + 1 < settings.iterations).then_some(stop);
            return Ok((findings, early.or((stop == Stop::Cancelled).then_some(stop))));
        }
        if modes.is_empty() {
            break;
        }
    }
    Ok((findings, None))
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
    modes: &[Mode],
    quotas: &mut [Quota],
    mut fresh: Option<&mut Source<'_>>,
    judge: &Judge<'_>,
    rng: &mut Pcg64,
) -> Vec<(Candidate, usize)> {
    let settings = judge.settings;
    let mut out = Vec::new();
    let mut left = settings.batch;
    for (mode, quota) in modes.iter().zip(quotas) {
        let wanted = ((settings.batch as f64 * mode.share) as usize).max(1).min(left);
        left -= wanted;
        let count = quota.next(wanted, settings.draws_per_batch);
        let mut from_mode = count;
        if let Some(source) = fresh.as_deref_mut() {
            from_mode = count.div_ceil(4);
            out.extend(source.draw(count - from_mode, judge, rng).into_iter().map(|(candidate, _)| (candidate, mode.id)));
        }
        for _ in 0..from_mode {
            let drawn = mode.surrogate.draw(rng);
            out.push((judge.settle(&drawn, judge.ceiling_over(&drawn)), mode.id));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_term_kept_out_is_counted_and_sampled_evenly() {
        for n in [1u16, 99, 100, 101, 1000, 12_345] {
            let mut kept_out = KeptOut::default();
            for i in 0..n {
                kept_out.add(&Judged::new(Candidate { centroid_m: [f32::from(i), 0.0, 0.0], yaw_rad: 0.0 }, 0));
            }
            let drawn: Vec<f32> = kept_out.sample.iter().map(|j| j.candidate.centroid_m[0]).collect();
            assert_eq!(kept_out.count, u64::from(n));
            assert!(drawn.len() <= SAMPLE && drawn.len() >= usize::from(n).min(SAMPLE / 2), "{n}: {}", drawn.len());
            let step = if drawn.len() > 1 { drawn[1] } else { 1.0 };
            assert!(drawn.iter().enumerate().all(|(i, at)| *at == step * i as f32), "{n}: {drawn:?}");
            assert!(f32::from(n) - drawn[drawn.len() - 1] <= step, "{n}: to the end");
        }
    }
}
