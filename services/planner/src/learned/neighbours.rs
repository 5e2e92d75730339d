//! What the forecast reads that a neighbour stays when an object is taken away: the neighbour's own measures ([`crate::learned::standing`]), where the
//! believed shapes of the two are, and what tells whether the object bears the neighbour ([`repose_belief::bearing`]). That is more than their shapes:
//! it is where one's picture meets the other's.

use std::sync::Arc;

use nalgebra::Point2;
use repose_belief::bearing::{self, Bearing};
use repose_belief::columns::cells_of;
use repose_belief::outlines::separating_gap_m;
use repose_geometry::Footprint;

use crate::learned::standing::{FAR_M, NEAR_M, Stance, cosine, names_of_object, with_turn};
use crate::scene::prepared::PreparedScene;
use crate::scene::turned::Turned;

/// A measure of an object and its neighbour: its name, and how it is computed.
type OfPair = (&'static str, fn(&Pair<'_>) -> f64);

/// What is measured of the two by their believed shapes: lengths in metres, shares from 0 to 1.
const BY_SHAPES: [OfPair; 11] = [
    // The gap between the two shapes, and to the nearest other thing that the neighbour may rest on instead.
    ("pair_gap", |p| p.gap_m),
    ("pair_other_gap", |p| p.other_gap_m()),
    // How far their outlines, of what was seen from above, reach over each other.
    ("pair_over", |p| p.over_m()),
    // Whether the neighbour's highest part is towards the object.
    ("pair_lean_to", |p| f64::from(cosine(&(p.object.shape.axis - p.neighbour.shape.axis), &p.neighbour.lean))),
    // How much of the neighbour's base is over the object's top.
    ("pair_on_top", |p| p.share_on_top()),
    // The neighbour's bottom and top above the object's, and its bottom above the object's top.
    ("pair_bottoms", |p| f64::from(p.neighbour.shape.bottom_m - p.object.shape.bottom_m)),
    ("pair_tops", |p| f64::from(p.neighbour.shape.top_m - p.object.shape.top_m)),
    ("pair_bottom_over_top", |p| f64::from(p.neighbour.shape.bottom_m - p.object.shape.top_m)),
    // The object's own height and spans.
    ("pair_height", |p| p.object.height_m),
    ("pair_length", |p| p.object.traits.spans_m[0]),
    ("pair_width", |p| p.object.traits.spans_m[1]),
];

/// How likely the object bears the neighbour; 0 where they are clearly apart, as all measures of that are then.
const BORNE: &str = "pair_borne";

/// The names of the measures of a neighbour, in the order that the trees read.
pub fn names() -> Vec<&'static str> {
    names_of_object().chain(BY_SHAPES.iter().map(|(name, _)| *name)).chain([BORNE]).chain(bearing::MEASURES).collect()
}

/// The measures of an object's neighbour, in the order of [`names`]; all finite. None where it is not near.
pub fn beside(neighbour: &Stance<'_>, object: &Stance<'_>) -> Option<Vec<f32>> {
    let pair = Pair { neighbour, object, gap_m: neighbour.shape.gap_m(object.shape) };
    (pair.gap_m <= NEAR_M).then(|| neighbour.of_object().into_iter().chain(pair.measures()).collect())
}

/// The measures that the forecasts of an object read.
#[derive(Debug, Clone, PartialEq)]
pub struct StanceMeasures {
    /// Of the object.
    of_object: Vec<f32>,
    /// Of each of its neighbours beside it.
    pub neighbours: Vec<Vec<f32>>,
}

impl StanceMeasures {
    /// Of an object of a scene; none without an extent.
    pub fn of(prepared: &PreparedScene, id: u16) -> Option<Self> {
        let stance = Stance::of(prepared, id)?;
        let near = prepared.belief.objects.iter().filter(|(other, o)| **other != id && o.shape.as_ref().is_some_and(|s| stance.is_near(s)));
        let neighbours = near.filter_map(|(other, _)| beside(&Stance::of(prepared, *other)?, &stance)).collect();
        Some(Self { of_object: stance.of_object(), neighbours })
    }

    /// Of the object, which was turned over in this way, in the order of [`crate::learned::standing::names`].
    pub fn own(&self, turned: Option<&Turned<'_>>) -> Vec<f32> {
        with_turn(self.of_object.clone(), turned)
    }
}

/// The object whose stance was measured.
#[derive(Debug, PartialEq)]
struct StanceKey(u16);

impl PreparedScene {
    /// [`StanceMeasures::of`], made once.
    pub fn stance_measures(&self, id: u16) -> Option<Arc<StanceMeasures>> {
        self.kept.of(self.belief.objects.len(), StanceKey(id), || StanceMeasures::of(self, id).ok_or(())).ok()
    }
}

/// An object and a neighbour of it.
struct Pair<'a> {
    neighbour: &'a Stance<'a>,
    object: &'a Stance<'a>,
    gap_m: f64,
}

impl Pair<'_> {
    fn measures(&self) -> Vec<f32> {
        let measured = self.object.prepared.belief.bearings().get(&[self.object.id, self.neighbour.id]);
        let borne = measured.map_or(0.0, |measures| Bearing::own().probability(measures) as f32);
        let of_bearing = measured.cloned().unwrap_or_else(|| vec![0.0; bearing::MEASURES.len()]);
        BY_SHAPES.iter().map(|(_, of)| of(self) as f32).chain([borne]).chain(of_bearing).collect()
    }

    fn other_gap_m(&self) -> f64 {
        let others = self.neighbour.prepared.belief.objects.iter().filter(|(id, _)| ![self.neighbour.id, self.object.id].contains(id));
        others.filter_map(|(_, o)| o.shape.as_ref()).map(|shape| self.neighbour.shape.gap_m(shape)).fold(FAR_M, f64::min)
    }

    fn over_m(&self) -> f64 {
        let outlines = Footprint::of(&self.neighbour.cloud).zip(Footprint::of(&self.object.cloud));
        outlines.map_or(0.0, |(a, b)| f64::from((-separating_gap_m(a.corners(), b.corners())).max(0.0)))
    }

    fn share_on_top(&self) -> f64 {
        let Some(top) = self.object.shape.slabs.last() else { return 0.0 };
        let cells: Vec<Point2<f32>> = cells_of(&self.neighbour.shape.base, 0.0, &self.neighbour.prepared.belief.columns).collect();
        cells.iter().filter(|c| top.outline.margin(c) >= 0.0).count() as f64 / cells.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::synthetic::{Prepared, SceneBuilder};

    #[test]
    fn what_is_measured_of_two_objects_is_what_it_is_called() {
        let prepared = SceneBuilder::table()
            .object(1, [0.0, 0.0], [0.06, 0.05, 0.1])
            .object(2, [0.08, 0.0], [0.06, 0.05, 0.03])
            .object_at(3, [0.08, 0.0], 0.03, [0.05, 0.04, 0.05])
            .prepared();
        let [first, low, above] = [1, 2, 3].map(|id| Stance::of(&prepared, id).unwrap());
        let is = |value: f32, expected: f32, within: f32| assert!((value - expected).abs() < within, "{value}, not {expected}");
        let place = |name: &str| names().iter().position(|n| *n == name).unwrap();
        let of = |neighbour: &Stance<'_>, object: &Stance<'_>, name: &str| beside(neighbour, object).unwrap()[place(name)];
        is(of(&above, &low, "pair_bottom_over_top"), 0.0, 0.008);
        assert!(of(&above, &low, "pair_on_top") > 0.8 && of(&above, &low, "pair_over") > 0.03);
        is(of(&above, &low, "pair_bottoms"), 0.03, 0.008);
        // What stands on it is seen to touch it, what stands beside it touches the table.
        assert!(of(&above, &low, "pair_borne") > 0.9 && of(&above, &low, "touches") > 0.3);
        assert!(of(&low, &first, "pair_borne") < 0.1 && of(&low, &first, "touches") < 0.1 && of(&low, &first, "touches_floor") > 0.3);
        assert!(beside(&above, &low).unwrap().iter().all(|m| m.is_finite()));
    }

    #[test]
    fn a_stance_is_measured_once() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).prepared();
        assert!(Arc::ptr_eq(&scene.stance_measures(1).unwrap(), &scene.stance_measures(1).unwrap()));
        assert!(scene.stance_measures(9).is_none(), "no such object");
    }

    #[test]
    fn an_object_far_from_another_is_no_neighbour_of_it() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.06, 0.06, 0.1]).object(2, [0.2, 0.0], [0.06, 0.06, 0.06]).prepared();
        let stance = |id| Stance::of(&prepared, id).unwrap();
        assert_eq!(beside(&stance(1), &stance(2)), None);
        assert!(stance(1).measures(None).iter().all(|m| m.is_finite()));
    }
}
