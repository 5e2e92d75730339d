//! Joint training of encoders, relation predictor and prior (paper, section 2.1).
//!
//! An episode gives the query as it rests (for the relations: its centre relative to the anchor) and as it was observed (for the prior: its
//! centre zero, the target its offset and turn), one pair per anchor. Goals are a random non-empty part of what is true of the pair.

use candle_core::{Result, Tensor};
use rand::RngExt;
use rand_pcg::Pcg64;
use repose_networks::{
    GOAL_RELATIONS, Kernel, Networks, NetworksConfig, PREDICTED_RELATIONS,
    crops::{Grouped, object_input, scene_input},
    layers::Mode,
    pair_measures::{MeasuredCloud, PAIR_MEASURES, pair_measures},
    prior::MixtureTensors,
    relation_predictor::binary_cross_entropy,
    set_abstraction::Path,
};
use repose_relations::Confusion;

use crate::{
    episode::{Episode, EpisodeAnchor, EpisodeSettings},
    settings::TrainedPart,
    task::TrainingTask,
    views::QueryView,
};

/// How pairs and goals are drawn. The values are ours; no comparison is recorded.
#[derive(Debug, Clone, Copy)]
pub struct JointTask {
    /// Anchors of an episode that are used at once.
    pub anchors: usize,
    /// Chance that a relation that does not hold is said not to, in the prior's goal.
    pub negated: f64,
    /// Weight of the prior's negative log-likelihood beside the relations' cross-entropy.
    pub prior_weight: f64,
}

impl Default for JointTask {
    fn default() -> Self {
        Self { anchors: 3, negated: 0.15, prior_weight: 0.1 }
    }
}

/// A batch of pairs as tensors.
struct Pairs {
    logits: Tensor,
    labels: Tensor,
    mixture: MixtureTensors,
    offsets_m: Tensor,
    yaws_rad: Tensor,
}

impl JointTask {
    /// All chosen pairs through all networks.
    fn pairs(&self, networks: &Networks, config: &NetworksConfig, episodes: &[&Episode], mode: &Mode, rng: &mut Pcg64) -> Result<Pairs> {
        let kernel = Kernel::detect();
        let mut objects = Vec::new();
        let mut scenes = Vec::new();
        // Per pair: rows of `objects` (query at rest, query as observed, anchor), and the numbers that go with it.
        let (mut resting, mut observed, mut anchored) = (Vec::<u32>::new(), Vec::<u32>::new(), Vec::<u32>::new());
        let mut measures = Vec::new();
        let (mut centers, mut labels, mut goals, mut offsets, mut yaws) = (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for episode in episodes {
            let query = objects.len() as u32;
            let placed = episode.placed();
            let measured = MeasuredCloud::new(&placed);
            objects.push(object_input(kernel, config, &placed));
            objects.push(object_input(kernel, config, &episode.query));
            for anchor in chosen(&episode.anchors, self.anchors, rng) {
                resting.push(query);
                observed.push(query + 1);
                anchored.push(objects.len() as u32);
                objects.push(object_input(kernel, config, &anchor.cloud));
                scenes.push(scene_input(kernel, config, &episode.scene, anchor.cloud.centroid_in_viewer.into()));
                let offset: [f32; 3] = (episode.position - anchor.cloud.centroid_in_viewer).into();
                measures.extend(pair_measures(&measured, &MeasuredCloud::new(&anchor.cloud), offset));
                centers.extend(offset);
                offsets.extend(offset);
                yaws.push(episode.yaw_rad);
                labels.extend(anchor.relations[..PREDICTED_RELATIONS].iter().map(|holds| f32::from(u8::from(*holds))));
                goals.extend(self.goal(&anchor.relations, rng));
            }
        }
        let n = resting.len();
        let (device, path) = (&networks.device, Path::of(&networks.device));
        let tensor = |values: Vec<f32>, width: usize| Tensor::from_vec(values, (n, width), device);
        let shapes = networks.object.shapes(&Grouped::concat(&objects), mode, path)?;
        let rows = |list: Vec<u32>| shapes.index_select(&Tensor::from_vec(list, n, device)?, 0);
        let zero = Tensor::zeros((n, 3), shapes.dtype(), device)?;
        let anchors = networks.object.codes(&rows(anchored)?, &zero)?;
        let at_rest = networks.object.codes(&rows(resting)?, &tensor(centers, 3)?)?;
        let as_observed = networks.object.codes(&rows(observed)?, &zero)?;
        let scenes = networks.scene.forward(&Grouped::concat(&scenes), mode, path)?;
        Ok(Pairs {
            logits: networks.relations.logits(&at_rest, &anchors, &tensor(measures, PAIR_MEASURES)?)?,
            labels: tensor(labels, PREDICTED_RELATIONS)?,
            mixture: networks.prior.forward(&scenes, &as_observed, &anchors, &tensor(goals, GOAL_RELATIONS)?, mode)?,
            offsets_m: tensor(offsets, 3)?,
            yaws_rad: Tensor::from_vec(yaws, n, device)?,
        })
    }

    /// A random non-empty part of what is true: each true relation kept by a fair coin, each false one now and then negated.
    fn goal(&self, relations: &[bool; GOAL_RELATIONS], rng: &mut Pcg64) -> [f32; GOAL_RELATIONS] {
        let mut goal = [0.0; GOAL_RELATIONS];
        for (term, holds) in goal.iter_mut().zip(relations) {
            *term = match holds {
                true if rng.random_bool(0.5) => 1.0,
                false if rng.random_bool(self.negated) => -1.0,
                _ => 0.0,
            };
        }
        if goal.iter().all(|t| *t == 0.0) {
            let truths: Vec<usize> = (0..GOAL_RELATIONS).filter(|r| relations[*r]).collect();
            match truths[..] {
                [] => goal[rng.random_range(0..GOAL_RELATIONS)] = -1.0,
                _ => goal[truths[rng.random_range(0..truths.len())]] = 1.0,
            }
        }
        goal
    }
}

/// Up to `most` of the anchors, without repetition.
fn chosen<'a>(anchors: &'a [EpisodeAnchor], most: usize, rng: &mut Pcg64) -> Vec<&'a EpisodeAnchor> {
    let mut list: Vec<&EpisodeAnchor> = anchors.iter().collect();
    for i in 0..most.min(list.len()) {
        let other = rng.random_range(i..list.len());
        list.swap(i, other);
    }
    list.truncate(most);
    list
}

impl TrainingTask for JointTask {
    type Prepared = Episode;

    fn part(&self) -> TrainedPart {
        TrainedPart::Joint
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
        let first = rng.random_range(0..episodes.len());
        let drawn: Vec<&Episode> = (0..samples.min(episodes.len())).map(|i| episodes[(first + i) % episodes.len()]).collect();
        let pairs = self.pairs(networks, config, &drawn, mode, rng)?;
        let relations = binary_cross_entropy(&pairs.logits, &pairs.labels)?;
        let prior = pairs.mixture.negative_log_likelihood(&pairs.offsets_m, &pairs.yaws_rad)?;
        relations + (prior * self.prior_weight)?
    }

    fn measure(&self, networks: &Networks, config: &NetworksConfig, episodes: &[Episode], rng: &mut Pcg64) -> Result<serde_json::Value> {
        let (mut cross_entropy, mut likelihood) = (0.0, 0.0);
        let mut counts = [Confusion::default(); PREDICTED_RELATIONS];
        for episode in episodes {
            let pairs = self.pairs(networks, config, &[episode], &Mode::Serving, rng)?;
            cross_entropy += f64::from(binary_cross_entropy(&pairs.logits, &pairs.labels)?.to_scalar::<f32>()?);
            likelihood += f64::from(pairs.mixture.negative_log_likelihood(&pairs.offsets_m, &pairs.yaws_rad)?.to_scalar::<f32>()?);
            for (logits, labels) in pairs.logits.to_vec2::<f32>()?.iter().zip(pairs.labels.to_vec2::<f32>()?) {
                for (count, (logit, label)) in counts.iter_mut().zip(logits.iter().zip(labels)) {
                    count.count(*logit > 0.0, label > 0.5);
                }
            }
        }
        let n = episodes.len().max(1) as f64;
        Ok(serde_json::json!({
            "loss": cross_entropy / n + self.prior_weight * likelihood / n,
            "relation_cross_entropy": cross_entropy / n,
            "prior_negative_log_likelihood": likelihood / n,
            "f1": counts.iter().map(Confusion::f1).collect::<Vec<_>>(),
            "true_percent": counts.iter().map(Confusion::true_percent).collect::<Vec<_>>(),
            "episodes": episodes.len(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn a_goal_says_only_what_is_true_and_is_never_empty() {
        let mut rng = Pcg64::seed_from_u64(2);
        for mask in 0..1u32 << GOAL_RELATIONS {
            let relations: [bool; GOAL_RELATIONS] = std::array::from_fn(|r| mask >> r & 1 == 1);
            let goal = JointTask::default().goal(&relations, &mut rng);
            assert!(goal.iter().any(|t| *t != 0.0));
            assert!(goal.iter().zip(relations).all(|(t, holds)| *t == 0.0 || (*t > 0.0) == holds));
        }
    }
}
