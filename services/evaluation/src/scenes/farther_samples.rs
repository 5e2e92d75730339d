//! How much farther than is believed the objects of training scenes go on at each of their ends, with what was measured of that: what
//! [`repose_belief::farther`] is fitted on.

use repose_belief::farther::{ENDS, MeasuredEnd, measured, outwards, reach_m};
use repose_belief::front::{Front, span};
use repose_belief::unseen_end::STEPS_M;
use repose_belief::{Belief, BeliefSettings};
use repose_geometry::Footprint;
use repose_planner::PreparedScene;
use repose_simulator::scene::SceneObject;
use serde::{Deserialize, Serialize};

use crate::scenes::believed::MIN_POINTS;
use crate::scenes::training_views::TrainingViews;
use crate::scenes::true_objects::true_corners;
use crate::statistics::forecast_fit::FitSample;

/// The first of the training scenes that are learned from: those of the middles of what may be missing are others.
pub const FIRST_SEED: u64 = 875_000_000;
/// How they are seen.
const VIEWS: TrainingViews =
    TrainingViews { stream: 0xfa_27e2, views: 3, sizes: &[[640, 480], [320, 240]], found_masks: Some(0.25), faults: None };

/// What was measured at an end of an object, and how much farther out it is than believed, metres; negative where it is nearer.
pub type EndSample = (MeasuredEnd, f32);

/// The objects of one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneEnds {
    /// The scene.
    pub seed: u64,
    /// Each object's ends in each view, in the order of [`measured`].
    pub objects: Vec<[EndSample; ENDS]>,
}

impl SceneEnds {
    /// The `index`-th scene that is learned from; kinds of scenes take turns. Empty where the seed gives no scene.
    pub fn of(index: u64) -> Self {
        let mut ends = Self { seed: FIRST_SEED + index, objects: Vec::new() };
        VIEWS.show(ends.seed, index, |truth, view| {
            let belief = &PreparedScene::new(std::sync::Arc::new(view.observed)).belief;
            ends.objects.extend(truth.objects.iter().filter_map(|object| of_object(belief, object)));
        });
        ends
    }

    /// Samples of the far ends or of all others, one for each step that is asked, to learn from.
    pub fn samples(&self, of_far_ends: bool) -> impl Iterator<Item = FitSample> + '_ {
        let ends = if of_far_ends { 0..1 } else { 1..ENDS };
        let asked =
            |(measured, farther_m): &EndSample, step_m: f32| FitSample { measures: measured.asked(step_m), came_true: *farther_m > step_m };
        self.objects
            .iter()
            .flat_map(move |object| object[ends.clone()].iter().flat_map(move |end| STEPS_M.map(|step_m| asked(end, step_m))))
    }
}

/// An object's ends with what was measured of them; none where too little was seen of it.
fn of_object(belief: &Belief, object: &SceneObject) -> Option<[EndSample; ENDS]> {
    let settings = BeliefSettings::default();
    let seen = belief.objects.get(&object.id).filter(|seen| seen.points.len() >= MIN_POINTS)?;
    let shape = seen.shape.as_ref()?;
    let front = Front::of(&seen.points, shape.bottom_m, &belief.view.eye().xy(), &settings.shape)?;
    let outline = Footprint::of(&true_corners(object))?;
    let farther_m = outwards(&front).map(|outwards| span(outline.corners(), &outwards)[1] - reach_m(shape, &outwards));
    let mut ends = measured(&front, shape, &belief.view, &settings).into_iter().zip(farther_m);
    Some(std::array::from_fn(|_| ends.next().expect("as many as there are ends")))
}
