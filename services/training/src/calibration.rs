//! Platt scaling: the outcome network's last layer scaled and shifted so that what it says comes true as often as it says.
//!
//! Platt 1999, "Probabilistic outputs for support vector machines", with his smoothed targets; Lin, Lin and Weng 2007 on the fit. The network
//! learns a hedged label (½ for moving less than 5 cm), from places of which few are the planner's; what is asked of it is whether a place is
//! stable. Two numbers, fitted on scenes that chose the weights anyhow, leave the order of all candidates as it was.

use repose_networks::networks::OUTCOME;
use repose_networks::parameters::WeightMap;
use serde::Serialize;

use crate::error::TrainError;

/// Fewest forecasts of either outcome to fit on.
pub const MIN_FORECASTS: usize = 10;
/// Newton's steps; it settles in about six.
const STEPS: usize = 50;
/// Probabilities are taken for no surer than this.
const SUREST: f64 = 1e-6;

/// What is done to a logit: `slope` times it, plus `shift`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PlattScaling {
    /// Above 1 makes the network surer.
    pub slope: f64,
    /// Above 0 makes it more hopeful.
    pub shift: f64,
}

impl PlattScaling {
    /// Fits forecasts (a probability, and whether it came true) by maximum likelihood.
    ///
    /// # Errors
    /// [`TrainError::Calibration`] when fewer than [`MIN_FORECASTS`] came true or did not, or the fit is not one: a slope that is not positive would
    /// turn the order of candidates round.
    pub fn fit(forecasts: &[(f64, bool)]) -> Result<Self, TrainError> {
        let came = forecasts.iter().filter(|(_, came_true)| *came_true).count();
        let not = forecasts.len() - came;
        if came.min(not) < MIN_FORECASTS {
            let message = format!("expected at least {MIN_FORECASTS} forecasts that came true and as many that did not, got {came} and {not}");
            return Err(TrainError::Calibration(message));
        }
        let target = |came_true: bool| if came_true { (came as f64 + 1.0) / (came as f64 + 2.0) } else { 1.0 / (not as f64 + 2.0) };
        let points: Vec<(f64, f64)> = forecasts.iter().map(|(p, came_true)| (logit(*p), target(*came_true))).collect();
        let Self { mut slope, mut shift } = Self { slope: 1.0, shift: 0.0 };
        for _ in 0..STEPS {
            // The gradient of the negative log-likelihood and its second derivatives, slope first.
            let (mut g, mut h) = ([0.0; 2], [0.0; 3]);
            for (x, wanted) in &points {
                let p = sigmoid(slope * x + shift);
                let (error, weight) = (p - wanted, p * (1.0 - p));
                g = [g[0] + error * x, g[1] + error];
                h = [h[0] + weight * x * x, h[1] + weight * x, h[2] + weight];
            }
            let determinant = h[0] * h[2] - h[1] * h[1];
            if determinant < 1e-9 {
                break;
            }
            slope -= (h[2] * g[0] - h[1] * g[1]) / determinant;
            shift -= (h[0] * g[1] - h[1] * g[0]) / determinant;
        }
        if !(slope.is_finite() && shift.is_finite() && slope > 0.0) {
            return Err(TrainError::Calibration(format!("the fit gives slope {slope} and shift {shift}")));
        }
        Ok(Self { slope, shift })
    }

    /// What a probability becomes.
    pub fn of(&self, p: f64) -> f64 {
        sigmoid(self.slope * logit(p) + self.shift)
    }

    /// Builds it into the outcome network's last layer.
    ///
    /// # Errors
    /// [`TrainError::Calibration`] when there is no such layer.
    pub fn build_in(&self, values: &mut WeightMap) -> Result<(), TrainError> {
        for (name, shift) in [("weight", 0.0), ("bias", self.shift)] {
            let name = format!("{OUTCOME}out/{name}");
            let (_, numbers) = values.get_mut(&name).ok_or_else(|| TrainError::Calibration(format!("the weights have no {name}")))?;
            numbers.iter_mut().for_each(|x| *x = (self.slope * f64::from(*x) + shift) as f32);
        }
        Ok(())
    }
}

fn logit(p: f64) -> f64 {
    let p = p.clamp(SUREST, 1.0 - SUREST);
    (p / (1.0 - p)).ln()
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;
    use repose_networks::{NetworksConfig, Weights};

    use super::*;

    #[test]
    fn a_forecaster_that_hedges_is_put_right() {
        // It says what is half as sure and less hopeful than the truth: σ((x − 1) / 2).
        let mut rng = Pcg64::seed_from_u64(3);
        let forecasts: Vec<(f64, bool)> = (0..20_000)
            .map(|_| {
                let x: f64 = rng.random_range(-4.0..4.0);
                (sigmoid((x - 1.0) / 2.0), rng.random_bool(sigmoid(x)))
            })
            .collect();
        let scaling = PlattScaling::fit(&forecasts).unwrap();
        assert!((scaling.slope - 2.0).abs() < 0.1 && (scaling.shift - 1.0).abs() < 0.1, "{scaling:?}");
        assert!((scaling.of(sigmoid(-0.5)) - 0.5).abs() < 0.02);
        assert!(forecasts.iter().all(|(p, _)| scaling.of(*p) > scaling.of(*p - 0.001)), "the order stays");
    }

    #[test]
    fn too_little_and_what_speaks_against_the_network_are_refused() {
        let all_true = vec![(0.9, true); 100];
        assert!(PlattScaling::fit(&all_true).unwrap_err().to_string().contains("100 and 0"));
        let turned: Vec<(f64, bool)> = (0..200).map(|i| (f64::from(i % 10) / 10.0, i % 10 < 5)).collect();
        assert!(PlattScaling::fit(&turned).unwrap_err().to_string().contains("slope"));
    }

    #[test]
    fn it_is_built_into_the_last_layer_and_nothing_else() {
        let weights = Weights::from_bytes(&Weights::initial(&NetworksConfig::default(), 1).unwrap()).unwrap();
        let mut values = weights.values.clone();
        PlattScaling { slope: 2.0, shift: 0.5 }.build_in(&mut values).unwrap();
        for (name, (_, numbers)) in &values {
            let before = &weights.values[name].1;
            let expected: Vec<f32> = match name.as_str() {
                "outcome/out/weight" => before.iter().map(|x| 2.0 * x).collect(),
                "outcome/out/bias" => before.iter().map(|x| 2.0 * x + 0.5).collect(),
                _ => before.clone(),
            };
            assert_eq!(*numbers, expected, "{name}");
        }
        values.remove("outcome/out/bias");
        assert!(PlattScaling { slope: 2.0, shift: 0.5 }.build_in(&mut values).unwrap_err().to_string().contains("outcome/out/bias"));
    }
}
