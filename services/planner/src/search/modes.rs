//! The modes, each with a search of its own, so that distinct answers survive: components of the prior, or levels of support.
//!
//! After every iteration each mode is refitted to its own elites. Modes with feasible candidates get the larger share of the next
//! batch. The others keep a small share and move towards feasible places by least violation.

use std::collections::BTreeMap;

use repose_proto::place::Rotation;

use crate::judge::judged::JudgedCandidate;
use crate::scene::candidate::CandidatePose;
use crate::search::surrogate::Surrogate;
use crate::settings::SurrogateSettings;

/// The share of a mode without feasible candidates, relative to one with some. Chosen by hand on validation scenes.
const INFEASIBLE_WEIGHT: f64 = 0.3;

/// A mode.
#[derive(Debug, Clone)]
pub struct SearchMode {
    /// Its number, as [`JudgedCandidate::mode`].
    pub id: usize,
    /// The Gaussian that its next candidates are drawn from.
    pub surrogate: Surrogate,
    /// Its share of the next batch; shares sum to 1.
    pub share: f64,
    /// The candidates that it was fitted to, best first.
    pub elites: Vec<JudgedCandidate>,
}

/// Refits every mode to the best of its elites so far and this iteration's candidates.
pub fn refit(
    previous: Vec<SearchMode>,
    judged: Vec<JudgedCandidate>,
    elites: usize,
    rotation: Rotation,
    settings: &SurrogateSettings,
) -> Vec<SearchMode> {
    let mut members: BTreeMap<usize, Vec<JudgedCandidate>> = BTreeMap::new();
    for mode in previous {
        members.entry(mode.id).or_default().extend(mode.elites);
    }
    for j in judged {
        members.entry(j.mode).or_default().push(j);
    }
    let mut modes: Vec<(usize, Vec<JudgedCandidate>)> = members
        .into_iter()
        .map(|(id, mut own)| {
            own.sort_by(JudgedCandidate::better);
            (id, own)
        })
        .collect();
    modes.sort_by(|a, b| a.1[0].better(&b.1[0]));
    modes.truncate(settings.max_modes);

    let weight = |own: &[JudgedCandidate]| if own[0].feasible() { 1.0 } else { INFEASIBLE_WEIGHT };
    let total: f64 = modes.iter().map(|(_, own)| weight(own)).sum();
    let mut refitted: Vec<SearchMode> = modes
        .into_iter()
        .filter_map(|(id, own)| {
            let share = weight(&own) / total;
            let wanted = ((elites as f64 * share).ceil() as usize).max(settings.min_feasible);
            let chosen = choose(own, wanted, settings);
            let candidates: Vec<CandidatePose> = chosen.iter().map(|j| j.candidate).collect();
            let surrogate = Surrogate::fit(&candidates, rotation, settings)?;
            Some(SearchMode { id, surrogate, share, elites: chosen })
        })
        .collect();
    refitted.sort_by_key(|m| m.id);
    refitted
}

/// The elites among members that are sorted best first: the feasible ones near the best, or the least violating where few are feasible.
fn choose(own: Vec<JudgedCandidate>, wanted: usize, settings: &SurrogateSettings) -> Vec<JudgedCandidate> {
    let feasible = own.iter().filter(|j| j.feasible()).count();
    let best = own[0].candidate.centroid();
    let enough = feasible >= settings.min_feasible;
    let near = |j: &JudgedCandidate| (j.candidate.centroid() - best).norm() <= settings.reach_m;
    own.into_iter().filter(|j| near(j) && (!enough || j.feasible())).take(wanted).collect()
}

#[cfg(test)]
mod tests {
    use repose_proto::place::Rejection;

    use super::*;

    fn at(x: f32, z: f32, cost: f64) -> JudgedCandidate {
        let mut j = JudgedCandidate::new(CandidatePose { centroid_m: [x, 0.0, z], yaw_rad: 0.0 }, 0);
        j.cost = cost;
        j
    }

    #[test]
    fn without_enough_feasible_candidates_the_least_violating_lead() {
        let settings = SurrogateSettings::default();
        let mut judged: Vec<JudgedCandidate> = (0..10).map(|i| at(0.01 * i as f32, 0.0, f64::from(i))).collect();
        for (i, j) in judged.iter_mut().enumerate().skip(2) {
            j.reject(Rejection::Goal, i as f64);
        }
        let modes = refit(Vec::new(), judged, 5, Rotation::Fixed, &settings);
        assert_eq!(modes.len(), 1);
        assert_eq!(modes[0].elites.len(), 5);
        assert!(modes[0].elites[0].feasible() && !modes[0].elites[4].feasible());
    }

    #[test]
    fn modes_that_lead_nowhere_get_less_of_the_batch() {
        let settings = SurrogateSettings::default();
        let mut judged: Vec<JudgedCandidate> = (0..8).map(|_| at(0.0, 0.0, 1.0)).collect();
        judged.extend((0..8).map(|_| {
            let mut j = at(0.5, 0.5, 1.0);
            j.mode = 1;
            j.reject(Rejection::Collision, 0.5);
            j
        }));
        let modes = refit(Vec::new(), judged, 20, Rotation::Fixed, &settings);
        assert!(modes[0].share > 0.7 && modes[1].share < 0.3);
    }
}
