//! How far an object goes on where something nearer, or the picture's edge, cuts off what is seen of it, learned.
//!
//! [`crate::back`] says what is missing behind. To the left and right, and at the near end, an object ends where it was seen to end unless it
//! was cut off there: a pan behind a box, a can behind the front of a drawer, a bowl of which the picture has a sliver. Two forecasts say the
//! middle of what may be missing, one for the near end and one for either side, from what was seen of the object, where the camera saw past
//! it, and what hides the places beyond it; fitted on objects of training scenes whose true shapes are known (`repose train --network cut`).
//! Like [`crate::back`]'s they come with the program, in `weights/cut.json`.

use std::sync::LazyLock;

use nalgebra::{Point2, Point3, Vector2};
use serde::{Deserialize, Serialize};

use crate::back::{border_m, distance_m};
use crate::boosted_trees::{BoostedTrees, UnreadableTrees};
use crate::front::{Front, span};
use crate::settings::BeliefSettings;
use crate::shape::Hidden;
use crate::view::ObservedView;

/// The file that the trees come in.
pub(crate) static FILE: &str = include_str!("../weights/cut.json");

/// The measures of one end, in the order that the trees read: lengths in metres, shares from 0 to 1.
pub const MEASURES: [&str; 25] = [
    // The object's height, how steeply it is looked at (a sine), and how much a border is at its distance.
    "height",
    "steepness",
    "border",
    // How far it was seen to reach from this end to the other, and across that.
    "along",
    "over",
    // Of five bands of its height, from the bottom up: how far it reaches from the middle to this end, and its share of the points.
    "reach_0",
    "reach_1",
    "reach_2",
    "reach_3",
    "reach_4",
    "share_0",
    "share_1",
    "share_2",
    "share_3",
    "share_4",
    // Right beyond this end, over its height: the shares of places that the camera saw past, that something nearer hides, and of which it has
    // no reading; how much nearer what hides them is.
    "free",
    "hidden",
    "unread",
    "nearer",
    // How far beyond this end the first place is that the camera saw past, at three heights.
    "free_top",
    "free_middle",
    "free_bottom",
    // The same beyond the opposite end, half way up, and the shares of places right beyond it that are hidden and without a reading.
    "other_free",
    "other_hidden",
    "other_unread",
];

/// Bands of the height, as shares of it.
const BANDS: [[f32; 2]; 5] = [[0.0, 0.2], [0.2, 0.4], [0.4, 0.6], [0.6, 0.8], [0.8, 1.01]];
/// A band with fewer points says nothing.
const MIN_BAND: usize = 3;
/// Heights at which the first place is looked for that was seen to be free, as shares of the object's.
const FREE_AT: [f32; 3] = [0.9, 0.5, 0.1];
/// It is looked for in steps of this, metres …
const FREE_STEP_M: f32 = 0.008;
/// … and at most so many.
const FREE_STEPS: usize = 30;
/// Places right beyond an end are so far beyond the border that cleaning takes off, metres.
const BEYOND_M: f32 = 0.006;
/// What is nearer than a place by less hides nothing, metres.
const NEARER_M: f32 = 0.01;
/// What hides a place is told up to this, metres.
const NEARER_MOST_M: f32 = 0.4;
/// Noise lets an end reach farther than it does by so much as is missing where nothing cuts it off, metres.
const NOISE_M: f32 = 0.0015;

/// The data that the forecasts were fitted on.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CutFitData {
    /// Training scenes.
    pub scenes: usize,
    /// Objects in them, each view counted.
    pub objects: usize,
}

/// An end of an object, seen from above.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// Towards the camera.
    Near,
    /// To the left as the camera looks.
    Left,
    /// To the right.
    Right,
}

impl End {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Near, Self::Left, Self::Right];

    /// Where it points to, world axes seen from above.
    pub fn outwards(self, front: &Front) -> Vector2<f32> {
        match self {
            Self::Near => -front.away,
            Self::Left => front.across,
            Self::Right => -front.across,
        }
    }
}

/// How far objects go on where they are cut off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cut {
    measures: Vec<String>,
    fitted_on: CutFitData,
    near: BoostedTrees,
    side: BoostedTrees,
}

impl Cut {
    /// The one that comes with the program.
    pub fn own() -> &'static Self {
        static OWN: LazyLock<Cut> = LazyLock::new(|| Cut::read(FILE).expect("a test reads it"));
        &OWN
    }

    /// From trees for [`log_of_length`](crate::boosted_trees::log_of_length) on [`MEASURES`], of the near end and of a side.
    ///
    /// # Errors
    /// When a branch leads nowhere or a value is not finite.
    pub fn new(near: BoostedTrees, side: BoostedTrees, fitted_on: CutFitData) -> Result<Self, UnreadableTrees> {
        Self { measures: MEASURES.map(str::to_owned).to_vec(), fitted_on, near, side }.checked()
    }

    /// Reads what [`Cut`] was written as, in JSON.
    ///
    /// # Errors
    /// When it is none, or reads other measures.
    pub fn read(text: &str) -> Result<Self, UnreadableTrees> {
        serde_json::from_str::<Self>(text)?.checked()
    }

    fn checked(self) -> Result<Self, UnreadableTrees> {
        self.near.check_reads("near", &self.measures, &MEASURES)?;
        self.side.check_reads("side", &self.measures, &MEASURES)?;
        Ok(self)
    }

    /// The middle of what may be missing at an end, metres, from its measures.
    pub fn missing_m(&self, end: End, measures: &[f32]) -> f32 {
        let trees = if end == End::Near { &self.near } else { &self.side };
        trees.length_m(measures)
    }

    /// What is not seen of an object, `hidden`, with what is cut off of it.
    pub fn added_to(&self, hidden: Hidden, front: &Front, view: &ObservedView, settings: &BeliefSettings) -> Hidden {
        let missing_m = |end| (self.missing_m(end, &measures(end, front, view, settings)) - NOISE_M).max(0.0);
        // What a border takes off is counted to both sides.
        let beside_m = |end| (missing_m(end) - hidden.side_m).max(0.0);
        Hidden { near_m: missing_m(End::Near), left_m: beside_m(End::Left), right_m: beside_m(End::Right), ..hidden }
    }
}

/// What the camera says of the places right beyond an end.
#[derive(Debug, Clone, Copy, Default)]
struct Beyond {
    free: f32,
    hidden: f32,
    unread: f32,
    nearer_m: f32,
}

/// An object's end that is looked at.
struct Looked<'a> {
    front: &'a Front,
    view: &'a ObservedView,
    outwards: Vector2<f32>,
    /// How far out it was seen to reach, and in the middle of that.
    reach_m: f32,
    middle: Point2<f32>,
    border_m: f32,
}

impl<'a> Looked<'a> {
    fn new(outwards: Vector2<f32>, border_m: f32, front: &'a Front, view: &'a ObservedView) -> Self {
        let along = Vector2::new(-outwards.y, outwards.x);
        let ([_, reach_m], [low_m, high_m]) = (front.span(&outwards), front.span(&along));
        let middle = Point2::from(along * ((low_m + high_m) / 2.0));
        Self { front, view, outwards, reach_m, middle, border_m }
    }

    fn place(&self, beyond_m: f32, share: f32) -> Point3<f32> {
        let place = self.middle + self.outwards * (self.reach_m + beyond_m);
        Point3::new(place.x, place.y, self.front.bottom_m + share * self.front.height_m())
    }

    fn first_free_m(&self, share: f32) -> f32 {
        let is_free = |k: &usize| self.view.is_free(&self.place(*k as f32 * FREE_STEP_M, share));
        (0..FREE_STEPS).find(is_free).unwrap_or(FREE_STEPS) as f32 * FREE_STEP_M
    }

    fn beyond(&self) -> Beyond {
        let mut beyond = Beyond::default();
        let each = 1.0 / BANDS.len() as f32;
        for [low, high] in BANDS {
            let place = self.place(self.border_m + BEYOND_M, (low + high) / 2.0);
            match self.view.reading(&place) {
                None => beyond.unread += each,
                Some(reading) if reading.behind_m < -NEARER_M => {
                    beyond.hidden += each;
                    beyond.nearer_m = beyond.nearer_m.max(-reading.behind_m).min(NEARER_MOST_M);
                }
                Some(_) => beyond.free += each * f32::from(u8::from(self.view.is_free(&place))),
            }
        }
        beyond
    }
}

/// The measures of an end of an object that was seen; all finite.
pub fn measures(end: End, front: &Front, view: &ObservedView, settings: &BeliefSettings) -> Vec<f32> {
    let outwards = end.outwards(front);
    let ([low_m, high_m], [from_m, to_m]) = (front.span(&outwards), front.span(&Vector2::new(-outwards.y, outwards.x)));
    let middle_m = (low_m + high_m) / 2.0;
    let border_m = border_m(front, view, settings);
    let bands = BANDS.map(|[low, high]| {
        let points = front.band(low, high);
        if points.len() < MIN_BAND {
            [0.0; 2]
        } else {
            [span(&points, &outwards)[1] - middle_m, points.len() as f32 / front.points.len() as f32]
        }
    });
    let steepness = (view.eye().z - front.top_m) / distance_m(front, view);
    let (here, there) = (Looked::new(outwards, border_m, front, view), Looked::new(-outwards, border_m, front, view));
    let (beyond, opposite) = (here.beyond(), there.beyond());
    let head = [front.height_m(), steepness, border_m, high_m - low_m, to_m - from_m];
    head.into_iter()
        .chain((0..2).flat_map(|what| bands.map(|band| band[what])))
        .chain([beyond.free, beyond.hidden, beyond.unread, beyond.nearer_m])
        .chain(FREE_AT.map(|share| here.first_free_m(share)))
        .chain([there.first_free_m(0.5), opposite.hidden, opposite.unread])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boosted_trees::{DecisionTree, log_of_length};

    #[test]
    fn what_comes_with_the_program_reads_these_measures() {
        assert!(Cut::own().fitted_on.objects > 0);
        let text = serde_json::to_string(Cut::own()).unwrap();
        assert_eq!(&Cut::read(&text).unwrap(), Cut::own());
        let other = text.replacen("\"height\"", "\"weight\"", 1);
        assert!(Cut::read(&other).unwrap_err().to_string().contains("measures"));
    }

    #[test]
    fn each_end_has_its_own_trees() {
        let leaf = |value: f64| BoostedTrees { bias: value, trees: vec![DecisionTree { splits: Vec::new(), leaves: vec![0.0] }] };
        let cut = Cut::new(leaf(log_of_length(0.05)), leaf(log_of_length(-0.01)), CutFitData::default()).unwrap();
        let missing_m = End::ALL.map(|end| cut.missing_m(end, &[0.0; MEASURES.len()]));
        assert!((missing_m[0] - 0.05).abs() < 1e-6 && missing_m[1] < 1e-6 && missing_m[2] < 1e-6, "{missing_m:?}");
    }
}
