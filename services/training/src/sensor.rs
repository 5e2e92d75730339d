//! What a depth camera makes of clean depth, for training: noise that grows with distance and is partly shared between neighbours,
//! quantisation, and missing returns at jumps. Fresh noise every time a view is used.

use rand::{Rng, RngExt};
use rand_pcg::Pcg64;
use repose_dataset::Composite;

/// A range of cameras; each picture draws its own.
#[derive(Debug, Clone, Copy)]
pub struct SensorModel {
    /// Standard deviation of the pixel's own noise at 1 m, metres, at most; grows with the square of distance.
    pub own_noise_at_1m: f32,
    /// The same of noise that is smooth over [`SensorModel::patch_px`].
    pub smooth_noise_at_1m: f32,
    /// Pixels between the knots of the smooth noise.
    pub patch_px: usize,
    /// Step of the readings at 1 m, metres, at most; grows with the square of distance.
    pub quantum_at_1m: f32,
    /// Share of pixels without a return, at most.
    pub missing: f32,
}

impl Default for SensorModel {
    fn default() -> Self {
        Self { own_noise_at_1m: 0.0015, smooth_noise_at_1m: 0.001, patch_px: 12, quantum_at_1m: 0.001, missing: 0.03 }
    }
}

impl SensorModel {
    /// Disturbs a picture's depth in place.
    pub fn disturb(&self, picture: &mut Composite, rng: &mut Pcg64) {
        let [own, smooth, quantum, missing] = [self.own_noise_at_1m, self.smooth_noise_at_1m, self.quantum_at_1m, self.missing]
            .map(|most| most * rng.random_range(0.2..1.0f32));
        let columns = picture.width / self.patch_px + 2;
        let knots: Vec<f32> = (0..columns * (picture.height / self.patch_px + 2)).map(|_| gaussian(rng)).collect();
        for (i, z) in picture.depth_m.iter_mut().enumerate().filter(|(_, z)| **z > 0.0) {
            if rng.random_range(0.0..1.0f32) < missing {
                *z = 0.0;
                continue;
            }
            let (x, y) = ((i % picture.width) as f32 / self.patch_px as f32, (i / picture.width) as f32 / self.patch_px as f32);
            let (cx, cy, fx, fy) = (x as usize, y as usize, x.fract(), y.fract());
            let at = |dx: usize, dy: usize| knots[(cy + dy) * columns + cx + dx];
            let shared = (at(0, 0) * (1.0 - fx) + at(1, 0) * fx) * (1.0 - fy) + (at(0, 1) * (1.0 - fx) + at(1, 1) * fx) * fy;
            let square = *z * *z;
            let step = (quantum * square).max(1e-4);
            *z = ((*z + square * (own * gaussian(rng) + smooth * shared)) / step).round() * step;
        }
    }
}

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
