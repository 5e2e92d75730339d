//! How far the objects of training scenes go on at their near ends and sides beyond what was seen of them, with what was measured of that: what
//! [`repose_belief::cut`] is fitted on.

use repose_belief::cut::{End, measures};
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
pub const FIRST_SEED: u64 = 850_000_000;
/// How they are seen.
const VIEWS: TrainingViews =
    TrainingViews { stream: 0xc07_c07, views: 3, sizes: &[[640, 480], [320, 240]], found_masks: None, faults: None };

/// What was measured at an end of an object, and how far it goes on there, metres.
pub type EndSample = (Vec<f32>, f32);

/// The objects of one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneCuts {
    /// The scene.
    pub seed: u64,
    /// Each object's ends in each view: near, left and right.
    pub objects: Vec<[EndSample; 3]>,
}

impl SceneCuts {
    /// The `index`-th scene that is learned from; kinds of scenes take turns. Empty where the seed gives no scene.
    pub fn of(index: u64) -> Self {
        let mut cuts = Self { seed: FIRST_SEED + index, objects: Vec::new() };
        VIEWS.show(cuts.seed, index, |truth, view| {
            let belief = &PreparedScene::new(std::sync::Arc::new(view.observed)).belief;
            cuts.objects.extend(truth.objects.iter().filter_map(|object| measured(belief, object)));
        });
        cuts
    }
}

/// An object's ends with what was measured of them; none where too little was seen of it.
fn measured(belief: &Belief, object: &SceneObject) -> Option<[EndSample; 3]> {
    let settings = BeliefSettings::default();
    let seen = belief.objects.get(&object.id).filter(|seen| seen.points.len() >= MIN_POINTS)?;
    let front = Front::of(&seen.points, seen.shape.as_ref()?.bottom_m, &belief.view.eye().xy(), &settings.shape)?;
    let outline = Footprint::of(&true_corners(object))?;
    Some(End::ALL.map(|end| {
        let outwards = end.outwards(&front);
        let missing_m = span(outline.corners(), &outwards)[1] - front.span(&outwards)[1];
        (measures(end, &front, &belief.view, &settings), missing_m)
    }))
}
