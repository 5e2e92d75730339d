//! A learned forecast: the probability of something from measures that have names, by boosted trees.
//!
//! Forecasts are part of the weights: they travel in the weights file, inference serves them, and the hash of the weights covers them.
//! They are fitted on measures of this program, so a file names its measures and others are refused.

use std::collections::BTreeMap;

use repose_proto::CallError;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::learned::{neighbours, stability, standing, success};
use repose_belief::boosted_trees::BoostedTrees;

/// What the weights call the forecast that an object stays ([`stability`]).
pub const STABILITY: &str = "stability";
/// What the weights call the forecast that a placement succeeds ([`success`]).
pub const SUCCESS: &str = "success";

/// What the weights call the forecast that an object stands by itself ([`standing`]).
pub const STANDS: &str = "stands";
/// What the weights call the forecast that a neighbour stays when an object is taken away ([`standing`]).
pub const NEIGHBOUR_STAYS: &str = "neighbour_stays";

/// The data that a forecast was fitted on.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForecastFitData {
    /// Scenes of the training split.
    pub scenes: u64,
    /// Releases.
    pub releases: usize,
    /// BLAKE3 of the parameters of the outcome network of the same weights, whose word is among the measures of places.
    pub outcome_hash: String,
}

/// Why something is no forecast of this program.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NotAForecast(String);

/// A probability from named measures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Forecast {
    measures: Vec<String>,
    fitted_on: ForecastFitData,
    logit: BoostedTrees,
}

impl Forecast {
    /// A forecast from measures of these names, in this order.
    ///
    /// # Errors
    /// When a branch leads nowhere or a value is not finite.
    pub fn new(names: &[&str], logit: BoostedTrees, fitted_on: ForecastFitData) -> Result<Self, NotAForecast> {
        Self { measures: names.iter().map(|&name| name.to_owned()).collect(), fitted_on, logit }.checked(names)
    }

    /// Reads one.
    ///
    /// # Errors
    /// When the value is no forecast, or reads other measures than these.
    pub fn read(value: &Value, names: &[&str]) -> Result<Self, NotAForecast> {
        Self::deserialize(value).map_err(|e| NotAForecast(e.to_string()))?.checked(names)
    }

    fn checked(self, names: &[&str]) -> Result<Self, NotAForecast> {
        if self.measures != names {
            return Err(NotAForecast(format!("measures: {}, so it is of another version of this program", others(&self.measures, names))));
        }
        if !self.logit.is_sound(names.len()) {
            let expected = format!("expected finite trees over {} measures, each branch to a later split or a leaf", names.len());
            return Err(NotAForecast(format!("logit: {expected}")));
        }
        Ok(self)
    }

    /// The data that it was fitted on.
    pub fn fitted_on(&self) -> &ForecastFitData {
        &self.fitted_on
    }

    /// The probability, from finite measures in the order of their names.
    pub fn of(&self, measures: &[f32]) -> f64 {
        probability(self.logit.of(measures))
    }

    /// A probability that none is above which it gives for the same measures but those that are open.
    pub fn most(&self, measures: &[f32], is_open: impl Fn(usize) -> bool) -> f64 {
        probability(self.logit.most(measures, is_open))
    }
}

/// In what measures differ from those of these names.
fn others(measures: &[String], names: &[&str]) -> String {
    let missing: Vec<&str> = names.iter().copied().filter(|name| measures.iter().all(|measure| measure != name)).collect();
    let unknown: Vec<&str> = measures.iter().map(String::as_str).filter(|measure| !names.contains(measure)).collect();
    let told = |what: &str, these: &[&str]| (!these.is_empty()).then(|| format!("{what} {}", these.join(", ")));
    let told: Vec<String> = told("it lacks", &missing).into_iter().chain(told("it has unknown", &unknown)).collect();
    if told.is_empty() { "they are in another order".to_owned() } else { told.join(" and ") }
}

fn probability(logit: f64) -> f64 {
    1.0 / (1.0 + (-logit).exp())
}

/// The forecasts that the weights in service have.
#[derive(Debug, Clone, PartialEq)]
pub struct Forecasts {
    /// Whether an object stays where it is let go.
    pub stability: Forecast,
    /// Whether an object stands by itself.
    pub stands: Forecast,
    /// Whether a neighbour stays when an object is taken away.
    pub neighbour_stays: Forecast,
    /// Whether a placement succeeds; weights made before there was such a forecast have none.
    pub success: Option<Forecast>,
}

impl Forecasts {
    /// The forecasts of weights, by name.
    ///
    /// # Errors
    /// `failed_precondition` when the weights lack one but that of success, or a forecast is not one of this program.
    pub fn read(by_name: &BTreeMap<String, Value>) -> Result<Self, CallError> {
        let read = |name: &str, names: &[&str]| {
            let read =
                |value| Forecast::read(value, names).map_err(|e| CallError::precondition(format!("the weights' forecast {name}: {e}")));
            by_name.get(name).map(read).transpose()
        };
        let needed = |name: &str, names: &[&str], network: &str| {
            read(name, names)?.ok_or_else(|| {
                CallError::precondition(format!("the weights have no forecast {name}; `repose train --network {network}` fits it"))
            })
        };
        Ok(Self {
            stability: needed(STABILITY, &stability::names(), "stability")?,
            stands: needed(STANDS, &standing::names(), "standing")?,
            neighbour_stays: needed(NEIGHBOUR_STAYS, &neighbours::names(), "standing")?,
            success: read(SUCCESS, &success::names())?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_belief::boosted_trees::DecisionTree;

    fn leaf(value: f32) -> BoostedTrees {
        BoostedTrees { bias: 0.0, trees: vec![DecisionTree { splits: Vec::new(), leaves: vec![value] }] }
    }

    #[test]
    fn forecasts_of_other_measures_or_broken_trees_are_refused_by_name() {
        let own = |logit| serde_json::to_value(Forecast::new(&["a", "b"], logit, ForecastFitData::default()).unwrap()).unwrap();
        let value = own(leaf(0.0));
        assert_eq!(Forecast::read(&value, &["a", "b"]).unwrap().of(&[1.0, 2.0]), 0.5);
        let refused = |names: &[&str]| Forecast::read(&value, names).unwrap_err().to_string();
        assert!(refused(&["a", "c"]).contains("measures: it lacks c and it has unknown b"), "{}", refused(&["a", "c"]));
        assert!(refused(&["b", "a"]).contains("another order"));
        assert!(Forecast::new(&["a"], leaf(f32::NAN), ForecastFitData::default()).unwrap_err().to_string().contains("logit"));
        let of =
            |entries: &[(&str, &Value)]| Forecasts::read(&entries.iter().map(|(name, v)| ((*name).to_owned(), (*v).clone())).collect());
        assert!(of(&[]).unwrap_err().message.contains("no forecast stability"));
        assert!(of(&[(STABILITY, &value)]).unwrap_err().message.contains("stability: measures"));
        let made = |names: &[&str]| serde_json::to_value(Forecast::new(names, leaf(1.0), ForecastFitData::default()).unwrap()).unwrap();
        let (stability, stands, stays) = (made(&stability::names()), made(&standing::names()), made(&neighbours::names()));
        assert!(of(&[(STABILITY, &stability)]).unwrap_err().message.contains("--network standing"));
        let needed = [(STABILITY, &stability), (STANDS, &stands), (NEIGHBOUR_STAYS, &stays)];
        assert_eq!(of(&needed).unwrap().success, None);
        assert!(of(&[needed.as_slice(), &[(SUCCESS, &value)]].concat()).unwrap_err().message.contains("success: measures"));
    }
}
