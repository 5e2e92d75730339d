//! Two methods on the same scenes: how much more often one succeeds, with what only pairs can tell.
//!
//! Scenes differ far more than methods do, so the difference is taken scene by scene: its interval is the bootstrap's over scenes, its
//! p-value McNemar's exact one, which looks only at the scenes where exactly one of the two succeeds.

use serde::Serialize;

use crate::statistics::resample::interval;

/// One method against another.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Paired {
    /// Scenes on which both were tried.
    pub scenes: usize,
    /// How much more often the first succeeds, in points of a percent.
    pub difference: f64,
    /// Its 95 % interval.
    pub interval: Option<[f64; 2]>,
    /// Scenes where only the first succeeds.
    pub only_first: usize,
    /// Scenes where only the second does.
    pub only_second: usize,
    /// McNemar's exact two-sided p-value.
    pub p: f64,
}

impl Paired {
    /// Of (first, second) successes, one pair a scene; `None` without any.
    pub fn of(outcomes: &[(bool, bool)]) -> Option<Self> {
        if outcomes.is_empty() {
            return None;
        }
        let points = |(first, second): (bool, bool)| 100.0 * (f64::from(u8::from(first)) - f64::from(u8::from(second)));
        let mean = |sum: f64, n: usize| sum / n as f64;
        let count = |wanted: (bool, bool)| outcomes.iter().filter(|o| **o == wanted).count();
        let (only_first, only_second) = (count((true, false)), count((false, true)));
        Some(Self {
            scenes: outcomes.len(),
            difference: mean(outcomes.iter().copied().map(points).sum(), outcomes.len()),
            interval: interval(outcomes, 1, |drawn| Some(mean(drawn.iter().map(|o| points(**o)).sum(), drawn.len()))),
            only_first,
            only_second,
            p: exact_p(only_first, only_second),
        })
    }
}

/// Twice the probability of at most `min(a, b)` heads in `a + b` throws of a fair coin, 1 at most.
fn exact_p(a: usize, b: usize) -> f64 {
    let n = a + b;
    // log2 of the binomial coefficient, term by term: n is a number of scenes.
    let mut log_choose = 0.0f64;
    let mut tail = 0.0;
    for k in 0..=a.min(b) {
        if k > 0 {
            log_choose += ((n - k + 1) as f64).log2() - (k as f64).log2();
        }
        tail += (log_choose - n as f64).exp2();
    }
    (2.0 * tail).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mcnemars_p_is_the_textbooks() {
        // Two-sided exact binomial tests of 1 in 10, 5 in 10 and 0 in 6 at a half.
        for ((a, b), p) in [((1, 9), 0.021_484_375), ((5, 5), 1.0), ((6, 0), 0.03125), ((0, 0), 1.0)] {
            assert!((exact_p(a, b) - p).abs() < 1e-9, "{a} {b}: {}", exact_p(a, b));
        }
    }

    #[test]
    fn the_difference_is_taken_scene_by_scene() {
        let mut outcomes = vec![(true, true); 80];
        outcomes.extend([(true, false); 15]);
        outcomes.extend([(false, true); 5]);
        let paired = Paired::of(&outcomes).expect("pairs");
        assert_eq!((paired.scenes, paired.difference, paired.only_first, paired.only_second), (100, 10.0, 15, 5));
        let [low, high] = paired.interval.expect("defined");
        // Independent samples of 95 % and 85 % would have a half-width of 8.2 points.
        assert!(low > 0.0 && high < 20.0 && (high - low) / 2.0 > 6.0, "{low} {high}");
        assert_eq!(Paired::of(&[]), None);
    }
}
