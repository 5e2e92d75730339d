//! How far an object goes on behind what was seen of it, learned.
//!
//! Neither the back of a thing nor, at flat lines of sight, the far part of its top is seen: borders of masks are cleaned away, by a few pixels
//! that cover the more of a level face the flatter it is looked at. How much is missing depends on what the thing is, and what was seen of
//! it tells some of that: how deep it is at its top and below, how wide and how high, from where on the camera saw past it. Boosted trees say
//! the middle of what may be, fitted on objects of training scenes whose true shapes are known (`repose train --network back`). They come with
//! the program, in `weights/back.json`, like the rules of this room: a belief is the same wherever it is formed, also where no inference is
//! in reach.

use std::sync::LazyLock;

use nalgebra::{Point2, Point3, Vector2};
use repose_geometry::{Footprint, cloud};
use serde::{Deserialize, Serialize};

use crate::boosted_trees::{BoostedTrees, UnreadableTrees};
use crate::front::{Front, span};
use crate::settings::BeliefSettings;
use crate::shape::Hidden;
use crate::view::ObservedView;

/// The file that the trees come in.
pub(crate) static FILE: &str = include_str!("../weights/back.json");

/// The measures, in the order that the trees read: lengths in metres, shares from 0 to 1.
pub const MEASURES: [&str; 25] = [
    // Its height, how steeply it is looked at (a sine), how much a border is at its distance, and how much of its outline its top has.
    "height",
    "steepness",
    "border",
    "rim_share",
    // How deep and how wide it was seen.
    "depth",
    "width",
    // Of five bands of its height, from the bottom up: how far behind the middle it reaches, how far before it, and its share of the points.
    "far_0",
    "far_1",
    "far_2",
    "far_3",
    "far_4",
    "near_0",
    "near_1",
    "near_2",
    "near_3",
    "near_4",
    "share_0",
    "share_1",
    "share_2",
    "share_3",
    "share_4",
    // How far behind what was seen the first place is that the camera saw past, at the height of its top, half way up and near its bottom.
    "free_top",
    "free_middle",
    "free_bottom",
    // How far behind a place right behind it what hides that, or is seen past it, is.
    "behind",
];

/// Bands of the height, as shares of it: quarters, and the topmost tenth.
const BANDS: [[f32; 2]; 5] = [[0.0, 0.25], [0.25, 0.5], [0.5, 0.75], [0.75, 1.01], [0.9, 1.01]];
/// A band with fewer points says nothing.
const MIN_BAND: usize = 3;
/// Heights at which the first place is looked for that was seen to be free, as shares of the object's.
const FREE_AT: [f32; 3] = [1.0, 0.5, 0.1];
/// It is looked for in steps of this, metres …
const FREE_STEP_M: f32 = 0.004;
/// … and at most so many.
const FREE_STEPS: usize = 40;
/// What is behind an object is asked this far behind it, metres, …
const BEHIND_AT_M: f32 = 0.012;
/// … and told up to this, metres.
const BEHIND_M: f32 = 0.3;
/// Whether the camera looked past an object's sides is asked at this share of its height, …
const SIDE_AT: f32 = 0.5;
/// … in steps of this, metres.
const SIDE_STEP_M: f32 = 0.001;

/// The data that a far-side predictor was fitted on.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BackFitData {
    /// Training scenes.
    pub scenes: usize,
    /// Objects in them, each view counted.
    pub objects: usize,
}

/// How far objects go on behind what was seen of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Back {
    measures: Vec<String>,
    fitted_on: BackFitData,
    log_m: BoostedTrees,
}

impl Back {
    /// The one that comes with the program.
    pub fn own() -> &'static Self {
        static OWN: LazyLock<Back> = LazyLock::new(|| Back::read(FILE).expect("a test reads it"));
        &OWN
    }

    /// From trees for [`log_of_length`](crate::boosted_trees::log_of_length) on [`MEASURES`].
    ///
    /// # Errors
    /// When a branch leads nowhere or a value is not finite.
    pub fn new(log_m: BoostedTrees, fitted_on: BackFitData) -> Result<Self, UnreadableTrees> {
        Self { measures: MEASURES.map(str::to_owned).to_vec(), fitted_on, log_m }.checked()
    }

    /// Reads what [`Back`] was written as, in JSON.
    ///
    /// # Errors
    /// When it is none, or reads other measures.
    pub fn read(text: &str) -> Result<Self, UnreadableTrees> {
        serde_json::from_str::<Self>(text)?.checked()
    }

    fn checked(self) -> Result<Self, UnreadableTrees> {
        self.log_m.check_reads("log_m", &self.measures, &MEASURES)?;
        Ok(self)
    }

    /// The middle of what may be missing, metres, from measures.
    pub fn missing_m(&self, measures: &[f32]) -> f32 {
        self.log_m.length_m(measures)
    }

    /// What is not seen of an object.
    pub fn hidden(&self, front: &Front, view: &ObservedView, settings: &BeliefSettings) -> Hidden {
        let back_m = self.missing_m(&measures(front, view, settings));
        let side_m = side_m(front, view, settings);
        Hidden { back_m, side_m, doubt_m: settings.shape.doubt_m(back_m), ..Hidden::default() }
    }
}

/// What border cleaning takes off the side of an object, metres: as many pixels at its distance.
pub fn border_m(front: &Front, view: &ObservedView, settings: &BeliefSettings) -> f32 {
    view.border_m(&front.centroid.cast(), settings.border_px)
}

/// How far an object goes on to either side: what a border takes off, as far as the camera did not look past right beside it.
fn side_m(front: &Front, view: &ObservedView, settings: &BeliefSettings) -> f32 {
    // Nothing is looked for beyond the map.
    let border_m = border_m(front, view, settings).min(settings.reach_m);
    let middle_m = front.bottom_m + SIDE_AT * front.height_m();
    let beside = |outwards: Vector2<f32>| {
        let reach = |c: &&Point2<f32>| c.coords.dot(&outwards);
        let outermost = front.outline.corners().iter().max_by(|a, b| reach(a).total_cmp(&reach(b)))?;
        let is_free = |k: &usize| {
            let place = outermost + outwards * (*k as f32 * SIDE_STEP_M);
            view.is_free(&Point3::new(place.x, place.y, middle_m))
        };
        let steps = (border_m / SIDE_STEP_M) as usize;
        (0..=steps).find(is_free).map(|k| k as f32 * SIDE_STEP_M)
    };
    let [left_m, right_m] = [front.across, -front.across].map(|outwards| beside(outwards).unwrap_or(border_m));
    (left_m + right_m) / 2.0
}

/// How far an object is from the camera, metres.
pub fn distance_m(front: &Front, view: &ObservedView) -> f32 {
    (front.centroid.cast::<f32>() - view.eye()).norm().max(1e-3)
}

/// The measures of an object that was seen; all finite.
pub fn measures(front: &Front, view: &ObservedView, settings: &BeliefSettings) -> Vec<f32> {
    let [near_m, far_m] = front.span(&front.away);
    let [right_m, left_m] = front.span(&front.across);
    let middle = cloud::mean_of(front.points.iter().map(|p| [p.x, p.y]));
    let middle = middle.map_or(0.0, |[x, y]| Vector2::new(x, y).dot(&front.away));
    let bands = BANDS.map(|[low, high]| {
        let points = front.band(low, high);
        if points.len() < MIN_BAND {
            return [0.0; 3];
        }
        let [near_m, far_m] = span(&points, &front.away);
        [far_m - middle, middle - near_m, points.len() as f32 / front.points.len() as f32]
    });
    let behind = |further_m: f32, share: f32| {
        let place = Point2::from(front.away * (far_m + further_m) + front.across * ((left_m + right_m) / 2.0));
        Point3::new(place.x, place.y, front.bottom_m + share * front.height_m())
    };
    let free = FREE_AT.map(|share| {
        let is_free = |k: &usize| view.is_free(&behind(*k as f32 * FREE_STEP_M, share));
        (0..FREE_STEPS).find(is_free).unwrap_or(FREE_STEPS) as f32 * FREE_STEP_M
    });
    let seen_behind = view.reading(&behind(BEHIND_AT_M, 0.5)).map_or(BEHIND_M, |r| r.behind_m.clamp(-BEHIND_M, BEHIND_M));
    let steepness = (view.eye().z - front.top_m) / distance_m(front, view);
    let head = [front.height_m(), steepness, border_m(front, view, settings), rim_share(front, settings), far_m - near_m, left_m - right_m];
    let of_bands = (0..3).flat_map(|what| bands.map(|band| band[what]));
    head.into_iter().chain(of_bands).chain(free).chain([seen_behind]).collect()
}

/// How much of the outline the outline of the topmost part has.
fn rim_share(front: &Front, settings: &BeliefSettings) -> f32 {
    let low_m = front.top_m - settings.shape.rim_m.max(settings.shape.rim_share * front.height_m());
    Footprint::of(front.points.iter().filter(|p| p.z >= low_m)).map_or(0.0, |rim| rim.area() / front.outline.area().max(1e-9))
}

#[cfg(test)]
mod tests {
    use nalgebra::Translation3;
    use repose_made_scenes::{SceneBuilder, world_from_camera};

    use super::*;
    use crate::boosted_trees::{DecisionTree, log_of_length};

    #[test]
    fn what_comes_with_the_program_reads_these_measures() {
        assert!(Back::own().fitted_on.objects > 0);
        let text = serde_json::to_string(Back::own()).unwrap();
        assert_eq!(&Back::read(&text).unwrap(), Back::own());
        let other = text.replacen("\"height\"", "\"weight\"", 1);
        assert!(Back::read(&other).unwrap_err().to_string().contains("measures"));
    }

    #[test]
    fn trees_say_the_logarithm_of_what_is_missing() {
        let leaf = |value: f64| BoostedTrees { bias: value, trees: vec![DecisionTree { splits: Vec::new(), leaves: vec![0.0] }] };
        let back = Back::new(leaf(log_of_length(0.02)), BackFitData::default()).unwrap();
        assert!((back.missing_m(&[0.0; MEASURES.len()]) - 0.02).abs() < 1e-6);
        let nothing = Back::new(leaf(log_of_length(-0.01)), BackFitData::default()).unwrap();
        assert!(nothing.missing_m(&[0.0; MEASURES.len()]) < 1e-6);
        assert!(Back::new(leaf(f64::NAN), BackFitData::default()).is_err());
    }

    #[test]
    fn what_many_points_measure_is_the_same_far_from_the_origin() {
        let (scene, settings) = (SceneBuilder::table().scene(), BeliefSettings::default());
        // The front and the top of a box of 10 cm as a near camera sees it.
        let (front, top) = ((0..20_000).map(|i| (i % 200, 0, i / 200)), (0..40_000).map(|i| (i % 200, i / 200, 100)));
        let along = |k: i32| k as f32 * 0.0005 - 0.05;
        let of_box: Vec<Point3<f32>> = front.chain(top).map(|(x, y, z)| Point3::new(along(x), along(y), z as f32 * 0.001)).collect();
        let bands = |y_m: f32| {
            let moved: Vec<Point3<f32>> = of_box.iter().map(|p| Point3::new(p.x, p.y + y_m, p.z)).collect();
            let pose = Translation3::new(0.0, f64::from(y_m), 0.0) * world_from_camera();
            let view = ObservedView::new(&[], &[], &scene.meta.camera, &pose, settings.view_columns);
            let front = Front::of(&moved, 0.0, &view.eye().xy(), &settings.shape).unwrap();
            measures(&front, &view, &settings)[6..16].to_vec()
        };
        let (near, far) = (bands(0.0), bands(300.0));
        assert!(near.iter().zip(&far).all(|(near, far)| (near - far).abs() < 1e-3), "{near:?} {far:?}");
    }
}
