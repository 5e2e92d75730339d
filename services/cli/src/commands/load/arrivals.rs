//! When requests are due, and which of them are interactive: drawn from the seed, so that two runs ask the same.

use clap::ValueEnum;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use repose_proto::Priority;

/// How requests of an open loop follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Arrivals {
    /// At equal intervals.
    Constant,
    /// At random, independently of each other: what many clients do together.
    Poisson,
    /// In bursts: intervals that vary twice as much as independent ones (gamma, coefficient of variation 2).
    Bursts,
}

impl Arrivals {
    /// When each request is due, seconds after the start, at so many a second in the mean.
    pub fn due_s(self, rate: f64, seed: u64) -> impl Iterator<Item = f64> {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut due = 0.0;
        std::iter::from_fn(move || {
            let now = due;
            due += self.interval(&mut random) / rate;
            Some(now)
        })
    }

    /// An interval of mean 1.
    fn interval(self, random: &mut Pcg64) -> f64 {
        let mut exponential = || -(1.0 - random.random::<f64>()).ln();
        match self {
            Self::Constant => 1.0,
            Self::Poisson => exponential(),
            // Gamma of shape 1/4 by Ahrens and Dieter's GS, of mean 1.
            Self::Bursts => {
                let shape = 0.25;
                let bound = 1.0 + shape / std::f64::consts::E;
                loop {
                    let p = bound * random.random::<f64>();
                    let e = -(1.0 - random.random::<f64>()).ln();
                    let x = if p <= 1.0 { p.powf(1.0 / shape) } else { -((bound - p) / shape).ln() };
                    let is_taken = if p <= 1.0 { e >= x } else { e >= (1.0 - shape) * x.ln() };
                    if is_taken {
                        return x / shape;
                    }
                }
            }
        }
    }

    /// The priority of a request: interactive for that share of them.
    pub fn priority(self, share: f64, seed: u64, i: usize) -> Priority {
        let drawn: f64 = Pcg64::seed_from_u64(seed ^ (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)).random();
        if drawn < share { Priority::Interactive } else { Priority::Batch }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrivals_have_their_rate_and_their_spread_and_are_the_same_for_the_same_seed() {
        for (arrivals, expected) in [(Arrivals::Constant, 0.0), (Arrivals::Poisson, 1.0), (Arrivals::Bursts, 2.0)] {
            let due: Vec<f64> = arrivals.due_s(50.0, 7).take(20_001).collect();
            assert_eq!(due, arrivals.due_s(50.0, 7).take(20_001).collect::<Vec<_>>());
            let intervals: Vec<f64> = due.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let mean = intervals.iter().sum::<f64>() / intervals.len() as f64;
            let variance = intervals.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / intervals.len() as f64;
            assert!((mean - 0.02).abs() < 0.001, "{arrivals:?}: mean {mean}");
            assert!((variance.sqrt() / mean - expected).abs() < 0.15, "{arrivals:?}: {}", variance.sqrt() / mean);
        }
    }

    #[test]
    fn the_share_of_interactive_requests_is_kept() {
        let interactive = (0..10_000).filter(|i| Arrivals::Constant.priority(0.3, 1, *i) == Priority::Interactive).count();
        assert!((2850..3150).contains(&interactive), "{interactive}");
    }
}
