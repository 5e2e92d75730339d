//! The levels that objects of training scenes may end at, and which of them are right: what [`repose_belief::foot`] is fitted on, and what [`repose_belief::foot_picture`] is
//! trained on.

use repose_belief::foot_levels::{Level, RIGHT_M};
use repose_belief::foot_picture::DoubtfulFoot;
use repose_belief::{Belief, BeliefSettings, SeenScene};
use repose_simulator::scene::SceneObject;
use serde::{Deserialize, Serialize};

use crate::scenes::training_views::TrainingViews;
use crate::statistics::forecast_fit::FitSample;

/// The first of the training scenes that are learned from.
pub const FIRST_SEED: u64 = 950_000_000;
/// How they are seen.
const VIEWS: TrainingViews =
    TrainingViews { stream: 0xfee7, views: 2, sizes: &[[640, 480], [640, 480], [320, 240]], found_masks: Some(0.25), faults: None };

/// A level, and whether the object ends there.
pub type TrueLevel = (Vec<f32>, bool);

/// The objects of one scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneFeet {
    /// The scene.
    pub seed: u64,
    /// The levels of each object in each view, the rule's first.
    pub objects: Vec<Vec<TrueLevel>>,
}

impl SceneFeet {
    /// The `index`-th scene that is learned from; kinds of scenes take turns. A quarter of the views have masks that perception finds. Empty where the
    /// seed gives no scene.
    pub fn of(index: u64) -> Self {
        let mut feet = Self { seed: FIRST_SEED + index, objects: Vec::new() };
        VIEWS.show(feet.seed, index, |truth, view| {
            let seen = SeenScene::of(&view.observed, &view.world_from_camera);
            let Ok(levels) = Belief::foot_levels(&seen, &BeliefSettings::default()) else { return };
            // Of masks that match no object nothing is known.
            let known = truth.objects.iter().filter_map(|object| Some((bottom_m(object), levels.get(&object.id)?)));
            feet.objects.extend(
                known.map(|(bottom_m, levels)| levels.iter().map(|level| (level.measures.clone(), is_right(level, bottom_m))).collect()),
            );
        });
        feet
    }

    /// Levels, to learn from.
    pub fn samples(&self) -> Vec<FitSample> {
        let levels = self.objects.iter().flatten();
        levels.map(|(measures, right)| FitSample { measures: measures.clone(), came_true: *right }).collect()
    }
}

/// An object of whose foot the trees are in doubt, in one view.
#[derive(Debug, Clone, PartialEq)]
pub struct DoubtfulSample {
    /// What was seen of it, and its levels.
    pub foot: DoubtfulFoot,
    /// Which of these are right.
    pub right: Vec<bool>,
}

/// The objects of the scene of [`SceneFeet::of`] that the trees which come with the program are in doubt of.
pub fn doubtful_samples(index: u64) -> Vec<DoubtfulSample> {
    let mut samples = Vec::new();
    VIEWS.show(FIRST_SEED + index, index, |truth, view| {
        let seen = SeenScene::of(&view.observed, &view.world_from_camera);
        let Ok(mut feet) = Belief::doubtful_feet(&seen, &BeliefSettings::default()) else { return };
        let known = truth.objects.iter().filter_map(|object| Some((bottom_m(object), feet.remove(&object.id)?)));
        samples.extend(known.map(|(bottom_m, foot)| {
            let right = foot.levels.iter().map(|(level, _)| is_right(level, bottom_m)).collect();
            DoubtfulSample { foot, right }
        }));
    });
    samples
}

fn is_right(level: &Level, bottom_m: f64) -> bool {
    (f64::from(level.height_m) - bottom_m).abs() <= f64::from(RIGHT_M)
}

/// The true height of an object's bottom, world z, metres.
fn bottom_m(object: &SceneObject) -> f64 {
    object.world_from_object.translation.z - object.shape.depth_below_origin_m(&object.world_from_object)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rule_has_the_first_word_and_most_objects_end_at_a_level_that_is_tried() {
        let objects: Vec<Vec<TrueLevel>> = (0..9).flat_map(|index| SceneFeet::of(index).objects).collect();
        let first_is_the_rules =
            |levels: &Vec<TrueLevel>| levels.iter().enumerate().all(|(i, (measures, _))| (measures[0] == 1.0) == (i == 0));
        assert!(objects.len() > 20 && objects.iter().all(first_is_the_rules));
        let has_right = objects.iter().filter(|levels| levels.iter().any(|(_, right)| *right)).count();
        assert!(has_right as f64 >= 0.9 * objects.len() as f64, "{has_right} of {}", objects.len());
    }
}
