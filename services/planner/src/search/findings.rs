//! What a search has found: what passed, what was rejected and why, and the nearest misses.

use std::collections::BTreeMap;

use repose_proto::place::Rejection;

use crate::judge::judged::JudgedCandidate;
use crate::settings::{PlanSettings, Realism};

/// How many of the nearest misses are kept: as many as a batch has elites.
const NEAREST: usize = 20;
/// The most candidates kept of those that one goal term alone rejected; even. The networks score so many in one request.
const SAMPLE: usize = 100;
/// The most positions of rejected candidates kept for each reason; even. For people to look at, and of a few kilobytes together.
const SHOWN: usize = 48;

/// An even sample, over all iterations, of at most `MOST` (even) of the things that were added.
#[derive(Debug, Clone)]
pub struct EvenSample<T, const MOST: usize> {
    /// How many were added.
    pub count: u64,
    /// Every 2^`halvings`-th of them, in the order in which they were added.
    pub sample: Vec<T>,
    halvings: u32,
}

impl<T, const MOST: usize> Default for EvenSample<T, MOST> {
    fn default() -> Self {
        Self { count: 0, sample: Vec::new(), halvings: 0 }
    }
}

impl<T, const MOST: usize> EvenSample<T, MOST> {
    fn add(&mut self, one: impl FnOnce() -> T) {
        if self.count.is_multiple_of(1 << self.halvings) {
            if self.sample.len() == MOST {
                // The sample's size is even, so this one is still in step.
                let mut place = 0;
                self.sample.retain(|_| {
                    place += 1;
                    place % 2 == 1
                });
                self.halvings += 1;
            }
            self.sample.push(one());
        }
        self.count += 1;
    }
}

/// What a search has found so far.
#[derive(Debug, Clone, Default)]
pub struct Findings {
    /// The feasible candidates of all iterations, in the order in which they were drawn.
    pub accepted: Vec<JudgedCandidate>,
    /// Rejected candidates by reason.
    pub rejections: BTreeMap<Rejection, u64>,
    /// Candidates that one goal term alone rejected, by that term's position.
    pub kept_out: BTreeMap<usize, EvenSample<JudgedCandidate, SAMPLE>>,
    /// Where rejected candidates' centroids were, world frame, metres, by reason.
    rejected_at_m: BTreeMap<Rejection, EvenSample<[f32; 3], SHOWN>>,
    /// In-view candidates with the least violation, best first.
    pub nearest: Vec<JudgedCandidate>,
    /// Iterations done.
    pub iterations: u32,
    /// Candidates drawn.
    pub evaluated: u64,
    /// Where networks only rank: the candidates that they were asked about after iterations, and those of the ranking that they believe in.
    pub heard: Vec<JudgedCandidate>,
}

impl Findings {
    /// The lowest-cost feasible candidate, the first drawn of equals.
    pub fn best(&self) -> Option<&JudgedCandidate> {
        cheapest(&self.accepted)
    }

    /// What the answer would be if the search ended now: the best candidate, where networks only rank of those that they were asked about after
    /// iterations and believe in.
    pub fn best_so_far(&self, settings: &PlanSettings) -> Option<&JudgedCandidate> {
        match settings.recipe.realism {
            Realism::OutcomeRanks => cheapest(self.heard.iter().filter(|j| j.believed(settings))),
            _ => self.best(),
        }
    }

    /// Where rejected candidates' centroids were, world frame, metres: an even sample by reason.
    pub fn rejected_at_m(&self) -> BTreeMap<Rejection, Vec<[f32; 3]>> {
        self.rejected_at_m.iter().map(|(reason, places)| (*reason, places.sample.clone())).collect()
    }

    /// Notes judged candidates.
    pub fn record(&mut self, judged: &[JudgedCandidate]) {
        self.evaluated += judged.len() as u64;
        let (accepted, rejected): (Vec<JudgedCandidate>, Vec<JudgedCandidate>) =
            judged.iter().cloned().partition(JudgedCandidate::feasible);
        self.accepted.extend(accepted);
        self.reject(rejected);
    }

    /// Notes rejected candidates.
    pub fn reject(&mut self, rejected: Vec<JudgedCandidate>) {
        for j in rejected {
            let Some(rejection) = j.rejection else { continue };
            *self.rejections.entry(rejection).or_default() += 1;
            self.rejected_at_m.entry(rejection).or_default().add(|| j.candidate.centroid_m);
            if let (Rejection::Goal, [term]) = (rejection, &j.failing[..]) {
                self.kept_out.entry(*term).or_default().add(|| j.clone());
            }
            if rejection > Rejection::OutOfView {
                self.nearest.push(j);
            }
        }
        self.nearest.sort_by(JudgedCandidate::better);
        self.nearest.truncate(NEAREST);
    }
}

/// The candidate of lowest cost, the first of equals.
pub fn cheapest<'a>(candidates: impl IntoIterator<Item = &'a JudgedCandidate>) -> Option<&'a JudgedCandidate> {
    candidates.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_rejected_is_counted_and_sampled_evenly() {
        for n in [1u16, 99, 100, 101, 1000, 12_345] {
            let mut kept = EvenSample::<f32, SAMPLE>::default();
            (0..n).for_each(|i| kept.add(|| f32::from(i)));
            let drawn = &kept.sample;
            assert_eq!(kept.count, u64::from(n));
            assert!(drawn.len() <= SAMPLE && drawn.len() >= usize::from(n).min(SAMPLE / 2), "{n}: {}", drawn.len());
            let step = if drawn.len() > 1 { drawn[1] } else { 1.0 };
            assert!(drawn.iter().enumerate().all(|(i, at)| *at == step * i as f32), "{n}: {drawn:?}");
            assert!(f32::from(n) - drawn[drawn.len() - 1] <= step, "{n}: to the end");
        }
    }
}
