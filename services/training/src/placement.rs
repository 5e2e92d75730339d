//! Training of the scene discriminator (paper, section 2.1): settled placements against the same with the query moved.
//!
//! Negatives are the paper's: the query moved 2 to 15 cm in a random direction. Positives and negatives share scene and cloud, and both
//! clouds were moved in, so that nothing but the place tells them apart. Candidates are turned about z at random: what is stable does not
//! depend on where it is seen from.

use candle_core::{Device, Result, Tensor};
use nalgebra::{Point3, Vector3};
use rand::RngExt;
use rand_pcg::Pcg64;
use repose_networks::{
    Kernel, Networks, NetworksConfig,
    crops::{Grouped, discriminator_points},
    layers::Mode,
    networks::DISCRIMINATOR,
    points::turned,
    relation_predictor::binary_cross_entropy,
    set_abstraction::Path,
};

use crate::{episode::Episode, normal::gaussian, settings::Part, task::Task};

/// How candidates are made.
#[derive(Debug, Clone, Copy)]
pub struct PlacementTask {
    /// How far a negative is moved, metres: nearest and farthest.
    pub offset_m: [f32; 2],
    /// Standard deviation of the disturbance of a positive's position, metres: what calibration and cleaning leave.
    pub position_noise_m: f32,
}

impl Default for PlacementTask {
    fn default() -> Self {
        Self { offset_m: [0.02, 0.15], position_noise_m: 0.001 }
    }
}

impl PlacementTask {
    /// A candidate of an episode as network input.
    fn candidate(&self, config: &NetworksConfig, episode: &Episode, stable: bool, rng: &mut Pcg64) -> Grouped {
        let offset = if stable {
            Vector3::from_fn(|_, _| gaussian(rng) * self.position_noise_m)
        } else {
            direction(rng) * rng.random_range(self.offset_m[0]..=self.offset_m[1])
        };
        let position: Point3<f32> = episode.position + offset;
        let (points, is_query) = discriminator_points(config, &episode.scene, &episode.placed(), position.into());
        let points = turned(&points, rng.random_range(0.0..std::f32::consts::TAU));
        Grouped::new(Kernel::detect(), points, is_query, &config.discriminator_levels)
    }
}

/// A uniformly distributed direction.
fn direction(rng: &mut Pcg64) -> Vector3<f32> {
    let z: f32 = rng.random_range(-1.0..=1.0);
    let (sin, cos) = rng.random_range(0.0..std::f32::consts::TAU).sin_cos();
    let level = (1.0 - z * z).max(0.0).sqrt();
    Vector3::new(level * cos, level * sin, z)
}

impl Task for PlacementTask {
    fn part(&self) -> Part {
        Part::Discriminator
    }

    fn fits(&self, parameter: &str) -> bool {
        parameter.starts_with(DISCRIMINATOR)
    }

    fn loss(
        &self,
        networks: &Networks,
        config: &NetworksConfig,
        episodes: &[&Episode],
        samples: usize,
        mode: &Mode,
        rng: &mut Pcg64,
    ) -> Result<Tensor> {
        // A positive and a negative of one episode side by side: the pair differs in the place only.
        let first = rng.random_range(0..episodes.len());
        let labels: Vec<f32> = (0..samples).map(|i| f32::from(u8::from(i % 2 == 0))).collect();
        let candidates: Vec<Grouped> =
            (0..samples).map(|i| self.candidate(config, episodes[(first + i / 2) % episodes.len()], i % 2 == 0, rng)).collect();
        let logits = networks.discriminator.logits(&Grouped::concat(&candidates), mode, Path::Fused)?;
        binary_cross_entropy(&logits, &Tensor::from_vec(labels, samples, &Device::Cpu)?)
    }

    fn measure(&self, networks: &Networks, config: &NetworksConfig, episodes: &[Episode], rng: &mut Pcg64) -> Result<serde_json::Value> {
        let mut scores: [Vec<f32>; 2] = Default::default();
        let mut loss = 0.0;
        for episode in episodes {
            let pair = [true, false].map(|stable| self.candidate(config, episode, stable, rng));
            let logits = networks.discriminator.logits(&Grouped::concat(&pair), &Mode::Serving, Path::Fused)?;
            loss += f64::from(binary_cross_entropy(&logits, &Tensor::new(&[1.0f32, 0.0], &Device::Cpu)?)?.to_scalar::<f32>()?);
            let logits = logits.to_vec1::<f32>()?;
            scores[0].push(logits[0]);
            scores[1].push(logits[1]);
        }
        let n = episodes.len().max(1) as f64;
        let accepted = |s: &[f32]| s.iter().filter(|x| **x > 0.0).count() as f64 / n;
        Ok(serde_json::json!({
            "loss": loss / n,
            "auc": area_under_curve(&scores[0], &scores[1]),
            "accepted_stable": accepted(&scores[0]),
            "accepted_moved": accepted(&scores[1]),
            "episodes": episodes.len(),
        }))
    }
}

/// The probability that a positive scores above a negative; ties count half.
pub fn area_under_curve(positives: &[f32], negatives: &[f32]) -> f64 {
    let mut wins = 0.0;
    for p in positives {
        for n in negatives {
            wins += if p > n {
                1.0
            } else if p == n {
                0.5
            } else {
                0.0
            };
        }
    }
    wins / (positives.len() * negatives.len()).max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_under_the_curve_counts_ordered_pairs() {
        assert_eq!(area_under_curve(&[2.0, 3.0], &[1.0, 2.0]), 0.875);
        assert_eq!(area_under_curve(&[1.0], &[1.0]), 0.5);
    }
}
