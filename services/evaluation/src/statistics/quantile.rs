//! Quantiles of measured values: the one definition that every table and bench uses.

use serde::Serialize;

/// Values in ascending order, so that several quantiles cost one sort.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sorted(Vec<f64>);

impl Sorted {
    /// Sorts values; NaN goes to the ends.
    pub fn new(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        Self(values)
    }

    /// The smallest value that at least a share `share` (0 to 1) of all values do not exceed (the nearest-rank definition); `None` without
    /// values.
    pub fn at(&self, share: f64) -> Option<f64> {
        let rank = (self.0.len() as f64 * share).ceil() as usize;
        self.0.get(rank.saturating_sub(1).min(self.0.len().saturating_sub(1))).copied()
    }

    /// As [`Sorted::at`]; NaN, which is null in JSON, without values.
    pub fn at_or_nan(&self, share: f64) -> f64 {
        self.at(share).unwrap_or(f64::NAN)
    }

    /// The arithmetic mean; NaN without values.
    pub fn mean(&self) -> f64 {
        self.0.iter().sum::<f64>() / self.0.len() as f64
    }

    /// How many values there are.
    pub fn count(&self) -> usize {
        self.0.len()
    }
}

impl FromIterator<f64> for Sorted {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        Self::new(values.into_iter().collect())
    }
}

/// The middle, the tail and the worst of a measure.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Greatest.
    pub max: f64,
}

impl Spread {
    /// Of any values; zeros without.
    pub fn of(values: Vec<f64>) -> Self {
        let sorted = Sorted::new(values);
        let at = |share| sorted.at(share).unwrap_or(0.0);
        Self { p50: at(0.5), p99: at(0.99), max: at(1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantile_is_the_nearest_rank() {
        let sorted: Sorted = (1..=200).rev().map(f64::from).collect();
        assert_eq!([0.0, 0.5, 0.99, 1.0].map(|share| sorted.at(share)), [Some(1.0), Some(100.0), Some(198.0), Some(200.0)]);
        assert_eq!((sorted.mean(), sorted.count()), (100.5, 200));
        assert_eq!(Sorted::new(vec![7.0]).at(0.01), Some(7.0));
    }

    #[test]
    fn without_values_there_is_none() {
        let none = Sorted::default();
        assert_eq!(none.at(0.5), None);
        assert!(none.at_or_nan(0.5).is_nan() && none.mean().is_nan());
        assert_eq!(Spread::of(Vec::new()), Spread::default());
    }

    #[test]
    fn a_spread_names_the_middle_the_tail_and_the_worst() {
        let spread = Spread::of((1..=200).rev().map(f64::from).collect());
        assert_eq!((spread.p50, spread.p99, spread.max), (100.0, 198.0, 200.0));
    }
}
