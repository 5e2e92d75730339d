//! The cost c(δ) that ranks feasible candidates.
//!
//! The paper's (equation 1): λ_f ‖1 − f‖ + λ_ρ ‖p_ρ − ρ‖ over the goal's terms. Where geometry grounds the candidates, its soundness
//! stands beside or in place of f, and the rules' margins in place of p_ρ: both as shortfalls from what would be comfortable.

use repose_proto::place::GeometricCheck;
use repose_proto::{GoalTerm, Relation};

use crate::footing::Footing;
use crate::query::Query;
use crate::settings::{RuleSettings, SoundnessSettings};

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

/// What soundness is judged from.
#[derive(Debug, Clone, Copy)]
pub struct Standing {
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
    /// Share of small errors of its pose that would not do; 0 where they were not tried.
    pub fragile_share: f64,
    /// Share of where its unseen back may reach that something else fills.
    pub doubtful_share: f64,
}

/// How far a candidate is from standing comfortably: 0 for the middle of an empty, fully seen table.
pub fn soundness_cost(standing: &Standing, query: &Query, settings: &SoundnessSettings) -> f64 {
    let comfort_m = settings.support_m.min(settings.support_share * query.base_margin_m).max(1e-3);
    let shortfalls = [
        (1.0 - standing.footing.margin_m / comfort_m).clamp(0.0, 1.0),
        1.0 - standing.footing.seen_share,
        (1.0 - standing.clearance_m / settings.clearance_m).clamp(0.0, 1.0),
        1.0 - standing.unhidden,
        1.0 - standing.rim_share,
        if standing.on_stranger { 1.0 } else { 0.0 },
        standing.unseen_share,
        standing.fragile_share,
        // A tenth of it filled is as bad as all of it: either would push.
        (10.0 * standing.doubtful_share).min(1.0),
    ];
    shortfalls.iter().zip(&settings.weights).map(|(s, w)| s * w).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

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
