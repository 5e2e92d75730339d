//! What the trainings of the scene discriminator (paper, section 2.1) and of the outcome network (ours) share: a network of the same layers
//! scores places of an object against labels.
//!
//! They differ in what counts as good and in how points are sampled: [`crate::discriminator`], [`crate::outcome`]. Good and bad candidates
//! share scene and cloud, and all clouds were moved in, so that only the place tells them apart. Candidates are turned about z at random:
//! stability does not depend on the viewpoint.

use candle_core::{Result, Tensor};
use nalgebra::{Point3, Vector3};
use rand::RngExt;
use rand_pcg::Pcg64;
use repose_networks::{
    Networks, NetworksConfig, crops::Grouped, discriminator::Discriminator, layers::Mode, relation_predictor::binary_cross_entropy,
    set_abstraction::Path,
};

use crate::{
    episode::{Episode, EpisodeSettings},
    normal::gaussian,
    settings::TrainedPart,
    task::TrainingTask,
    views::{QueryView, TRIALS_AT_ONCE},
};

/// Standard deviation of the noise on a query's resting place, metres: about the error of calibration and cleaning.
const POSITION_NOISE_M: f32 = 0.001;

/// A placement of the query, and its label.
#[derive(Debug, Clone, Copy)]
pub struct LabelledPlacement {
    /// Where the query's observed centroid is put, viewer's axes, metres.
    pub position: Point3<f32>,
    /// From how the query was observed, radians.
    pub yaw_rad: f32,
    /// The target of the network, 0 to 1.
    pub label: f32,
    /// Whether it counts as a positive for the area under the curve.
    pub is_good: bool,
}

impl LabelledPlacement {
    /// The query's resting place, with noise.
    pub fn settled(episode: &Episode, rng: &mut Pcg64) -> Self {
        let offset = Vector3::from_fn(|_, _| gaussian(rng) * POSITION_NOISE_M);
        Self { position: episode.position + offset, yaw_rad: episode.yaw_rad, label: 1.0, is_good: true }
    }
}

/// How one network's candidates are made.
pub trait Candidates: Sync {
    /// Which training.
    const PART: TrainedPart;

    /// Places of an episode, good and bad: at least one, at most [`TRIALS_AT_ONCE`] + 1.
    fn places(&self, episode: &Episode, rng: &mut Pcg64) -> Vec<LabelledPlacement>;

    /// Places of one episode as network input.
    fn input(&self, config: &NetworksConfig, episode: &Episode, places: &[LabelledPlacement], rng: &mut Pcg64) -> Grouped;

    /// The network that is fitted.
    ///
    /// # Errors
    /// When the weights have none.
    fn network<'a>(&self, networks: &'a Networks) -> Result<&'a Discriminator>;
}

/// The training of a network on its candidates.
#[derive(Debug, Clone, Copy)]
pub struct PlacementTask<C>(pub C);

impl<C: Candidates> TrainingTask for PlacementTask<C> {
    type Prepared = Episode;

    fn part(&self) -> TrainedPart {
        C::PART
    }

    fn prepare(&self, _: &Networks, config: &NetworksConfig, drawn: &QueryView<'_>, rng: &mut Pcg64) -> Result<Option<Episode>> {
        Ok(Episode::new(drawn, &config.cloud, &EpisodeSettings::default(), rng))
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
            let places = self.0.places(episode, rng);
            labels.extend(places.iter().map(|place| place.label));
            candidates.push(self.0.input(config, episode, &places, rng));
        }
        let logits = self.0.network(networks)?.logits(&Grouped::concat(&candidates), mode, Path::of(&networks.device))?;
        binary_cross_entropy(&logits, &Tensor::new(labels, &networks.device)?)
    }

    fn measure(&self, networks: &Networks, config: &NetworksConfig, episodes: &[Episode], rng: &mut Pcg64) -> Result<serde_json::Value> {
        let (mut good, mut bad) = (Vec::new(), Vec::new());
        let mut loss = 0.0;
        for episode in episodes {
            let places = self.0.places(episode, rng);
            let input = self.0.input(config, episode, &places, rng);
            let logits = self.0.network(networks)?.logits(&input, &Mode::Serving, Path::of(&networks.device))?;
            let labels = Tensor::new(places.iter().map(|place| place.label).collect::<Vec<_>>(), &networks.device)?;
            loss += f64::from(binary_cross_entropy(&logits, &labels)?.to_scalar::<f32>()?);
            for (place, logit) in places.iter().zip(logits.to_vec1::<f32>()?) {
                if place.is_good { good.push(logit) } else { bad.push(logit) }
            }
        }
        Ok(serde_json::json!({
            "loss": loss / episodes.len().max(1) as f64,
            "auc": area_under_curve(&good, &bad),
            "accepted_good": accepted_share(&good),
            "accepted_bad": accepted_share(&bad),
            "good": good.len(),
            "bad": bad.len(),
            "episodes": episodes.len(),
        }))
    }
}

/// The share of places that a network accepts, by their logits. `None` of no places: no bad one accepted would look like a figure.
fn accepted_share(logits: &[f32]) -> Option<f64> {
    let accepted = logits.iter().filter(|logit| **logit > 0.0).count();
    (!logits.is_empty()).then(|| accepted as f64 / logits.len() as f64)
}

/// The probability that a positive scores above a negative; ties count half. `None` without both.
pub fn area_under_curve(positives: &[f32], negatives: &[f32]) -> Option<f64> {
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
    let pairs = positives.len() * negatives.len();
    (pairs > 0).then(|| wins / pairs as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_under_the_curve_counts_ordered_pairs() {
        assert_eq!(area_under_curve(&[2.0, 3.0], &[1.0, 2.0]), Some(0.875));
        assert_eq!(area_under_curve(&[1.0], &[1.0]), Some(0.5));
    }

    #[test]
    fn of_places_that_there_are_none_of_there_is_no_figure() {
        assert_eq!((accepted_share(&[0.2, -0.1]), accepted_share(&[])), (Some(0.5), None));
        let (none, one): ([f32; 0], [f32; 1]) = ([], [0.3]);
        assert_eq!(area_under_curve(&none, &one), None);
        assert_eq!(area_under_curve(&one, &none), None);
    }
}
