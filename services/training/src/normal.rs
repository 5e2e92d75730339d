//! A cheap normal distribution, for disturbances of which a training step draws thousands.

use rand::Rng;
use rand_pcg::Pcg64;

/// About a standard normal: four uniform numbers out of one draw. Its tails end at 3.5, which a sensor's do not mind.
pub fn gaussian(rng: &mut Pcg64) -> f32 {
    let bits = rng.next_u64();
    let sum: f32 = (0..4).map(|k| (bits >> (16 * k) & 0xffff) as f32 / 65_536.0).sum();
    (sum - 2.0) * 3f32.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn the_cheap_normal_has_mean_zero_and_variance_one() {
        let mut rng = Pcg64::seed_from_u64(1);
        let values: Vec<f32> = (0..20_000).map(|_| gaussian(&mut rng)).collect();
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        let variance = values.iter().map(|v| v * v).sum::<f32>() / values.len() as f32;
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
    }
}
