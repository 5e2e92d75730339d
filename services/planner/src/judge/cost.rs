//! The cost c(δ) that ranks feasible candidates.
//!
//! The paper's (equation 1): λ_f ‖1 − f‖ + λ_ρ ‖p_ρ − ρ‖ over the goal's terms. Where geometry grounds the candidates, its soundness
//! stands beside or in place of f, and the rules' margins in place of p_ρ: both as shortfalls from what would be comfortable.

use repose_proto::place::GeometricCheck;
use repose_proto::{GoalTerm, Relation};

use crate::checks::footing::Footing;
use crate::judge::judged::JudgedCandidate;
use crate::judge::problem::PlacementProblem;
use crate::learned::mixture::PriorMixture;
use crate::scene::query::QueryObject;
use crate::settings::{GoalBy, Realism, RuleSettings, SoundnessSettings};

/// The costs of one problem's candidates.
#[derive(Debug)]
pub struct Costs<'a> {
    problem: PlacementProblem<'a>,
    /// Objects that a goal term asks to be on.
    carriers: Vec<u16>,
    mixture: Option<PriorMixture>,
}

impl<'a> Costs<'a> {
    /// The costs of a problem.
    pub fn new(problem: PlacementProblem<'a>) -> Self {
        Self { carriers: problem.anchors_of(&[Relation::Above, Relation::Touching, Relation::Centered]), problem, mixture: None }
    }

    /// Takes the prior's mixture, which `mdn_prior` reads.
    pub fn take_mixture(&mut self, mixture: PriorMixture) {
        self.mixture = Some(mixture);
    }

    /// The cost of a candidate from what is known of it. An unasked probability counts as 0, unless networks only rank.
    pub fn of(&self, judged: &JudgedCandidate) -> f64 {
        let (settings, recipe) = (self.problem.settings, self.problem.settings.recipe);
        // Where networks only rank, candidates that they were not asked about are compared by geometry alone.
        let unasked = if recipe.realism == Realism::OutcomeRanks { 0.0 } else { 1.0 };
        let unrealistic = judged.realism.map_or(unasked, |f| 1.0 - f64::from(f));
        let learned = judged.relations.as_ref().map_or(unasked, |p| relations_cost(p));
        let ruled = judged.checks.as_ref().map_or(0.0, |c| rules_cost(&self.problem.request.goal, c, &settings.fixed.rules));
        let relations = match recipe.goal_by {
            GoalBy::Learned => learned,
            GoalBy::Rule => ruled,
            GoalBy::RuleRankedByLearned => ruled + learned,
        };
        let soundness = if recipe.grounded { self.soundness(judged) } else { 0.0 };
        let realism = match recipe.realism {
            Realism::Unasked => soundness,
            Realism::Discriminator | Realism::OutcomeRanks => unrealistic + soundness,
            Realism::PriorDensity => self.mixture.as_ref().map_or(0.0, |m| -m.log_density(&judged.candidate)),
        };
        let unsure = judged.success.map_or(0.0, |success| settings.fixed.ranking.unsure * (1.0 - success));
        settings.realism_weight * (realism + unsure) + settings.relations_weight * relations
    }

    fn soundness(&self, judged: &JudgedCandidate) -> f64 {
        let (Some(footing), Some(found)) = (judged.footing, judged.obstruction) else { return 1.0 };
        let PlacementProblem { prepared, query, request, settings, .. } = self.problem;
        let comfort = Comfort {
            footing,
            rim_share: self.problem.ground().rim_share(&judged.candidate),
            clearance_m: found.clearance_m,
            unhidden: judged.unhidden.unwrap_or(0.0),
            on_stranger: footing.carrier.is_some_and(|c| c != 0 && !self.carriers.contains(&c)),
            unseen_share: judged.unseen_share.unwrap_or(0.0),
            fragile_share: judged.fragility.map_or(0.0, |fragility| fragility.as_asked),
            doubtful_share: found.doubtful_share,
            farther_chance: found.farther_chance,
        };
        let main = request.main_anchor().and_then(|a| prepared.belief.objects.get(&a));
        let distance_m = main.map_or(0.0, |a| (a.centroid - judged.candidate.centroid()).xy().norm());
        let soundness = &settings.fixed.soundness;
        soundness_cost(&comfort, query, soundness) + soundness.distance_per_m * distance_m
    }
}

/// ‖1 − p‖ over the goal's terms; `p` is the probability of each as asked.
pub fn relations_cost(probabilities: &[f32]) -> f64 {
    probabilities.iter().map(|p| (1.0 - f64::from(*p)).powi(2)).sum::<f64>().sqrt()
}

/// ‖shortfall‖ over the goal's terms: 1 where a term only just holds, 0 from the comfortable margin on.
pub fn rules_cost(terms: &[GoalTerm], checks: &[GeometricCheck], settings: &RuleSettings) -> f64 {
    let shortfall = |(term, check): (&GoalTerm, &GeometricCheck)| {
        let comfort_m = match (term.relation, term.holds) {
            // These hold within a band that is narrower than what is comfortable.
            (Relation::Near, true) => settings.comfort_m / 2.0,
            (Relation::Touching | Relation::Centered | Relation::Aligned, true) => return if check.holds { 0.0 } else { 1.0 },
            _ => settings.comfort_m,
        };
        (1.0 - check.margin_m / comfort_m).clamp(0.0, 1.0)
    };
    terms.iter().zip(checks).map(shortfall).map(|s| s * s).sum::<f64>().sqrt()
}

/// What soundness is computed from.
#[derive(Debug, Clone, Copy)]
pub struct Comfort {
    /// How it stands.
    pub footing: Footing,
    /// Share of the band around the base that is carried.
    pub rim_share: f64,
    /// Distance to the nearest obstacle, metres.
    pub clearance_m: f64,
    /// Share of its points that would be seen.
    pub unhidden: f64,
    /// Whether an object carries it that no term asks to be on.
    pub on_stranger: bool,
    /// Share of its volume in space that was not seen.
    pub unseen_share: f64,
    /// Share of small errors of its pose that break a constraint; 0 where they were not tried.
    pub fragile_share: f64,
    /// Share of the space that its unseen back may reach which something else fills.
    pub doubtful_share: f64,
    /// How likely an end of it that may be farther out than believed reaches something.
    pub farther_chance: f64,
}

/// How far a candidate is from standing comfortably: 0 for the middle of an empty, fully seen table.
pub fn soundness_cost(comfort: &Comfort, query: &QueryObject, settings: &SoundnessSettings) -> f64 {
    let comfort_m = settings.support_m.min(settings.support_share * query.base_margin_m).max(1e-3);
    let w = &settings.weights;
    let shortfalls = [
        (w.edge, (1.0 - comfort.footing.margin_or_far_m() / comfort_m).clamp(0.0, 1.0)),
        (w.base_not_seen, 1.0 - comfort.footing.seen_share),
        (w.clearance, (1.0 - comfort.clearance_m / settings.clearance_m).clamp(0.0, 1.0)),
        (w.hidden, 1.0 - comfort.unhidden),
        (w.rim, 1.0 - comfort.rim_share),
        (w.stranger, if comfort.on_stranger { 1.0 } else { 0.0 }),
        (w.unseen_space, comfort.unseen_share),
        (w.fragile, comfort.fragile_share),
        // A tenth of it filled is as bad as all of it: either would push something.
        (w.doubtful, (10.0 * comfort.doubtful_share).min(1.0)),
        (w.farther, comfort.farther_chance),
    ];
    shortfalls.iter().map(|(weight, shortfall)| shortfall * weight).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_costs_more_the_likelier_an_unseen_end_reaches_something_there() {
        use crate::tests::synthetic::{Prepared, SceneBuilder};
        let table = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).prepared();
        let fixed = crate::settings::Fixed::default();
        let query = QueryObject::new(&table, 1, 0.0, &fixed).unwrap();
        let footing = Footing { seen_share: 1.0, carried_share: 1.0, margin_m: Some(1.0), carrier: Some(0) };
        let cost = |farther_chance: f64| {
            let comfort = Comfort {
                footing,
                rim_share: 1.0,
                clearance_m: 1.0,
                unhidden: 1.0,
                on_stranger: false,
                unseen_share: 0.0,
                fragile_share: 0.0,
                doubtful_share: 0.0,
                farther_chance,
            };
            soundness_cost(&comfort, &query, &fixed.soundness)
        };
        assert!(cost(0.2) > cost(0.0) && cost(0.5) > cost(0.2), "{} {} {}", cost(0.0), cost(0.2), cost(0.5));
    }

    #[test]
    fn certain_terms_cost_nothing_and_each_doubt_adds() {
        assert_eq!(relations_cost(&[1.0, 1.0]), 0.0);
        assert!((relations_cost(&[0.5, 1.0]) - 0.5).abs() < 1e-9);
        let term = |relation| GoalTerm { relation, anchor: 1, holds: true };
        let check = |margin_m| GeometricCheck { holds: margin_m > 0.0, margin_m };
        let settings = RuleSettings::default();
        let cost = |relation, margin_m| rules_cost(&[term(relation)], &[check(margin_m)], &settings);
        assert!(cost(Relation::LeftOf, 0.001) > cost(Relation::LeftOf, 0.01));
        assert_eq!(cost(Relation::LeftOf, 0.07), 0.0);
        assert_eq!(cost(Relation::Centered, 0.0005), 0.0);
    }
}
