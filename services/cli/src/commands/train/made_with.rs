//! What scenes are measured with, as one hash that is kept with each: a fit on scenes of which some were measured with other trees, networks or
//! forecasts than the rest would be right for neither.
//!
//! What is fitted on the scenes is left out, or no fit could go on with the scenes of the one before.

use repose_belief::learned::parts;
use repose_networks::digest::digest;
use repose_networks::{Weights, masks};

/// Of scenes of which only beliefs are measured: what comes with the program, but what is fitted, by its name.
pub fn of_beliefs(fitted: &[&str]) -> String {
    // Some views have masks that perception's network finds.
    digest(parts().into_iter().chain([("masks", masks::FILE)]).filter(|(name, _)| !fitted.contains(name)))
}

/// Of scenes for which the planner is asked: all of that, and the weights with their forecasts, but those that are fitted, by their names.
pub fn of_weights(weights: &Weights, fitted: &[&str]) -> String {
    let (beliefs, networks) = (of_beliefs(&[]), weights.networks_hash());
    let kept = weights.info.forecasts.iter().filter(|(name, _)| !fitted.contains(&name.as_str()));
    let forecasts: Vec<(&str, String)> = kept.map(|(name, forecast)| (name.as_str(), forecast.to_string())).collect();
    let forecasts = forecasts.iter().map(|(name, text)| (*name, text.as_bytes()));
    digest([("beliefs", beliefs.as_bytes()), ("networks", networks.as_bytes())].into_iter().chain(forecasts))
}

#[cfg(test)]
mod tests {
    use repose_planner::learned::forecast::{NEIGHBOUR_STAYS, STABILITY, STANDS, SUCCESS};
    use serde_json::json;

    use super::super::{BACK, BEARING, CUT, FARTHER, FOOT};
    use super::*;

    #[test]
    fn another_network_or_forecast_makes_another_hash_and_the_forecast_that_is_fitted_does_not() {
        let own = Weights::embedded().expect("the program's weights");
        let of = |weights: &Weights| of_weights(weights, &[SUCCESS]);
        let with = |forecast: &str| {
            let mut weights = own.clone();
            weights.info.forecasts.insert(forecast.to_owned(), json!({"logit": 1}));
            weights
        };
        assert_eq!(of(&with(SUCCESS)), of(&own));
        for forecast in [STABILITY, STANDS, NEIGHBOUR_STAYS] {
            assert_ne!(of(&with(forecast)), of(&own), "{forecast}");
        }
        let mut other = own.clone();
        other.values.get_mut("relations/out/bias").expect("a relation predictor").1[0] += 1.0;
        assert_eq!(other.outcome_hash(), own.outcome_hash());
        assert_ne!(of(&other), of(&own));
    }

    #[test]
    fn what_is_fitted_is_left_out_by_the_name_that_it_has_on_the_command_line() {
        let fitted: [&[&str]; 6] = [&[], &[BACK], &[CUT], &[FARTHER], &[BEARING], &[FOOT]];
        let hashes = fitted.map(of_beliefs);
        assert!((0..hashes.len()).all(|i| !hashes[..i].contains(&hashes[i])), "{hashes:?}");
    }
}
