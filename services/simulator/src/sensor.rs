//! What a depth camera makes of true depth: noise that grows with distance, steps, and missing returns where the surface turns away.

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use repose_geometry::{Image, Pinhole};

/// The sensor's imperfections.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorSettings {
    /// Steps of the reading, metres.
    pub quantum_m: f32,
    /// Standard deviation of the noise at one metre; it grows with the square of the distance.
    pub noise_at_1m: f32,
    /// Cosine of the angle between the surface's normal and the line of sight below which there is no reading.
    pub grazing_cos: f32,
    /// A jump in depth to a neighbour beyond which the pixel has no reading, as a share of the depth; 0 keeps all edges.
    pub edge_jump: f32,
}

impl Default for SensorSettings {
    fn default() -> Self {
        Self { quantum_m: 0.001, noise_at_1m: 0.0012, grazing_cos: 0.12, edge_jump: 0.0 }
    }
}

/// The depth that a camera would report for true depth (metres, 0 = nothing): same picture size, 0 = no reading.
pub fn sensed(depth_m: &Image<f32>, camera: &Pinhole, settings: &SensorSettings, rng: &mut impl Rng) -> Image<f32> {
    let (width, height) = (depth_m.width(), depth_m.height());
    let mut out = Image::filled(width, height, 0.0f32);
    let (inverse_fx, inverse_fy) = (1.0 / camera.fx as f32, 1.0 / camera.fy as f32);
    for v in 0..height {
        for u in 0..width {
            // Every pixel draws, so that a pixel's noise does not depend on what others show.
            let normal: f32 = StandardNormal.sample(rng);
            let z = depth_m[(u, v)];
            if z <= 0.0 {
                continue;
            }
            let right = depth_m[((u + 1).min(width - 1), v)] - depth_m[(u.saturating_sub(1), v)];
            let down = depth_m[(u, (v + 1).min(height - 1))] - depth_m[(u, v.saturating_sub(1))];
            // Slopes of the surface along the picture's axes; two pixels apart.
            let (sx, sy) = (right / (2.0 * z * inverse_fx), down / (2.0 * z * inverse_fy));
            let ray = [(u as f32 - camera.cx as f32) * inverse_fx, (v as f32 - camera.cy as f32) * inverse_fy];
            let along = (1.0 - sx * ray[0] - sy * ray[1]).abs();
            let cosine = along / ((1.0 + sx * sx + sy * sy) * (1.0 + ray[0] * ray[0] + ray[1] * ray[1])).sqrt();
            let jump = right.abs().max(down.abs());
            let is_edge = settings.edge_jump > 0.0 && jump > settings.edge_jump * z;
            // A jump in depth looks like a grazing surface; only slopes are judged by the angle.
            let is_slope = jump < 0.04 * z;
            if is_edge || (is_slope && cosine < settings.grazing_cos) {
                continue;
            }
            let noisy = z + normal * settings.noise_at_1m * z * z;
            out[(u, v)] = ((noisy / settings.quantum_m).round() * settings.quantum_m).max(0.0);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };

    #[test]
    fn noise_grows_with_the_square_of_the_distance() {
        let spread = |z: f32| {
            let settings = SensorSettings { quantum_m: 1e-6, ..SensorSettings::default() };
            let noisy = sensed(&Image::filled(64, 48, z), &CAMERA, &settings, &mut Pcg64::seed_from_u64(1));
            (noisy.pixels().iter().map(|d| (d - z) * (d - z)).sum::<f32>() / noisy.pixels().len() as f32).sqrt()
        };
        assert!((spread(1.0) / 0.0012 - 1.0).abs() < 0.1);
        assert!((spread(2.0) / 0.0048 - 1.0).abs() < 0.1);
    }

    #[test]
    fn nothing_stays_nothing() {
        let noisy = sensed(&Image::filled(64, 48, 0.0), &CAMERA, &SensorSettings::default(), &mut Pcg64::seed_from_u64(1));
        assert!(noisy.pixels().iter().all(|d| *d == 0.0));
    }
}
