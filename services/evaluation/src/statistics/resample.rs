//! 95 % intervals of figures whose observations come in groups: the bootstrap that draws whole groups.
//!
//! Pairs of one scene, or samples about one object, resemble each other; an interval that took them for independent would be too narrow.
//! The percentile bootstrap over clusters (Davison & Hinkley, "Bootstrap Methods and their Application", 3.8) draws scenes instead.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// How often the groups are drawn anew: beyond the limits of a 95 % interval are then 25 values at either end.
const RESAMPLES: usize = 1000;

/// The 95 % interval of `statistic` over draws of as many groups as there are, with repetition; `None` where there is no group or where
/// more than a tenth of the draws do not define the statistic. The same seed gives the same interval.
pub fn interval<G>(groups: &[G], seed: u64, statistic: impl Fn(&[&G]) -> Option<f64>) -> Option<[f64; 2]> {
    if groups.is_empty() {
        return None;
    }
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut drawn: Vec<&G> = Vec::with_capacity(groups.len());
    let mut values: Vec<f64> = (0..RESAMPLES)
        .filter_map(|_| {
            drawn.clear();
            drawn.extend((0..groups.len()).map(|_| &groups[rng.random_range(0..groups.len())]));
            statistic(&drawn)
        })
        .collect();
    if values.len() < RESAMPLES * 9 / 10 {
        return None;
    }
    values.sort_by(f64::total_cmp);
    let tail = values.len() / 40;
    Some([values[tail], values[values.len() - 1 - tail]])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(groups: &[&Vec<f64>]) -> Option<f64> {
        let all: Vec<f64> = groups.iter().flat_map(|g| g.iter().copied()).collect();
        (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
    }

    #[test]
    fn the_interval_of_a_mean_is_about_two_standard_errors_and_repeats() {
        // A fair coin, 400 throws: the standard error is 0.025.
        let groups: Vec<Vec<f64>> = (0..400).map(|i| vec![f64::from(u8::from(i % 2 == 0))]).collect();
        let [low, high] = interval(&groups, 3, mean).expect("defined");
        assert!((low - 0.451).abs() < 0.012 && (high - 0.549).abs() < 0.012, "{low} {high}");
        assert_eq!(interval(&groups, 3, mean), Some([low, high]));
    }

    #[test]
    fn groups_that_say_one_thing_count_once() {
        let single: Vec<Vec<f64>> = (0..200).map(|i| vec![f64::from(u8::from(i % 2 == 0))]).collect();
        let grouped: Vec<Vec<f64>> = (0..20).map(|i| vec![f64::from(u8::from(i % 2 == 0)); 10]).collect();
        let width = |groups: &[Vec<f64>]| interval(groups, 1, mean).map_or(0.0, |[low, high]| high - low);
        assert!(width(&grouped) > 2.5 * width(&single), "{} {}", width(&grouped), width(&single));
    }

    #[test]
    fn without_groups_or_without_a_statistic_there_is_no_interval() {
        assert_eq!(interval(&[], 1, mean), None);
        assert_eq!(interval(&[Vec::new(), Vec::new()], 1, mean), None);
    }
}
