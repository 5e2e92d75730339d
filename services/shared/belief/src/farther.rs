//! How likely an object goes on farther than is believed, at each of its ends, learned.
//!
//! [`crate::back`] and [`crate::cut`] say the middle of what may be missing. Most objects end near there, but a pan whose handle a box hides, a
//! mug that turns its handle away and a box of which the picture has a corner go on by a whole length more: who sets such a thing down beside
//! something presses it into that. Boosted trees say how likely an end is farther out than so many metres, from the measures of [`crate::back`] or
//! [`crate::cut`], how far the belief goes beyond what was seen, and those metres; fitted on objects of training scenes whose true shapes are known
//! (`repose train --network farther`). They come with the program, in `weights/farther.json`.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use nalgebra::Vector2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::boosted_trees::{BoostedTrees, UnreadableTrees};
use crate::cut::End;
use crate::front::{Front, span};
use crate::settings::BeliefSettings;
use crate::shape::Shape;
use crate::standing::ObservedGeometry;
use crate::unseen_end::{STEPS_M, UnseenEnd};
use crate::view::ObservedView;
use crate::{back, cut};

/// The file that the trees come in.
pub(crate) static FILE: &str = include_str!("../weights/farther.json");

/// Beside the measures of the end: how far its belief goes beyond what was seen, and how much farther is asked, metres.
const BESIDE: [&str; 2] = ["believed", "asked"];

/// The data that the trees were fitted on.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FartherFitData {
    /// Training scenes.
    pub scenes: usize,
    /// Objects in them, each view counted.
    pub objects: usize,
}

/// What was measured at an end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredEnd {
    /// The measures of [`crate::back`] of the far end, those of [`crate::cut`] of all others.
    pub measures: Vec<f32>,
    /// How far the belief goes beyond what was seen, metres.
    pub believed_m: f32,
}

impl MeasuredEnd {
    /// What the trees read when so many metres are asked.
    pub fn asked(&self, farther_m: f32) -> Vec<f32> {
        self.measures.iter().copied().chain([self.believed_m, farther_m]).collect()
    }
}

/// The ends of an object as they are asked: the far one first, then those of [`End::ALL`].
pub const ENDS: usize = 1 + End::ALL.len();

/// Where the ends of an object point to, seen from above, world axes.
pub fn outwards(front: &Front) -> [Vector2<f32>; ENDS] {
    let [near, left, right] = End::ALL.map(|end| end.outwards(front));
    [front.away, near, left, right]
}

/// What was measured at each end of an object; all finite.
pub fn measured(front: &Front, shape: &Shape, view: &ObservedView, settings: &BeliefSettings) -> [MeasuredEnd; ENDS] {
    let [near, left, right] = End::ALL.map(|end| cut::measures(end, front, view, settings));
    let measures = [back::measures(front, view, settings), near, left, right];
    let outwards = outwards(front);
    std::array::from_fn(|end| MeasuredEnd {
        measures: measures[end].clone(),
        believed_m: reach_m(shape, &outwards[end]) - front.span(&outwards[end])[1],
    })
}

/// How far a shape is believed to reach in a direction, seen from above, metres from the world's origin.
pub fn reach_m(shape: &Shape, outwards: &Vector2<f32>) -> f32 {
    shape.slabs.iter().map(|slab| span(slab.outline.corners(), outwards)[1]).fold(f32::NEG_INFINITY, f32::max)
}

/// How likely objects go on farther than is believed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Farther {
    back_measures: Vec<String>,
    cut_measures: Vec<String>,
    fitted_on: FartherFitData,
    far: BoostedTrees,
    others: BoostedTrees,
}

impl Farther {
    /// The one that comes with the program.
    pub fn own() -> &'static Self {
        static OWN: LazyLock<Farther> = LazyLock::new(|| Farther::read(FILE).expect("a test reads it"));
        &OWN
    }

    /// From trees for log-odds on what [`MeasuredEnd::asked`] says: of the far end, and of all others.
    ///
    /// # Errors
    /// When a branch leads nowhere or a value is not finite.
    pub fn new(far: BoostedTrees, others: BoostedTrees, fitted_on: FartherFitData) -> Result<Self, UnreadableTrees> {
        let [back_measures, cut_measures] = names().map(|names| names.into_iter().map(str::to_owned).collect());
        Self { back_measures, cut_measures, fitted_on, far, others }.checked()
    }

    /// Reads what [`Farther`] was written as, in JSON.
    ///
    /// # Errors
    /// When it is none, or reads other measures.
    pub fn read(text: &str) -> Result<Self, UnreadableTrees> {
        serde_json::from_str::<Self>(text)?.checked()
    }

    fn checked(self) -> Result<Self, UnreadableTrees> {
        let [of_back, of_cut] = names();
        self.far.check_reads("far", &self.back_measures, &of_back)?;
        self.others.check_reads("others", &self.cut_measures, &of_cut)?;
        Ok(self)
    }

    /// How likely an end, by its place in what [`measured`] says, is farther out than believed by more than each of [`STEPS_M`].
    pub fn chances(&self, end: usize, measured: &MeasuredEnd) -> [f32; STEPS_M.len()] {
        let trees = if end == 0 { &self.far } else { &self.others };
        let mut most = 1.0f32;
        // Who goes on by more goes on by less, too.
        STEPS_M.map(|step_m| {
            most = most.min(trees.probability(&measured.asked(step_m)) as f32);
            most
        })
    }

    /// The ends of an object with how likely each is farther out.
    pub fn ends(&self, front: &Front, shape: &Shape, view: &ObservedView, settings: &BeliefSettings) -> [UnseenEnd; ENDS] {
        let (outwards, measured) = (outwards(front), measured(front, shape, view, settings));
        std::array::from_fn(|end| UnseenEnd { outwards: outwards[end], chances: self.chances(end, &measured[end]) })
    }
}

/// Finds the ends of shapes that may be farther out.
pub(crate) fn find_ends(shapes: &mut BTreeMap<u16, Shape>, seen: &ObservedGeometry<'_>) {
    let eye = seen.view.eye().xy();
    shapes.par_iter_mut().for_each(|(id, shape)| {
        if let Some(front) = Front::of(&seen.clouds[id], shape.bottom_m, &eye, &seen.settings.shape) {
            shape.ends = Farther::own().ends(&front, shape, seen.view, seen.settings).into();
        }
    });
}

/// What the trees of the far end and those of the others read.
fn names() -> [Vec<&'static str>; 2] {
    [&back::MEASURES, &cut::MEASURES].map(|measures| measures.iter().copied().chain(BESIDE).collect())
}

#[cfg(test)]
mod tests {
    use repose_made_scenes::SceneBuilder;

    use super::*;
    use crate::boosted_trees::{Branch, DecisionTree, TreeSplit};
    use crate::tests::believed;

    #[test]
    fn what_comes_with_the_program_reads_these_measures() {
        assert!(Farther::own().fitted_on.objects > 0);
        let text = serde_json::to_string(Farther::own()).unwrap();
        assert_eq!(&Farther::read(&text).unwrap(), Farther::own());
        for (name, message) in [("\"asked\"", "measures"), ("\"bias\"", "unknown field")] {
            let other = text.replacen(name, "\"other\"", 1);
            assert!(Farther::read(&other).unwrap_err().to_string().contains(message), "{name}");
        }
    }

    #[test]
    fn what_something_hides_to_one_side_is_likelier_to_go_on_there_than_where_it_was_seen_to_end() {
        // A wall hides the left half of a bar from the camera at (0, −0.8, 0.7), another the right half of another.
        for side in [-1.0, 1.0] {
            let wall = SceneBuilder::table().object(0, [0.16 * side, -0.05], [0.2, 0.04, 0.25]);
            let belief = believed(&wall.object(1, [0.05 * side, 0.1], [0.3, 0.06, 0.08]).scene());
            let ends = &belief.objects[&1].shape.as_ref().expect("it has an extent").ends;
            let chance = |x: f32| ends.iter().find(|end| end.outwards.x * x > 0.9).expect("it has ends to both sides").chance(0.02);
            let (hidden, seen) = (chance(side as f32), chance(-side as f32));
            assert!(hidden > 2.0 * seen, "{hidden} where it is hidden, {seen} where it was seen to end: {ends:?}");
            assert!(ends.len() == ENDS && ends.iter().all(|end| end.outwards.norm() > 0.99), "{ends:?}");
        }
    }

    #[test]
    fn it_is_never_likelier_to_go_on_by_more_than_by_less() {
        // Trees that find 4 cm and more likely, and less not.
        let asked = back::MEASURES.len() + 1;
        let split = TreeSplit(asked as u8, 0.03, [Branch::Leaf(0), Branch::Leaf(1)]);
        let trees = BoostedTrees { bias: 0.0, trees: vec![DecisionTree { splits: vec![split], leaves: vec![-1.0, 1.0] }] };
        let farther = Farther::new(trees.clone(), trees, FartherFitData::default()).unwrap();
        let chances = farther.chances(0, &MeasuredEnd { measures: vec![0.0; back::MEASURES.len()], believed_m: 0.0 });
        assert!(chances.iter().all(|chance| (chance - 0.268_94).abs() < 1e-4), "{chances:?}");
    }
}
