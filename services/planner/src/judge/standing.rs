//! How the object stands where it was seen, and in the attitude that it is planned in, by the forecasts: what every candidate is judged by alike.

use std::sync::Arc;

use crate::judge::problem::PlacementProblem;
use crate::learned::forecast::Forecasts;
use crate::learned::neighbours::StanceMeasures;
use crate::scene::turned::Turned;

/// How an object stands, by the forecasts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Standing {
    /// The probability that it stands by itself in the attitude that it is planned in.
    pub stands: f64,
    /// The same in the attitude in which it was seen.
    pub stood: f64,
    /// The probability that the neighbour stays that most likely comes down when it is taken away; 1 without a neighbour.
    pub neighbours_stay: f64,
}

impl Standing {
    /// Of the object of a problem; one without an extent, which cannot be planned with, is taken to stand.
    pub fn of(problem: &PlacementProblem<'_>, forecasts: &Forecasts) -> Self {
        let [planned, seen] = [problem.prepared, problem.as_seen()].map(|scene| scene.stance_measures(problem.query.id));
        let stands = |stance: &Option<Arc<StanceMeasures>>, turned: Option<&Turned<'_>>| {
            stance.as_ref().map_or(1.0, |stance| forecasts.stands.of(&stance.own(turned)))
        };
        let neighbours = seen.iter().flat_map(|stance| &stance.neighbours);
        Self {
            stands: stands(&planned, problem.turned),
            stood: stands(&seen, None),
            neighbours_stay: neighbours.map(|beside| forecasts.neighbour_stays.of(beside)).fold(1.0, f64::min),
        }
    }
}
