//! How the object stands where it was seen, by the forecasts: what every candidate is judged by alike.

use repose_belief::Shape;

use crate::learned::forecast::Forecasts;
use crate::learned::standing::Stance;
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
        let Some(stance) = Stance::of(prepared, id) else { return Self { stands: 1.0, neighbours_stay: 1.0 } };
        let is_near = |shape: &Shape| stance.is_near(shape);
        let near = prepared.belief.objects.iter().filter(|(other, o)| **other != id && o.shape.as_ref().is_some_and(is_near));
        let neighbours = near.filter_map(|(other, _)| {
            let measures = Stance::of(prepared, *other)?.beside(&stance)?;
            Some(forecasts.neighbour_stays.of(&measures))
        });
        Self { stands: forecasts.stands.of(&stance.measures()), neighbours_stay: neighbours.fold(1.0, f64::min) }
    }
}
