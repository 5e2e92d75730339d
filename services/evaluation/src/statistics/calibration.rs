//! Whether what is said with probability p comes true p of the time: the reliability diagram and the expected calibration error.
//!
//! Guo et al., "On Calibration of Modern Neural Networks" (ICML 2017): ten bins of equal width; the error is the mean over bins of
//! |mean probability − share that came true|, weighted by how many fell into each. With few observations it is above zero even for a
//! perfect forecaster, so [`Calibration::floor`] says what such a one would get.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::Serialize;

/// Bins of equal width.
pub const BINS: usize = 10;
/// Outcomes drawn for the floor.
const FLOOR_DRAWS: usize = 500;

/// One bin of the diagram.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Bin {
    /// How many forecasts fell into it.
    pub count: usize,
    /// Their mean probability, 0 to 1.
    pub predicted: f64,
    /// The share that came true, 0 to 1.
    pub observed: f64,
}

/// The diagram and its figure.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Calibration {
    /// [`BINS`] bins from 0 to 1.
    pub bins: Vec<Bin>,
    /// Expected calibration error, 0 to 1; `None` without forecasts.
    pub error: Option<f64>,
    /// The mean error of a forecaster whose probabilities are right, with as many forecasts of the same probabilities.
    pub floor: Option<f64>,
}

impl Calibration {
    /// Of forecasts: a probability and whether it came true. Probabilities outside 0 to 1 count as the nearest of the two.
    pub fn of(forecasts: &[(f64, bool)], seed: u64) -> Self {
        let bins = binned(forecasts);
        let error = error_of(&bins);
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut drawn = forecasts.to_vec();
        let floor = error.map(|_| {
            let errors = (0..FLOOR_DRAWS).filter_map(|_| {
                drawn.iter_mut().for_each(|(p, came_true)| *came_true = rng.random_bool(p.clamp(0.0, 1.0)));
                error_of(&binned(&drawn))
            });
            errors.sum::<f64>() / FLOOR_DRAWS as f64
        });
        Self { bins, error, floor }
    }
}

fn binned(forecasts: &[(f64, bool)]) -> Vec<Bin> {
    let mut bins = vec![Bin::default(); BINS];
    for (p, came_true) in forecasts {
        let p = p.clamp(0.0, 1.0);
        let bin = &mut bins[((p * BINS as f64) as usize).min(BINS - 1)];
        bin.count += 1;
        bin.predicted += p;
        bin.observed += f64::from(u8::from(*came_true));
    }
    for bin in bins.iter_mut().filter(|b| b.count > 0) {
        bin.predicted /= bin.count as f64;
        bin.observed /= bin.count as f64;
    }
    bins
}

fn error_of(bins: &[Bin]) -> Option<f64> {
    let all: usize = bins.iter().map(|b| b.count).sum();
    let error = |b: &Bin| (b.predicted - b.observed).abs() * b.count as f64;
    (all > 0).then(|| bins.iter().map(error).sum::<f64>() / all as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_is_the_one_worked_by_hand() {
        // Bin 0.9 to 1: 0.95 and 1.0, one true: |0.975 − 0.5| · 2. Bin 0.2 to 0.3: 0.25 twice and 0.2, none true: 0.2333 · 3.
        let forecasts = [(0.95, true), (1.0, false), (0.25, false), (0.25, false), (0.2, false)];
        let calibration = Calibration::of(&forecasts, 1);
        assert!((calibration.error.expect("forecasts") - (0.475 * 2.0 + 0.7) / 5.0).abs() < 1e-12);
        assert_eq!(calibration.bins.iter().map(|b| b.count).collect::<Vec<_>>(), [0, 0, 3, 0, 0, 0, 0, 0, 0, 2]);
        assert_eq!((calibration.bins[9].predicted, calibration.bins[9].observed), (0.975, 0.5));
    }

    #[test]
    fn a_perfect_forecaster_is_at_the_floor_and_the_floor_sinks_with_more_forecasts() {
        let right: Vec<(f64, bool)> = (0..100).map(|i| (0.5, i % 2 == 0)).collect();
        let calibration = Calibration::of(&right, 1);
        assert_eq!(calibration.error, Some(0.0));
        // The mean of |share − ½| of a hundred throws is √(2 / π) · 0.05.
        assert!((calibration.floor.expect("forecasts") - 0.0399).abs() < 0.005, "{:?}", calibration.floor);
        let fewer = Calibration::of(&right[..10], 1).floor.expect("forecasts");
        assert!(fewer > 2.0 * calibration.floor.expect("forecasts"));
        let certain = Calibration::of(&[(1.0, true), (0.0, false)], 1);
        assert_eq!((certain.error, certain.floor), (Some(0.0), Some(0.0)));
    }

    #[test]
    fn without_forecasts_nothing_is_said() {
        let none = Calibration::of(&[], 1);
        assert_eq!((none.error, none.floor, none.bins.len()), (None, None, BINS));
    }
}
