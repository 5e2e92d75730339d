//! How two measurements go together: Pearson's r with its p-value, and the area under the curve of a score against a yes or no.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Pearson's correlation coefficient of pairs, −1 to 1; `None` with fewer than two pairs or where either side does not vary.
pub fn pearson_r(pairs: &[(f64, f64)]) -> Option<f64> {
    let n = pairs.len() as f64;
    let (mean_x, mean_y) = pairs.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for (x, y) in pairs {
        let (dx, dy) = (x - mean_x, y - mean_y);
        xx += dx * dx;
        yy += dy * dy;
        xy += dx * dy;
    }
    // Of equal values rounding leaves a sliver.
    let varies = |sum: f64, mean: f64| sum > n * (1e-12 * mean.abs().max(1e-12)).powi(2);
    (pairs.len() >= 2 && varies(xx, mean_x) && varies(yy, mean_y)).then(|| (xy / (xx * yy).sqrt()).clamp(-1.0, 1.0))
}

/// The two-sided p-value of a coefficient `r` of `n` independent pairs: Student's t with n − 2 degrees of freedom. `None` with fewer
/// than three pairs.
pub fn pearson_p(r: f64, n: usize) -> Option<f64> {
    let freedom = n.checked_sub(2).filter(|f| *f > 0)? as f64;
    if r.abs() >= 1.0 {
        return Some(0.0);
    }
    let t = r.abs() * (freedom / (1.0 - r * r)).sqrt();
    Some(2.0 * StudentsT::new(0.0, 1.0, freedom).ok()?.sf(t))
}

/// The probability that a random positive has a higher score than a random negative, ties counting half (Mann and Whitney's U); `None`
/// without both.
pub fn area_under_curve(scored: &[(f64, bool)]) -> Option<f64> {
    let positives = scored.iter().filter(|(_, positive)| *positive).count();
    let negatives = scored.len() - positives;
    if positives == 0 || negatives == 0 {
        return None;
    }
    let mut sorted = scored.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Equal scores share the mean of their ranks (from 1). Equality of numbers: −0 and 0 are one score.
    let rank_sum: f64 = sorted
        .chunk_by(|a, b| a.0 == b.0)
        .scan(0, |before, tied| {
            let rank = *before as f64 + (tied.len() + 1) as f64 / 2.0;
            *before += tied.len();
            Some(rank * tied.iter().filter(|(_, positive)| *positive).count() as f64)
        })
        .sum();
    let (p, n) = (positives as f64, negatives as f64);
    Some((rank_sum - p * (p + 1.0) / 2.0) / (p * n))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn r_is_the_one_worked_by_hand() {
        // Deviations −2 −1 0 1 2 and −2 0 −1 1 2 (mean 3): products 4 + 0 + 0 + 1 + 4 = 9, squares 10 and 10.
        let pairs = [(1.0, 1.0), (2.0, 3.0), (3.0, 2.0), (4.0, 4.0), (5.0, 5.0)];
        assert!((pearson_r(&pairs).expect("defined") - 0.9).abs() < 1e-12);
        let falling = pairs.map(|(x, y)| (x, -2.0 * y + 7.0));
        assert!((pearson_r(&falling).expect("defined") + 0.9).abs() < 1e-12);
        assert_eq!(pearson_r(&[(1.0, 2.0)]), None);
        assert_eq!(pearson_r(&[(0.1, 1.0), (0.1, 2.0), (0.1, 4.0)]), None, "one side does not vary");
    }

    #[test]
    fn p_is_the_textbooks_for_few_and_for_many_pairs() {
        // One degree of freedom is Cauchy's distribution: p = 1 − 2 arctan(t) / π, and r = 1/√2 gives t = 1, p = 1/2.
        assert!((pearson_p(std::f64::consts::FRAC_1_SQRT_2, 3).expect("defined") - 0.5).abs() < 1e-9);
        // Two: p = 1 − t / √(2 + t²) = 1 − |r|.
        assert!((pearson_p(-0.9, 4).expect("defined") - 0.1).abs() < 1e-9);
        // Tables of critical values: |r| = 0.632 for n = 10 and 0.197 for n = 100 at 5 %.
        assert!((pearson_p(0.632, 10).expect("defined") - 0.05).abs() < 2e-4);
        assert!((pearson_p(-0.1966, 100).expect("defined") - 0.05).abs() < 2e-4);
        assert_eq!((pearson_p(0.5, 2), pearson_p(1.0, 3)), (None, Some(0.0)));
    }

    #[test]
    fn the_papers_p_values_follow_from_its_coefficients() {
        // About a hundred scenes: r = −0.278 has p = 0.006, r = −0.147 has p = 0.161 (some scenes were left out).
        assert!((pearson_p(-0.278, 96).expect("defined") - 0.006).abs() < 0.001);
        assert!((pearson_p(-0.147, 93).expect("defined") - 0.161).abs() < 0.003);
    }

    #[test]
    fn equal_scores_count_half() {
        // Positives 0.9 and 0.5, negatives 0.5 and 0.1: 1 + 1 + ½ + 1 of 4.
        let scored = [(0.9, true), (0.5, true), (0.5, false), (0.1, false)];
        assert_eq!(area_under_curve(&scored), Some(3.5 / 4.0));
        assert_eq!(area_under_curve(&[(0.3, true), (0.3, false), (0.3, false)]), Some(0.5));
        assert_eq!(area_under_curve(&[(0.0, true), (-0.0, false)]), Some(0.5));
        assert_eq!(area_under_curve(&[(0.3, true)]), None);
        assert_eq!(area_under_curve(&[]), None);
    }

    proptest! {
        #[test]
        fn the_area_is_what_counting_pairs_gives(scored in prop::collection::vec((0u8..6, any::<bool>()), 2..40)) {
            let scored: Vec<(f64, bool)> = scored.into_iter().map(|(s, positive)| (f64::from(s), positive)).collect();
            let of = |which: bool| scored.iter().filter(move |(_, p)| *p == which).map(|(s, _)| *s);
            let wins: f64 = of(true).flat_map(|p| of(false).map(move |n| if p > n { 1.0 } else if p == n { 0.5 } else { 0.0 })).sum();
            let pairs = of(true).count() * of(false).count();
            match area_under_curve(&scored) {
                Some(area) => prop_assert!((area - wins / pairs as f64).abs() < 1e-12),
                None => prop_assert_eq!(pairs, 0),
            }
        }
    }
}
