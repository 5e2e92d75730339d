//! How far the objects of training scenes go on behind what was seen of them, with what was measured of that: what
//! [`repose_belief::back`] is fitted on.

use repose_belief::back::measures;
use repose_belief::front::{Front, span};
use repose_belief::{Belief, BeliefSettings};
use repose_geometry::Footprint;
use repose_planner::PreparedScene;
use repose_simulator::scene::SceneObject;
use serde::{Deserialize, Serialize};

use crate::scenes::believed::MIN_POINTS;
use crate::scenes::training_views::TrainingViews;
use crate::scenes::true_objects::true_corners;

/// The first of the training scenes that are learned from.
pub const FIRST_SEED: u64 = 800_000_000;
/// How they are seen.
const VIEWS: TrainingViews =
    TrainingViews { stream: 0xbac_cbac, views: 3, sizes: &[[640, 480], [320, 240]], found_masks: None, faults: None };

/// The objects of one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneBacks {
    /// The scene.
    pub seed: u64,
    /// What was measured of each object in each view, and how far it goes on, metres.
    pub objects: Vec<(Vec<f32>, f32)>,
}

impl SceneBacks {
    /// The `index`-th scene that is learned from; kinds of scenes take turns. Empty where the seed gives no scene.
    pub fn of(index: u64) -> Self {
        let mut backs = Self { seed: FIRST_SEED + index, objects: Vec::new() };
        VIEWS.show(backs.seed, index, |truth, view| {
            let belief = &PreparedScene::new(std::sync::Arc::new(view.observed)).belief;
            backs.objects.extend(truth.objects.iter().filter_map(|object| measured(belief, object)));
        });
        backs
    }
}

/// An object with what was measured of it; none where too little was seen of it.
fn measured(belief: &Belief, object: &SceneObject) -> Option<(Vec<f32>, f32)> {
    let settings = BeliefSettings::default();
    let seen = belief.objects.get(&object.id).filter(|seen| seen.points.len() >= MIN_POINTS)?;
    let front = Front::of(&seen.points, seen.shape.as_ref()?.bottom_m, &belief.view.eye().xy(), &settings.shape)?;
    let [_, true_m] = span(Footprint::of(&true_corners(object))?.corners(), &front.away);
    let [_, seen_m] = front.span(&front.away);
    Some((measures(&front, &belief.view, &settings), true_m - seen_m))
}
