//! Which objects of training scenes bear which, with what is measured of each pair: what [`repose_belief::bearing`] is fitted on.

use std::sync::Arc;

use repose_belief::Belief;
use repose_planner::PreparedScene;
use repose_simulator::scene::SimulatedScene;
use serde::{Deserialize, Serialize};

use crate::scenes::loads::true_loads;
use crate::scenes::training_views::TrainingViews;
use crate::statistics::forecast_fit::FitSample;

/// The first of the training scenes that are learned from.
pub const FIRST_SEED: u64 = 900_000_000;
/// How they are seen.
const VIEWS: TrainingViews =
    TrainingViews { stream: 0xbea_2146, views: 3, sizes: &[[640, 480], [640, 480], [320, 240]], found_masks: Some(0.5), faults: None };

/// The pairs of one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneBearings {
    /// The scene.
    pub seed: u64,
    /// What was measured of each pair in each view, and whether the one bears the other.
    pub pairs: Vec<(Vec<f32>, bool)>,
}

impl SceneBearings {
    /// The `index`-th scene that is learned from; kinds of scenes take turns. Half of the views have masks that perception finds. Empty where the
    /// seed gives no scene.
    pub fn of(index: u64) -> Self {
        let mut bearings = Self { seed: FIRST_SEED + index, pairs: Vec::new() };
        VIEWS.show(bearings.seed, index, |truth, view| {
            bearings.pairs.extend(measured(&PreparedScene::new(Arc::new(view.observed)).belief, truth));
        });
        bearings
    }

    /// Pairs, to learn from.
    pub fn samples(&self) -> Vec<FitSample> {
        self.pairs.iter().map(|(measures, bears)| FitSample { measures: measures.clone(), came_true: *bears }).collect()
    }
}

/// The pairs of a scene's objects; of masks that match no object nothing is known.
fn measured(belief: &Belief, truth: &SimulatedScene) -> Vec<(Vec<f32>, bool)> {
    let loads = true_loads(truth);
    let is_known = |id: &u16| truth.objects.iter().any(|object| object.id == *id);
    let known = belief.bearings().iter().filter(|(pair, _)| pair.iter().all(is_known));
    let bears = |[carrier, load]: &[u16; 2]| loads.get(carrier).is_some_and(|loads| loads.contains(load));
    known.map(|(pair, measures)| (measures.clone(), bears(pair))).collect()
}
