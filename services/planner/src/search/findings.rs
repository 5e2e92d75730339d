//! What a search has found: what passed, what was rejected and why, and the nearest misses.

use std::collections::BTreeMap;

use repose_proto::place::Rejection;

use crate::judge::judged::JudgedCandidate;

/// How many of the nearest misses are kept: as many as a batch has elites.
const NEAREST: usize = 20;
/// The most candidates kept of those that one goal term alone rejected; even. The networks score so many in one request.
const SAMPLE: usize = 100;

/// Candidates that one goal term alone rejected: how many, and an even sample of them over all iterations.
#[derive(Debug, Clone, Default)]
pub struct KeptOut {
    /// How many.
    pub count: u64,
    /// Every 2^`halvings`-th of them, in the order in which they were drawn.
    pub sample: Vec<JudgedCandidate>,
    halvings: u32,
}

impl KeptOut {
    fn add(&mut self, judged: &JudgedCandidate) {
        if self.count.is_multiple_of(1 << self.halvings) {
            if self.sample.len() == SAMPLE {
                // The sample's size is even, so this candidate is still in step.
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
    pub accepted: Vec<JudgedCandidate>,
    /// Rejected candidates by reason.
    pub rejections: BTreeMap<Rejection, u64>,
    /// Candidates that one goal term alone rejected, by that term's position.
    pub kept_out: BTreeMap<usize, KeptOut>,
    /// In-view candidates with the least violation, best first.
    pub nearest: Vec<JudgedCandidate>,
    /// Iterations done.
    pub iterations: u32,
    /// Candidates drawn.
    pub evaluated: u64,
    /// Where networks only rank: the best candidate that they were asked about after an iteration.
    pub appraised: Option<JudgedCandidate>,
}

impl Findings {
    /// The lowest-cost feasible candidate, the first drawn of equals.
    pub fn best(&self) -> Option<&JudgedCandidate> {
        self.accepted.iter().min_by(|a, b| a.cost.total_cmp(&b.cost))
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
            if let (Rejection::Goal, [term]) = (rejection, &j.failing[..]) {
                self.kept_out.entry(*term).or_default().add(&j);
            }
            if rejection > Rejection::OutOfView {
                self.nearest.push(j);
            }
        }
        self.nearest.sort_by(JudgedCandidate::better);
        self.nearest.truncate(NEAREST);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::candidate::CandidatePose;

    #[test]
    fn what_a_term_kept_out_is_counted_and_sampled_evenly() {
        for n in [1u16, 99, 100, 101, 1000, 12_345] {
            let mut kept_out = KeptOut::default();
            for i in 0..n {
                kept_out.add(&JudgedCandidate::new(CandidatePose { centroid_m: [f32::from(i), 0.0, 0.0], yaw_rad: 0.0 }, 0));
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
