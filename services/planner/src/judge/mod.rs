//! Judges candidates: the constraints first, then the networks, then the cost of what passed.
//!
//! One judge serves every variant; the recipe says which tests it has (paper, equations 1 to 5 and Algorithm 1, lines 9 to 15). The
//! networks see a whole batch in one request for relations, and then those that pass in one for realism.

pub mod constraints;
pub mod cost;
pub mod judged;
pub mod least;
pub mod problem;
pub mod scorer;
pub mod standing;
pub mod success;

use repose_proto::CallError;
use repose_proto::place::Rejection;

use crate::judge::constraints::{Constraints, Slip};
use crate::judge::cost::Costs;
use crate::judge::judged::JudgedCandidate;
use crate::judge::problem::PlacementProblem;
use crate::judge::scorer::{Question, Scorer};
use crate::judge::standing::Standing;
use crate::judge::success::measures;
use crate::learned::mixture::PriorMixture;
use crate::learned::models::PlacementModels;
use crate::scene::candidate::CandidatePose;
use crate::settings::{GoalBy, Realism, StandingBy};

/// Judges the candidates of one problem.
pub struct Judge<'a> {
    problem: PlacementProblem<'a>,
    constraints: Constraints<'a>,
    scorer: Scorer<'a>,
    costs: Costs<'a>,
    /// How the query stands where it was seen; none before a forecast was needed.
    standing: Option<Standing>,
}

impl<'a> Judge<'a> {
    /// A judge that asks `models`.
    pub fn new(problem: PlacementProblem<'a>, models: &'a dyn PlacementModels) -> Self {
        Self {
            problem,
            constraints: Constraints::new(problem),
            scorer: Scorer::new(problem, models),
            costs: Costs::new(problem),
            standing: None,
        }
    }

    /// What is judged.
    pub fn problem(&self) -> PlacementProblem<'a> {
        self.problem
    }

    /// The networks.
    pub fn scorer(&self) -> &Scorer<'a> {
        &self.scorer
    }

    /// The networks, to ask them.
    pub fn scorer_mut(&mut self) -> &mut Scorer<'a> {
        &mut self.scorer
    }

    /// Tells the cost of the prior's mixture, which `mdn_prior` reads.
    pub fn take_mixture(&mut self, mixture: PriorMixture) {
        self.costs.take_mixture(mixture);
    }

    /// Judges candidates, each with its mode; in their order.
    ///
    /// # Errors
    /// What the networks answer; `unavailable` when their weights changed half way.
    pub fn judge(&mut self, candidates: &[(CandidatePose, usize)]) -> Result<Vec<JudgedCandidate>, CallError> {
        let mut judged: Vec<JudgedCandidate> =
            candidates.iter().map(|(candidate, mode)| self.without_networks(*candidate, *mode)).collect();
        let recipe = self.problem.settings.recipe;
        if recipe.goal_by == GoalBy::Learned {
            let open = feasible(&judged);
            self.scorer.ask(Question::Relations, &mut judged, &open)?;
            for i in open {
                self.judge_learned_goal(&mut judged[i]);
            }
        }
        if recipe.realism == Realism::Discriminator {
            let open = feasible(&judged);
            self.scorer.ask(Question::Realism, &mut judged, &open)?;
            for i in open {
                self.judge_realism(&mut judged[i]);
            }
        }
        for j in judged.iter_mut().filter(|j| j.feasible()) {
            j.cost = self.cost(j);
        }
        Ok(judged)
    }

    /// Every constraint that needs no network.
    pub fn without_networks(&self, candidate: CandidatePose, mode: usize) -> JudgedCandidate {
        self.constraints.tried(candidate, mode)
    }

    /// What it does to the constraints where the object ends up in a place a little off a candidate.
    pub fn slip(&self, off: CandidatePose) -> Slip {
        self.constraints.slip(off)
    }

    /// The cost of a candidate from what is known of it.
    pub fn cost(&self, judged: &JudgedCandidate) -> f64 {
        self.costs.of(judged)
    }

    /// Rejects a candidate whose realism is not above the threshold.
    pub fn judge_realism(&self, judged: &mut JudgedCandidate) {
        let threshold = self.problem.settings.realism_threshold;
        let realism = judged.realism.map_or(0.0, f64::from);
        if realism <= threshold {
            judged.reject(Rejection::Unrealistic, threshold - realism);
        }
    }

    /// Whether every candidate is rejected, wherever it is: no search finds a way around that.
    pub fn refuses_all(&self) -> bool {
        self.constraints.refuse_all()
    }

    /// Learns how the query stands where it was seen, where the recipe goes by the forecasts of that: every candidate is rejected from then on
    /// if it does not stand by itself, or cannot be taken away without bringing a neighbour down. To be called once the networks have answered.
    ///
    /// # Errors
    /// As [`Judge::judge`].
    pub fn learn_standing(&mut self) -> Result<(), CallError> {
        if self.problem.settings.recipe.standing_by == StandingBy::Forecast {
            let (wanted, standing) = (&self.problem.settings.fixed.standing, self.standing()?);
            let misses = [
                (Rejection::Tips, wanted.min_stands - standing.stands),
                (Rejection::Unsettles, wanted.min_neighbour_stays - standing.neighbours_stay),
            ];
            self.constraints.refuse(misses.into_iter().filter(|(_, miss)| *miss > 0.0));
        }
        Ok(())
    }

    /// How the query stands where it was seen.
    fn standing(&mut self) -> Result<Standing, CallError> {
        if let Some(standing) = &self.standing {
            return Ok(*standing);
        }
        Ok(*self.standing.insert(Standing::of(&self.problem, &*self.scorer.forecasts()?)))
    }

    /// Says how likely a candidate succeeds that the networks were asked about.
    ///
    /// # Errors
    /// As [`Judge::judge`]; `failed_precondition` on `min_success` where that is demanded and the weights have no such forecast.
    pub fn forecast_success(&mut self, judged: &mut JudgedCandidate) -> Result<(), CallError> {
        let forecasts = self.scorer.forecasts()?;
        let standing = self.standing()?;
        judged.success_measures = measures(&self.problem, &standing, judged);
        judged.success = forecasts.success.as_ref().zip(judged.success_measures.as_ref()).map(|(success, measures)| success.of(measures));
        if judged.success.is_none() && self.problem.request.min_success.is_some_and(|least| least > 0.0) {
            return Err(CallError::precondition("the weights in service do not say how likely placements succeed").at("min_success"));
        }
        Ok(())
    }

    /// Rejects a candidate that is not as likely to succeed as the request demands.
    pub fn judge_success(&self, judged: &mut JudgedCandidate) {
        let missing = self.problem.settings.min_success.unwrap_or(0.0) - judged.success.unwrap_or(1.0);
        if missing > 0.0 {
            judged.reject(Rejection::Unsure, missing);
        }
    }

    /// Asks the networks what was not asked yet of some candidates, for the evidence beside answers.
    ///
    /// # Errors
    /// As [`Judge::judge`].
    pub fn complete(&mut self, judged: &mut [JudgedCandidate]) -> Result<(), CallError> {
        let recipe = self.problem.settings.recipe;
        let wants_realism = matches!(recipe.realism, Realism::Discriminator | Realism::OutcomeRanks);
        let wants_relations = recipe.goal_by != GoalBy::Rule;
        for what in [Question::Both, Question::Realism, Question::Relations] {
            let lacks = |j: &JudgedCandidate| match (wants_realism && j.realism.is_none(), wants_relations && j.relations.is_none()) {
                (true, true) => Some(Question::Both),
                (true, false) => Some(Question::Realism),
                (false, true) => Some(Question::Relations),
                (false, false) => None,
            };
            let open: Vec<usize> = (0..judged.len()).filter(|i| lacks(&judged[*i]) == Some(what)).collect();
            self.scorer.ask(what, judged, &open)?;
        }
        let rules = self.problem.rules;
        for j in judged {
            if j.footing.is_none() {
                j.footing = Some(self.problem.ground().footing(&j.candidate));
            }
            if j.checks.is_none() {
                j.checks = Some(rules.checks(&j.candidate));
            }
        }
        Ok(())
    }

    fn judge_learned_goal(&self, judged: &mut JudgedCandidate) {
        let settings = self.problem.settings;
        let threshold = settings.relations_threshold;
        let Some(probabilities) = &judged.relations else { return };
        let missing = |p: &f32| (threshold - f64::from(*p)).max(0.0);
        let failing: Vec<usize> = probabilities.iter().enumerate().filter(|(_, p)| f64::from(**p) <= threshold).map(|(i, _)| i).collect();
        let total = probabilities.iter().map(missing).sum();
        if !failing.is_empty() {
            judged.failing = failing;
            judged.reject(Rejection::Goal, total);
            judged.leave_untried(usize::from(settings.recipe.realism == Realism::Discriminator));
        }
    }
}

fn feasible(judged: &[JudgedCandidate]) -> Vec<usize> {
    (0..judged.len()).filter(|i| judged[*i].feasible()).collect()
}
