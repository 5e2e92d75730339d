//! Candidates of the scene discriminator: settled placements are good, the same moved 2 to 15 cm in a random direction are bad (paper, section 2.1).

use candle_core::Result;
use nalgebra::Vector3;
use rand::RngExt;
use rand_pcg::Pcg64;
use repose_networks::{
    Kernel, Networks, NetworksConfig,
    crops::{Grouped, discriminator_points},
    discriminator::Discriminator,
    points::turned,
};

use crate::{
    episode::Episode,
    placement::{Candidates, LabelledPlacement},
    settings::TrainedPart,
};

/// The paper's candidates.
#[derive(Debug, Clone, Copy)]
pub struct MovedPlaces {
    /// How far a bad one is moved, metres: nearest and farthest.
    pub offset_m: [f32; 2],
}

impl Default for MovedPlaces {
    fn default() -> Self {
        Self { offset_m: [0.02, 0.15] }
    }
}

impl Candidates for MovedPlaces {
    const PART: TrainedPart = TrainedPart::Discriminator;

    fn places(&self, episode: &Episode, rng: &mut Pcg64) -> Vec<LabelledPlacement> {
        let offset = direction(rng) * rng.random_range(self.offset_m[0]..=self.offset_m[1]);
        let moved = LabelledPlacement { position: episode.position + offset, yaw_rad: episode.yaw_rad, label: 0.0, is_good: false };
        vec![LabelledPlacement::settled(episode, rng), moved]
    }

    /// Every candidate has points of its own (paper).
    fn input(&self, config: &NetworksConfig, episode: &Episode, places: &[LabelledPlacement], rng: &mut Pcg64) -> Grouped {
        let kernel = Kernel::detect();
        let crop = |place: &LabelledPlacement| {
            let query = episode.query.turned(place.yaw_rad);
            let (points, is_query) = discriminator_points(config, &episode.scene, &query, place.position.into());
            let points = turned(&points, rng.random_range(0.0..std::f32::consts::TAU));
            Grouped::new(kernel, points, is_query, &config.discriminator_levels)
        };
        Grouped::concat(&places.iter().map(crop).collect::<Vec<_>>())
    }

    fn network<'a>(&self, networks: &'a Networks) -> Result<&'a Discriminator> {
        Ok(&networks.discriminator)
    }
}

/// A uniformly distributed direction.
fn direction(rng: &mut Pcg64) -> Vector3<f32> {
    let z: f32 = rng.random_range(-1.0..=1.0);
    let (sin, cos) = rng.random_range(0.0..std::f32::consts::TAU).sin_cos();
    let level = (1.0 - z * z).max(0.0).sqrt();
    Vector3::new(level * cos, level * sin, z)
}
