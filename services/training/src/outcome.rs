//! Candidates of the outcome network: places where the simulator released the query. The label is 1 if it stayed as it was put, ½ if it moved
//! by less than the paper's 5 cm, 0 otherwise.

use candle_core::Result;
use rand::{RngExt, seq::IndexedRandom};
use rand_pcg::Pcg64;
use repose_networks::{
    Kernel, Networks, NetworksConfig,
    crops::Grouped,
    discriminator::Discriminator,
    points::{SceneCloud, turned},
    shared_scene::SharedScene,
};

use crate::{
    episode::{Episode, SimulatedRelease},
    placement::{Candidates, LabelledPlacement},
    settings::TrainedPart,
    views::TRIALS_AT_ONCE,
};

/// Places where the query was released.
#[derive(Debug, Clone, Copy, Default)]
pub struct ReleasedPlaces;

impl Candidates for ReleasedPlaces {
    const PART: TrainedPart = TrainedPart::Outcome;

    fn places(&self, episode: &Episode, rng: &mut Pcg64) -> Vec<LabelledPlacement> {
        let mut places: Vec<LabelledPlacement> = episode.trials.sample(rng, TRIALS_AT_ONCE).map(labelled).collect();
        // Where it rested it stays; no release is needed to know that.
        places.push(LabelledPlacement::settled(episode, rng));
        places
    }

    /// All candidates of an episode share the scene's points.
    fn input(&self, config: &NetworksConfig, episode: &Episode, places: &[LabelledPlacement], rng: &mut Pcg64) -> Grouped {
        let kernel = Kernel::detect();
        let turn_rad = rng.random_range(0.0..std::f32::consts::TAU);
        let scene = SceneCloud { points: turned(&episode.scene.points, turn_rad), labels: episode.scene.labels.clone() };
        let shared = SharedScene::new(kernel, config, &scene);
        let placed = |place: &LabelledPlacement| {
            let position = turned(&[place.position.into()], turn_rad)[0];
            shared.placed(kernel, config, &episode.query.turned(place.yaw_rad + turn_rad), position)
        };
        shared.grouped(&places.iter().map(placed).collect::<Vec<_>>())
    }

    fn network<'a>(&self, networks: &'a Networks) -> Result<&'a Discriminator> {
        match &networks.outcome {
            Some(outcome) => Ok(outcome),
            None => candle_core::bail!("the weights have no outcome network"),
        }
    }
}

fn labelled(trial: &SimulatedRelease) -> LabelledPlacement {
    LabelledPlacement {
        position: trial.position,
        yaw_rad: trial.yaw_rad,
        label: 0.5 * (f32::from(u8::from(trial.stayed)) + f32::from(u8::from(trial.as_put))),
        is_good: trial.stayed,
    }
}
