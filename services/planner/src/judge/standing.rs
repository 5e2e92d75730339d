//! How the object stands where it was seen, by the forecasts: what every candidate is judged by alike.

use crate::learned::forecast::Forecasts;
use crate::scene::prepared::PreparedScene;

/// How an object stands where it was seen, by the forecasts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Standing {
    /// The probability that it stands by itself.
    pub stands: f64,
    /// The probability that the neighbour stays that most likely comes down when it is taken away; 1 without a neighbour.
    pub neighbours_stay: f64,
}

impl Standing {
    /// Of an object of a scene; one without an extent, which cannot be planned with, is taken to stand.
    pub fn of(prepared: &PreparedScene, id: u16, forecasts: &Forecasts) -> Self {
        let Some(measures) = prepared.stance_measures(id) else { return Self { stands: 1.0, neighbours_stay: 1.0 } };
        let neighbours = measures.neighbours.iter().map(|beside| forecasts.neighbour_stays.of(beside));
        Self { stands: forecasts.stands.of(&measures.own), neighbours_stay: neighbours.fold(1.0, f64::min) }
    }
}
