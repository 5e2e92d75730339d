//! Which object bears which, learned: what lies on a thing that it covers, lies over two things, or shows its foot to nobody.
//!
//! The rule of [`crate::standing`] asks how much of an object's base is over another's top. That is silent about a load over two things, and about
//! one that covers all of the top that it lies on. What tells those is the picture, too: where the load's lower edge meets what is under it, how
//! much of the carrier's upper edge ends at the load, and whether the load is seen to stand on anything else. Boosted trees say how likely the one
//! bears the other, fitted on pairs of objects of training scenes in which that is known (`repose train --network bearing`). They come with the
//! program, in `weights/bearing.json`, like those for backs ([`crate::back`]).

use std::collections::BTreeMap;
use std::sync::LazyLock;

use nalgebra::{Point2, Vector2};
use repose_geometry::{Footprint, cloud};
use serde::{Deserialize, Serialize};

use crate::boosted_trees::{BoostedTrees, UnreadableTrees};
use crate::columns::cells_of;
use crate::meeting::{Edges, Meeting};
use crate::outlines::{are_clearly_apart, outline_gap_m};
use crate::shape::Shape;
use crate::standing::{ObservedGeometry, is_on, nth};

/// The file that the trees come in.
pub(crate) static FILE: &str = include_str!("../weights/bearing.json");

/// The measures of a load and a carrier, in the order that the trees read: lengths in metres, shares from 0 to 1, flags 0 or 1.
pub const MEASURES: [&str; 34] = [
    // By their believed shapes: the share of the load's base that is over the carrier's top, and over that of another object; the share of the
    // carrier's top that is under the base, and whether that is enough for the rule; how far the load's axis is inside of that top.
    "base_over",
    "base_over_another",
    "top_under",
    "rule",
    "axis_inside",
    // Heights: the load's bottom over the carrier's top and bottom, its top over the carrier's; the same of its lowest points that were seen.
    "bottom_over_top",
    "bottom_over_bottom",
    "top_over_top",
    "seen_over_top",
    "seen_over_bottom",
    // How far the load's bottom is from the nearest furniture under its axis, and its lowest points.
    "bottom_off_floor",
    "seen_off_floor",
    // Sizes: heights and areas of the base and the top.
    "load_height",
    "carrier_height",
    "base_area",
    "top_area",
    // The load's lower edge in the picture: the shares that end at the carrier, touch it, touch it closely, touch it where its top is believed to
    // be, and touch furniture or other objects; how far the touching places spread.
    "meets",
    "touches",
    "touches_closely",
    "touches_inside",
    "touches_floor",
    "touches_others",
    "spread",
    // The shares that end at something clearly nearer, which hides the load's foot, and at something clearly farther, over which it hangs; the same
    // where that is the carrier.
    "hidden",
    "hangs",
    "hidden_by_carrier",
    "hangs_before_carrier",
    // The share of its edges to the left and right beside which the carrier goes on below it, and how far below.
    "beside",
    "beside_drop",
    // Where it touches the carrier, over the carrier's highest points and the load's lowest ones; where it touches others, likewise.
    "touch_over_top",
    "touch_over_lowest",
    "others_over_top",
    "others_over_lowest",
    // The share of the carrier's upper edge in the picture that touches the load.
    "roofed",
];

/// Lengths are cut here, metres.
const FAR_M: f32 = 0.25;
/// Pairs whose outlines are farther apart, seen from above, are not looked at, metres.
const APART_M: f32 = 0.02;
/// A touch is close up to here, metres.
const CLOSE_M: f32 = 0.012;
/// What is beyond an edge is clearly nearer or farther from here on, metres.
const CLEARLY_M: f32 = 0.03;
/// A touch is inside of a top up to this far beyond its edge, metres.
const INSIDE_M: f32 = 0.003;
/// What has fewer points neither bears nor is borne by this measure: it is too small to be told from a fragment.
const MIN_POINTS: usize = 50;

/// The data that it was fitted on.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BearingFitData {
    /// Training scenes.
    pub scenes: usize,
    /// Pairs of objects in them, each view counted.
    pub pairs: usize,
    /// Of those, pairs of which one bears the other.
    pub borne: usize,
}

/// How likely one object bears another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bearing {
    measures: Vec<String>,
    fitted_on: BearingFitData,
    log_odds: BoostedTrees,
}

impl Bearing {
    /// The one that comes with the program.
    pub fn own() -> &'static Self {
        static OWN: LazyLock<Bearing> = LazyLock::new(|| Bearing::read(FILE).expect("a test reads it"));
        &OWN
    }

    /// From trees for the logarithm of the odds, on [`MEASURES`].
    ///
    /// # Errors
    /// When a branch leads nowhere or a value is not finite.
    pub fn new(log_odds: BoostedTrees, fitted_on: BearingFitData) -> Result<Self, UnreadableTrees> {
        Self { measures: MEASURES.map(str::to_owned).to_vec(), fitted_on, log_odds }.checked()
    }

    /// Reads what [`Bearing`] was written as, in JSON.
    ///
    /// # Errors
    /// When it is none, or reads other measures.
    pub fn read(text: &str) -> Result<Self, UnreadableTrees> {
        serde_json::from_str::<Self>(text)?.checked()
    }

    fn checked(self) -> Result<Self, UnreadableTrees> {
        self.log_odds.check_reads("log_odds", &self.measures, &MEASURES)?;
        Ok(self)
    }

    /// How likely the one bears the other, from the measures of both.
    pub fn probability(&self, measures: &[f32]) -> f64 {
        self.log_odds.probability(measures)
    }
}

/// A carrier and a load that may lie on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// The carrier.
    pub carrier: u16,
    /// The load.
    pub load: u16,
    /// In the order of [`MEASURES`], all finite.
    pub measures: Vec<f32>,
}

/// All pairs of a scene of which one may bear the other.
pub fn candidates(seen: &ObservedGeometry<'_>, shapes: &BTreeMap<u16, Shape>) -> Vec<Candidate> {
    let none = Edges::default();
    let of = |id: &u16, shape| {
        let points = seen.clouds.get(id).filter(|points| points.len() >= MIN_POINTS)?;
        let heights = |sign: f32| nth(points.iter().map(|p| sign * p.z).collect(), points.len() / 50);
        Some(Seen { id: *id, shape, lowest_m: heights(1.0)?, highest_m: -heights(-1.0)?, edges: seen.edges.get(id).unwrap_or(&none) })
    };
    let objects: Vec<Seen<'_>> = shapes.iter().filter_map(|(id, shape)| of(id, shape)).collect();
    let pairs = objects.iter().flat_map(|carrier| objects.iter().map(move |load| Pair { carrier, load, seen }));
    let near: Vec<Pair<'_>> = pairs.filter(|pair| pair.carrier.id != pair.load.id && pair.is_near()).collect();
    let over: BTreeMap<[u16; 2], f32> = near.iter().map(|pair| ([pair.load.id, pair.carrier.id], pair.base_over())).collect();
    let candidate = |pair: &Pair<'_>| {
        let [carrier, load] = [pair.carrier.id, pair.load.id];
        let another = over.range([load, 0]..=[load, u16::MAX]).filter(|([_, other], _)| *other != carrier).map(|(_, share)| *share);
        let shares = [over[&[load, carrier]], another.fold(0.0, f32::max)];
        Candidate { carrier, load, measures: pair.measures(shares) }
    };
    near.iter().map(candidate).collect()
}

/// What was seen of an object, and what is believed of it.
struct Seen<'a> {
    id: u16,
    shape: &'a Shape,
    /// The heights that all but a fiftieth of its points are above, and below, metres.
    lowest_m: f32,
    highest_m: f32,
    edges: &'a Edges,
}

/// A carrier and a load.
struct Pair<'a> {
    carrier: &'a Seen<'a>,
    load: &'a Seen<'a>,
    seen: &'a ObservedGeometry<'a>,
}

impl Pair<'_> {
    /// Whether they are above each other or next to each other, and the load is not all below the carrier.
    fn is_near(&self) -> bool {
        let (carrier, load) = (self.carrier.shape, self.load.shape);
        let mut outlines = carrier.slabs.iter().flat_map(|below| load.slabs.iter().map(move |above| (below, above)));
        let is_near = |below: &Footprint, above: &Footprint| {
            !are_clearly_apart(below, above, APART_M) && outline_gap_m(below.corners(), above.corners()) <= APART_M
        };
        load.top_m > carrier.bottom_m && outlines.any(|(below, above)| is_near(&below.outline, &above.outline))
    }

    fn top(&self) -> &Footprint {
        self.carrier.shape.slabs.last().map_or(&self.carrier.shape.base, |slab| &slab.outline)
    }

    /// The share of the load's base that is over the carrier's top.
    fn base_over(&self) -> f32 {
        self.covered(&self.load.shape.base, self.top())
    }

    /// With the shares of the load's base that are over the carrier's top and over another's.
    fn measures(&self, [base_over, base_over_another]: [f32; 2]) -> Vec<f32> {
        let (carrier, load, top) = (self.carrier.shape, self.load.shape, self.top());
        let settings = &self.seen.settings.meeting;
        let (touching, elsewhere): (Vec<&Meeting>, Vec<&Meeting>) =
            self.load.edges.lower.iter().filter(|m| m.is_contact(settings)).partition(|m| m.object == self.carrier.id);
        let share = |count: usize| count as f32 / self.load.edges.lower.len().max(1) as f32;
        let count = |keep: &dyn Fn(&&Meeting) -> bool| share(touching.iter().copied().filter(|m| keep(m)).count());
        let eye = self.seen.view.eye();
        let behind_m = |m: &Meeting| (m.beyond - eye).norm() - (m.own - eye).norm();
        let ends = |keep: &dyn Fn(&Meeting, f32) -> bool| share(self.load.edges.lower.iter().filter(|m| keep(m, behind_m(m))).count());
        let floor_m = self.floor_m();
        let height = |places: &[&Meeting], at: f32| nth(places.iter().map(|m| m.own.z).collect(), (places.len() as f32 * at) as usize);
        let (touch_m, others_m) = (height(&touching, 0.5), height(&elsewhere, 0.1));
        let over = |height_m: Option<f32>, reference_m: f32| cut(height_m.map_or(FAR_M, |z| z - reference_m));
        let beside: Vec<&Meeting> = self.load.edges.sides.iter().filter(|m| m.object == self.carrier.id && m.is_beside(settings)).collect();
        let drop_m = nth(beside.iter().map(|m| m.own.z - m.beyond.z).collect(), beside.len() / 2);
        let roofed = self.carrier.edges.upper.iter().filter(|m| m.object == self.load.id && m.reversed().is_contact(settings)).count();
        vec![
            base_over,
            base_over_another,
            self.covered(top, &load.base),
            f32::from(u8::from(is_on(load, carrier, self.seen.columns, &self.seen.settings.stack))),
            cut(top.margin(&load.axis)),
            cut(load.bottom_m - carrier.top_m),
            cut(load.bottom_m - carrier.bottom_m),
            cut(load.top_m - carrier.top_m),
            cut(self.load.lowest_m - self.carrier.highest_m),
            cut(self.load.lowest_m - carrier.bottom_m),
            cut(load.bottom_m - floor_m),
            cut(self.load.lowest_m - floor_m),
            cut(load.top_m - load.bottom_m),
            cut(carrier.top_m - carrier.bottom_m),
            load.base.area(),
            top.area(),
            share(self.load.edges.lower.iter().filter(|m| m.object == self.carrier.id).count()),
            share(touching.len()),
            count(&|m| (m.own - m.beyond).norm() <= CLOSE_M),
            count(&|m| top.margin(&m.own.xy()) >= -INSIDE_M),
            share(elsewhere.iter().filter(|m| m.object == 0).count()),
            share(elsewhere.iter().filter(|m| m.object != 0).count()),
            cut(spread_m(&touching)),
            ends(&|_, behind_m| behind_m < -CLEARLY_M),
            ends(&|_, behind_m| behind_m > CLEARLY_M),
            ends(&|m, behind_m| m.object == self.carrier.id && behind_m < -CLEARLY_M),
            ends(&|m, behind_m| m.object == self.carrier.id && behind_m > CLEARLY_M),
            beside.len() as f32 / self.load.edges.sides.len().max(1) as f32,
            cut(drop_m.unwrap_or(FAR_M)),
            over(touch_m, self.carrier.highest_m),
            over(touch_m, self.load.lowest_m),
            over(others_m, self.carrier.highest_m),
            over(others_m, self.load.lowest_m),
            roofed as f32 / self.carrier.edges.upper.len().max(1) as f32,
        ]
    }

    /// The share of one outline's cells that are in another.
    fn covered(&self, outline: &Footprint, by: &Footprint) -> f32 {
        let cells: Vec<Point2<f32>> = cells_of(outline, 0.0, self.seen.columns).collect();
        cells.iter().filter(|cell| by.margin(cell) >= 0.0).count() as f32 / cells.len().max(1) as f32
    }

    /// The highest furniture under the load's axis that is not above what was seen of it; the carrier's bottom without any.
    fn floor_m(&self) -> f32 {
        let limit_m = self.load.lowest_m + self.seen.settings.bottom_slack_m;
        let under =
            self.seen.planes.iter().filter(|p| p.object == 0 && p.height_m <= limit_m && p.outline.margin(&self.load.shape.axis) >= 0.0);
        under.map(|p| p.height_m).reduce(f32::max).unwrap_or(self.carrier.shape.bottom_m)
    }
}

fn cut(length_m: f32) -> f32 {
    length_m.clamp(-FAR_M, FAR_M)
}

/// How far places spread around their middle, seen from above.
fn spread_m(places: &[&Meeting]) -> f32 {
    let [x, y] = cloud::mean_of(places.iter().map(|m| [m.own.x, m.own.y])).unwrap_or_default();
    let middle = Vector2::new(x, y);
    places.iter().map(|m| (m.own.xy().coords - middle).norm()).fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use repose_made_scenes::SceneBuilder;

    use super::*;
    use crate::boosted_trees::DecisionTree;
    use crate::tests::believed;

    #[test]
    fn what_comes_with_the_program_reads_these_measures() {
        assert!(Bearing::own().fitted_on.borne > 0);
        let text = serde_json::to_string(Bearing::own()).unwrap();
        assert_eq!(&Bearing::read(&text).unwrap(), Bearing::own());
        let other = text.replacen("\"base_over\"", "\"base_under\"", 1);
        assert!(Bearing::read(&other).unwrap_err().to_string().contains("measures"));
    }

    #[test]
    fn trees_say_the_logarithm_of_the_odds() {
        let leaf = |bias: f64| BoostedTrees { bias, trees: vec![DecisionTree { splits: Vec::new(), leaves: vec![0.0] }] };
        let even = Bearing::new(leaf(0.0), BearingFitData::default()).unwrap();
        assert!((even.probability(&[0.0; MEASURES.len()]) - 0.5).abs() < 1e-9);
        assert!(Bearing::new(leaf(f64::NAN), BearingFitData::default()).is_err());
    }

    #[test]
    fn what_lies_over_two_things_is_carried_by_both() {
        let bridge = SceneBuilder::table().object(1, [-0.1, 0.0], [0.06, 0.08, 0.1]).object(2, [0.1, 0.0], [0.06, 0.08, 0.1]).object_at(
            3,
            [0.0, 0.0],
            0.1,
            [0.28, 0.08, 0.04],
        );
        let belief = believed(&bridge.scene());
        assert_eq!((belief.carried(1), belief.carried(2), belief.carried(3)), (&[3][..], &[3][..], &[][..]));
    }

    #[test]
    fn what_shows_its_edge_alone_carries_what_covers_it() {
        // A book under a wider one that leaves a strip of it, and something apart from both.
        let books = SceneBuilder::table()
            .object(1, [0.0, -0.02], [0.24, 0.18, 0.03])
            .object_at(2, [0.02, 0.0], 0.03, [0.24, 0.18, 0.03])
            .object(3, [0.3, 0.1], [0.06, 0.06, 0.1]);
        let belief = believed(&books.scene());
        assert_eq!((belief.carried(1), belief.carried(2), belief.carried(3)), (&[2][..], &[][..], &[][..]));
    }

    #[test]
    fn what_stands_close_behind_or_beside_is_no_load() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.12, 0.08, 0.06]).object(2, [0.0, 0.075], [0.1, 0.05, 0.16]).object(
            3,
            [0.1, 0.0],
            [0.06, 0.06, 0.12],
        );
        let belief = believed(&scene.scene());
        assert!([1, 2, 3].iter().all(|id| belief.carried(*id).is_empty()), "{:?}", [1, 2, 3].map(|id| belief.carried(id).to_vec()));
    }
}
