//! A judged candidate: accepted with a cost, or rejected by the first constraint that failed.

use std::cmp::Ordering;

use repose_proto::place::{GeometricCheck, Rejection};

use crate::checks::footing::Footing;
use crate::checks::obstruction::Obstruction;
use crate::learned::stability::COUNT;
use crate::scene::candidate::CandidatePose;
use crate::settings::PlanSettings;

/// A candidate that has been tried.
#[derive(Debug, Clone, PartialEq)]
pub struct JudgedCandidate {
    /// The candidate.
    pub candidate: CandidatePose,
    /// The mode of the prior, or the support, that it belongs to.
    pub mode: usize,
    /// The first constraint that failed, in the order of [`Rejection`]; none when it is feasible.
    pub rejection: Option<Rejection>,
    /// How far it is from feasible, over all constraints: each adds 0 to 1; 0 when feasible.
    pub violation: f64,
    /// c(δ); infinite when it was rejected.
    pub cost: f64,
    /// Which goal terms fail, by position; empty unless the goal was tried.
    pub failing: Vec<usize>,
    /// The discriminator's probability, where it was asked.
    pub realism: Option<f32>,
    /// What geometry and the outcome network measure of it ([`crate::learned::stability`]), where that was needed; the network's is 0 before it was
    /// asked.
    pub measures: Option<Box<[f32; COUNT]>>,
    /// What the forecast of success reads of it ([`crate::learned::success`]), where that was asked.
    pub success_measures: Option<Vec<f32>>,
    /// The probability that it succeeds, where that was asked and the weights say it.
    pub success: Option<f64>,
    /// The predictor's probability of each goal term as asked, where it was asked.
    pub relations: Option<Vec<f32>>,
    /// Each goal term by rule, where it was tried.
    pub checks: Option<Vec<GeometricCheck>>,
    /// How it stands, where tried.
    pub footing: Option<Footing>,
    /// What is in its way, where tried.
    pub obstruction: Option<Obstruction>,
    /// Share of its points that would be seen, where tried.
    pub unhidden: Option<f64>,
    /// Share of its volume in space that was not seen, where tried.
    pub unseen_share: Option<f64>,
    /// How many small errors of its pose break a constraint, where tried.
    pub fragility: Option<Fragility>,
}

/// Shares of small errors of a candidate's pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fragility {
    /// Those after which a constraint fails that any request makes.
    pub of_any_request: f64,
    /// Those, and those after which one fails that only this request makes.
    pub as_asked: f64,
}

impl JudgedCandidate {
    /// A candidate before any test.
    pub fn new(candidate: CandidatePose, mode: usize) -> Self {
        Self {
            candidate,
            mode,
            rejection: None,
            violation: 0.0,
            cost: f64::INFINITY,
            failing: Vec::new(),
            realism: None,
            measures: None,
            success_measures: None,
            success: None,
            relations: None,
            checks: None,
            footing: None,
            obstruction: None,
            unhidden: None,
            unseen_share: None,
            fragility: None,
        }
    }

    /// Whether every constraint holds.
    pub fn feasible(&self) -> bool {
        self.rejection.is_none()
    }

    /// Whether the networks were asked and believe in it: it is realistic enough, and as likely to succeed as is wanted where they say so.
    pub fn believed(&self, settings: &PlanSettings) -> bool {
        let is_sure = self.success.unwrap_or(1.0) >= settings.min_success.unwrap_or(0.0);
        self.realism.is_some_and(|f| f64::from(f) > settings.realism_threshold) && is_sure
    }

    /// Rejects it by a constraint that it misses by `amount` (any non-negative number; larger is worse). Constraints come in order: the
    /// first is the reason, every one adds to the violation.
    pub fn reject(&mut self, rejection: Rejection, amount: f64) {
        self.rejection.get_or_insert(rejection);
        self.violation += amount / (1.0 + amount) + f64::EPSILON;
        self.cost = f64::INFINITY;
    }

    /// Counts constraints as missed that were not tried because the candidate had been rejected.
    pub fn leave_untried(&mut self, constraints: usize) {
        self.violation += constraints as f64;
    }

    /// Better first: feasible ones by cost, then the others by violation.
    pub fn better(&self, other: &Self) -> Ordering {
        self.violation.total_cmp(&other.violation).then(self.cost.total_cmp(&other.cost))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feasible_comes_before_infeasible_and_few_misses_before_many() {
        let judged = |rejections: &[(Rejection, f64)], cost: f64| {
            let mut j = JudgedCandidate::new(CandidatePose { centroid_m: [0.0; 3], yaw_rad: 0.0 }, 0);
            j.cost = cost;
            rejections.iter().for_each(|(rejection, amount)| j.reject(*rejection, *amount));
            j
        };
        let mut untried = judged(&[(Rejection::Region, 0.1)], 0.0);
        untried.leave_untried(2);
        let order = [
            judged(&[], 1.0),
            judged(&[], 2.0),
            judged(&[(Rejection::Unrealistic, 0.0)], 0.0),
            judged(&[(Rejection::Unrealistic, 0.3)], 0.0),
            judged(&[(Rejection::Collision, 0.3), (Rejection::Goal, 0.1)], 0.0),
            untried,
        ];
        assert!(order.windows(2).all(|w| w[0].better(&w[1]) == Ordering::Less));
        assert_eq!(order[4].rejection, Some(Rejection::Collision), "the first is the reason");
    }
}
