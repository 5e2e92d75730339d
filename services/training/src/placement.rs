//! Training of the scene discriminator (paper, section 2.1) and of the outcome network (ours): the same layers, told apart
//! by what counts as good and by how points are sampled ([`repose_networks::crops`], [`repose_networks::shared_scene`]).
//!
//! The discriminator's positives are settled placements, its negatives the paper's: the query moved 2 to 15 cm in a random direction. The
//! outcome network's candidates are places where the simulator let the query go; they count one when it stayed as it was put, a half when
//! it moved by less than the paper's 5 cm, nothing otherwise. Good and bad candidates share scene and cloud, and all clouds were moved in, so
//! that nothing but the place tells them apart. Candidates are turned about z at random: what is stable does not depend on where it is seen
//! from.

use candle_core::{Device, Result, Tensor};
use nalgebra::{Point3, Vector3};
use rand::{RngExt, seq::IndexedRandom};
use rand_pcg::Pcg64;
use repose_networks::{
    Kernel, Networks, NetworksConfig,
    crops::{Grouped, discriminator_points},
    discriminator::Discriminator,
    layers::Mode,
    points::{SceneCloud, turned},
    relation_predictor::binary_cross_entropy,
    set_abstraction::Path,
    shared_scene::SharedScene,
};

use crate::{episode::Episode, normal::gaussian, settings::Part, task::Task, views::TRIALS_AT_ONCE};

/// A place for the query, and what it counts.
#[derive(Debug, Clone, Copy)]
struct Labelled {
    position: Point3<f32>,
    /// From how the query was observed, radians.
    yaw_rad: f32,
    label: f32,
    /// What the area under the curve tells apart.
    is_good: bool,
}

/// How candidates are made.
#[derive(Debug, Clone, Copy)]
pub struct PlacementTask {
    /// [`Part::Discriminator`] or [`Part::Outcome`].
    part: Part,
    /// How far a negative is moved, metres: nearest and farthest.
    pub offset_m: [f32; 2],
    /// Standard deviation of the disturbance of a positive's position, metres: what calibration and cleaning leave.
    pub position_noise_m: f32,
}

impl PlacementTask {
    /// The task for the discriminator or the outcome network.
    pub fn new(part: Part) -> Self {
        Self { part, offset_m: [0.02, 0.15], position_noise_m: 0.001 }
    }

    /// Places of an episode, good and bad.
    fn places(&self, episode: &Episode, rng: &mut Pcg64) -> Vec<Labelled> {
        if self.part == Part::Outcome {
            let let_go = episode.trials.iter().map(|trial| Labelled {
                position: trial.position,
                yaw_rad: trial.yaw_rad,
                label: 0.5 * (f32::from(u8::from(trial.stayed)) + f32::from(u8::from(trial.as_put))),
                is_good: trial.stayed,
            });
            // Where it rested it stays; nothing has to be let go to know that.
            let let_go: Vec<Labelled> = let_go.collect();
            let mut places: Vec<Labelled> = let_go.sample(rng, TRIALS_AT_ONCE).copied().collect();
            places.push(self.settled(episode, rng));
            return places;
        }
        let offset = direction(rng) * rng.random_range(self.offset_m[0]..=self.offset_m[1]);
        let moved = Labelled { position: episode.position + offset, yaw_rad: episode.yaw_rad, label: 0.0, is_good: false };
        vec![self.settled(episode, rng), moved]
    }

    /// Where the query rests, about.
    fn settled(&self, episode: &Episode, rng: &mut Pcg64) -> Labelled {
        let offset = Vector3::from_fn(|_, _| gaussian(rng) * self.position_noise_m);
        Labelled { position: episode.position + offset, yaw_rad: episode.yaw_rad, label: 1.0, is_good: true }
    }

    /// Places of one episode as network input.
    fn input(&self, config: &NetworksConfig, episode: &Episode, places: &[Labelled], rng: &mut Pcg64) -> Grouped {
        let kernel = Kernel::detect();
        if self.part == Part::Outcome {
            let turn_rad = rng.random_range(0.0..std::f32::consts::TAU);
            let scene = SceneCloud { points: turned(&episode.scene.points, turn_rad), labels: episode.scene.labels.clone() };
            let shared = SharedScene::new(kernel, config, &scene);
            let placed = |place: &Labelled| {
                let position = turned(&[place.position.into()], turn_rad)[0];
                shared.placed(kernel, config, &episode.query.turned(place.yaw_rad + turn_rad), position)
            };
            return shared.grouped(&places.iter().map(placed).collect::<Vec<_>>());
        }
        let crop = |place: &Labelled| {
            let query = episode.query.turned(place.yaw_rad);
            let (points, is_query) = discriminator_points(config, &episode.scene, &query, place.position.into());
            let points = turned(&points, rng.random_range(0.0..std::f32::consts::TAU));
            Grouped::new(kernel, points, is_query, &config.discriminator_levels)
        };
        Grouped::concat(&places.iter().map(crop).collect::<Vec<_>>())
    }

    /// The network that is fitted.
    fn network<'a>(&self, networks: &'a Networks) -> Result<&'a Discriminator> {
        match (self.part, &networks.outcome) {
            (Part::Outcome, Some(outcome)) => Ok(outcome),
            (Part::Outcome, None) => candle_core::bail!("the weights have no outcome network"),
            _ => Ok(&networks.discriminator),
        }
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
        self.part
    }

    fn fits(&self, parameter: &str) -> bool {
        self.part.fits(parameter)
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
        // Good and bad places of one episode side by side: they differ in the place only.
        let first = rng.random_range(0..episodes.len());
        let mut labels = Vec::with_capacity(samples + TRIALS_AT_ONCE);
        let mut candidates = Vec::new();
        for episode in episodes.iter().cycle().skip(first) {
            if labels.len() >= samples {
                break;
            }
            let places = self.places(episode, rng);
            labels.extend(places.iter().map(|place| place.label));
            candidates.push(self.input(config, episode, &places, rng));
        }
        let logits = self.network(networks)?.logits(&Grouped::concat(&candidates), mode, Path::Fused)?;
        binary_cross_entropy(&logits, &Tensor::new(labels, &Device::Cpu)?)
    }

    fn measure(&self, networks: &Networks, config: &NetworksConfig, episodes: &[Episode], rng: &mut Pcg64) -> Result<serde_json::Value> {
        let (mut good, mut bad) = (Vec::new(), Vec::new());
        let mut loss = 0.0;
        for episode in episodes {
            let places = self.places(episode, rng);
            let logits = self.network(networks)?.logits(&self.input(config, episode, &places, rng), &Mode::Serving, Path::Fused)?;
            let labels = Tensor::new(places.iter().map(|place| place.label).collect::<Vec<_>>(), &Device::Cpu)?;
            loss += f64::from(binary_cross_entropy(&logits, &labels)?.to_scalar::<f32>()?);
            for (place, logit) in places.iter().zip(logits.to_vec1::<f32>()?) {
                if place.is_good { good.push(logit) } else { bad.push(logit) }
            }
        }
        let accepted = |s: &[f32]| s.iter().filter(|x| **x > 0.0).count() as f64 / s.len().max(1) as f64;
        Ok(serde_json::json!({
            "loss": loss / episodes.len().max(1) as f64,
            "auc": area_under_curve(&good, &bad),
            "accepted_good": accepted(&good),
            "accepted_bad": accepted(&bad),
            "good": good.len(),
            "bad": bad.len(),
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
