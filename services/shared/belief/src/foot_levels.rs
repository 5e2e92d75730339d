//! The levels at which an object may end, and what is measured of each: what [`crate::foot`] chooses among.
//!
//! They are what the rule of [`crate::standing`] says, the furniture under it, the tops, the insides and the bottoms of what may bear it
//! ([`crate::bearing`]), and its own lowest points. Of each is measured what the camera read between it and the object's lowest points, how likely
//! which object bears it, where its lower edge ends in the picture, and whether the network that completes shapes fills the space around it
//! ([`crate::filling`]).

use std::collections::BTreeMap;
use std::sync::LazyLock;

use nalgebra::{Point3, Vector2};
use repose_geometry::Footprint;

use crate::bearing::{self, Bearing, Candidate};
use crate::shape::Shape;
use crate::standing::{ObservedGeometry, nth};

/// The measures of a level, in the order that the trees read: lengths in metres, shares from 0 to 1, flags 0 or 1.
pub const MEASURES: [&str; 56] = [
    // What the level is: the rule's word, furniture, a carrier's top, the highest and the middle of a carrier's points under the object, a carrier's
    // bottom, the object's own lowest points, and a little below them.
    "is_rule",
    "is_furniture",
    "is_top",
    "is_under",
    "is_inside",
    "is_bottom",
    "is_lowest",
    "is_below",
    // How far it is over the rule's word, below what nearly all points of the object are above, below all but stray ones, and over the highest
    // furniture under the axis.
    "over_rule",
    "below_seen",
    "below_lowest",
    "over_floor",
    // How likely the carrier whose level it is bears the object; of furniture, how likely nothing does. The same of the likeliest carrier. How far the
    // carrier's top or bottom is from the level.
    "borne",
    "borne_most",
    "carrier_span",
    // What the camera read where the object would be between its lowest points and the level: shares of the object itself, of other things and of
    // furniture at that place, of what is clearly behind, of what is clearly nearer, and of nothing.
    "reads_own",
    "reads_others",
    "reads_furniture",
    "reads_behind",
    "reads_nearer",
    "reads_nothing",
    // The object: points; height as it is believed to stand, and as it was seen; how far its stray points reach down; the area of its base; how many
    // may bear it, and how many levels there are.
    "points",
    "height",
    "seen_height",
    "strays",
    "base_area",
    "carriers",
    "levels",
    // Of its likeliest carrier, as `bearing` has them.
    "hidden",
    "hangs",
    "hidden_by_carrier",
    "hangs_before_carrier",
    "touches_floor",
    "touches_others",
    "touches",
    "touches_closely",
    "beside",
    "base_over",
    // How likely the object fills the space around the level by the network that completes shapes ([`crate::filling`]), told that it stands at the
    // lowest of its levels: the slab over the level, that under it, the next over and under; how much of the first two; the lowest two slabs of all, and
    // how far the level is over them.
    "low_over",
    "low_under",
    "low_next_over",
    "low_next_under",
    "low_share_over",
    "low_share_under",
    "low_first",
    "low_second",
    "low_above",
    // The same, told that it stands where the rule says.
    "rule_over",
    "rule_under",
    "rule_next_over",
    "rule_next_under",
    "rule_share_over",
    "rule_share_under",
    "rule_first",
    "rule_second",
    "rule_above",
];

/// Where the measures begin that are those of [`bearing`], by name.
const OF_BEARING: usize = 28;
/// How many these are.
const BEARING_COUNT: usize = 10;

/// How far from the truth a level may be and still be the right one, metres.
pub const RIGHT_M: f32 = 0.008;
/// Lengths are cut here, metres.
const FAR_M: f32 = 0.3;
/// What has fewer points is left to the rule.
const MIN_POINTS: usize = 150;
/// Furniture counts as under an object up to this far beyond its outline, metres: objects at a table's far edge hide that.
const BESIDE_M: f32 = 0.02;
/// How many levels of furniture are tried.
const FLOORS: usize = 2;
/// Carriers less likely than this are left out.
const LEAST_BORNE: f64 = 0.03;

/// A level at which an object may end.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    /// World z, metres.
    pub height_m: f32,
    /// In the order of [`MEASURES`], all finite.
    pub measures: Vec<f32>,
}

/// What a level is of; as the first measures have it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Rule,
    Furniture,
    Top,
    Under,
    Inside,
    Bottom,
    Lowest,
    Below,
}

/// A level before it is measured.
struct Proposed {
    kind: Kind,
    height_m: f32,
    borne: f64,
    carrier_span_m: f32,
}

/// The levels of each object, the rule's first; `shapes` are those that the rule completes, and `pairs` which of them may bear which. Objects of which
/// little was seen are left out.
pub fn levels(seen: &ObservedGeometry<'_>, shapes: &BTreeMap<u16, Shape>, pairs: &[Candidate]) -> BTreeMap<u16, Vec<Level>> {
    let of = |(id, shape): (&u16, &Shape)| {
        let object = Object::of(*id, shape, seen, shapes, pairs)?;
        let proposed = object.proposed(shapes);
        Some((*id, proposed.iter().map(|level| object.measured(level, proposed.len())).collect()))
    };
    shapes.iter().filter_map(of).collect()
}

/// An object and what may bear it.
struct Object<'a> {
    id: u16,
    shape: &'a Shape,
    seen: &'a ObservedGeometry<'a>,
    points: &'a [Point3<f32>],
    /// What nearly all of its points are above, and all but stray ones, metres.
    seen_m: f32,
    lowest_m: f32,
    /// Furniture under its axis, the highest first, metres.
    floors_m: Vec<f32>,
    carriers: Vec<(f64, &'a Candidate)>,
}

impl<'a> Object<'a> {
    fn of(
        id: u16,
        shape: &'a Shape,
        seen: &'a ObservedGeometry<'a>,
        shapes: &BTreeMap<u16, Shape>,
        pairs: &'a [Candidate],
    ) -> Option<Self> {
        let points = seen.clouds.get(&id).filter(|points| points.len() >= MIN_POINTS)?;
        let lowest = |n: usize| nth(points.iter().map(|p| p.z).collect(), n);
        let (seen_m, lowest_m) = (lowest(points.len() / 50)?, lowest(seen.settings.stack.stray_points)?);
        let limit_m = seen_m + seen.settings.bottom_slack_m;
        let is_under =
            |p: &&crate::plane::SupportPlane| p.object == 0 && p.height_m <= limit_m && p.outline.margin(&shape.axis) >= -BESIDE_M;
        let mut floors_m: Vec<f32> = seen.planes.iter().filter(is_under).map(|p| p.height_m).collect();
        floors_m.sort_by(|a, b| b.total_cmp(a));
        floors_m.dedup_by(|lower, higher| *higher - *lower < 0.5 * RIGHT_M);
        let bears = |pair: &'a Candidate| (Bearing::own().probability(&pair.measures), pair);
        let carriers = pairs.iter().filter(|pair| pair.load == id && shapes.contains_key(&pair.carrier)).map(bears).collect();
        Some(Self { id, shape, seen, points, seen_m, lowest_m, floors_m, carriers })
    }

    fn likeliest(&self) -> Option<&(f64, &'a Candidate)> {
        self.carriers.iter().max_by(|a, b| a.0.total_cmp(&b.0))
    }

    fn borne_most(&self) -> f64 {
        self.likeliest().map_or(0.0, |(borne, _)| *borne)
    }

    fn proposed(&self, shapes: &BTreeMap<u16, Shape>) -> Vec<Proposed> {
        let most = self.borne_most();
        let own = |kind, height_m, borne| Proposed { kind, height_m, borne, carrier_span_m: 0.0 };
        let mut proposed = vec![own(Kind::Rule, self.shape.bottom_m, most)];
        proposed.extend(self.floors_m.iter().take(FLOORS).map(|floor_m| own(Kind::Furniture, *floor_m, 1.0 - most)));
        let outline = self.seen.outline(self.id);
        for (borne, pair) in self.carriers.iter().filter(|(borne, _)| *borne >= LEAST_BORNE) {
            let Some(carrier) = shapes.get(&pair.carrier) else { continue };
            let of_carrier = |kind, height_m: f32, carrier_span_m| Proposed { kind, height_m, borne: *borne, carrier_span_m };
            let span_m = carrier.top_m - carrier.bottom_m;
            proposed.push(of_carrier(Kind::Top, carrier.top_m.min(self.lowest_m), span_m));
            let under = outline.map_or_else(Vec::new, |outline| self.points_under(pair.carrier, outline));
            let strays = self.seen.settings.stack.stray_points;
            if under.len() > strays {
                let [highest_m, middle_m] = [under[strays], under[under.len() / 2]];
                proposed.push(of_carrier(Kind::Under, highest_m, carrier.top_m - highest_m));
                proposed.push(of_carrier(Kind::Inside, middle_m, carrier.top_m - middle_m));
            }
            proposed.push(of_carrier(Kind::Bottom, carrier.bottom_m + 0.5 * RIGHT_M, span_m));
        }
        proposed.push(own(Kind::Lowest, self.lowest_m, most));
        proposed.push(own(Kind::Below, self.lowest_m - RIGHT_M, most));
        // Nothing reaches below what it stands on, and what was seen of it is not below it.
        proposed.retain(|level| level.kind == Kind::Rule || level.height_m <= self.lowest_m);
        proposed
    }

    /// How high the points of a carrier are that are under the object, the highest first.
    fn points_under(&self, carrier: u16, outline: &Footprint) -> Vec<f32> {
        let limit_m = self.seen_m - 0.25 * RIGHT_M;
        let points = self.seen.clouds.get(&carrier).map_or(&[][..], Vec::as_slice);
        let mut heights: Vec<f32> = points.iter().filter(|p| p.z <= limit_m && outline.margin(&p.xy()) >= 0.0).map(|p| p.z).collect();
        heights.sort_by(|a, b| b.total_cmp(a));
        heights
    }

    fn measured(&self, level: &Proposed, levels: usize) -> Level {
        let mut measures = vec![0.0; 8];
        measures[level.kind as usize] = 1.0;
        let floor_m = self.floors_m.first();
        measures.extend([
            cut(level.height_m - self.shape.bottom_m),
            cut(self.seen_m - level.height_m),
            cut(self.lowest_m - level.height_m),
            cut(floor_m.map_or(FAR_M, |floor_m| level.height_m - floor_m)),
            level.borne as f32,
            self.borne_most() as f32,
            cut(level.carrier_span_m),
        ]);
        measures.extend(self.readings(level.height_m));
        measures.extend([
            self.points.len() as f32,
            self.shape.top_m - self.shape.bottom_m,
            self.shape.top_m - self.lowest_m,
            self.seen_m - self.lowest_m,
            self.shape.base.area(),
            self.carriers.len() as f32,
            levels as f32,
        ]);
        let likeliest = self.likeliest().map(|(_, pair)| &pair.measures);
        measures.extend(places_in_bearing().iter().map(|at| likeliest.map_or(0.0, |measures| measures[*at])));
        Level { height_m: level.height_m, measures }
    }

    /// What the camera read where the object would be between its lowest points and a level, as shares of what was asked: itself, others and
    /// furniture at that place, what is behind, what is nearer, nothing.
    fn readings(&self, level_m: f32) -> [f32; 6] {
        const COLUMNS: usize = 24;
        const STEPS: usize = 6;
        let (stack, gap_m) = (&self.seen.settings.stack, self.seen_m - level_m);
        let mut counts = [0usize; 6];
        if gap_m <= 0.5 * RIGHT_M {
            return [0.0; 6];
        }
        let eye = self.seen.view.eye().xy();
        let low: Vec<&Point3<f32>> = self.points.iter().filter(|p| p.z <= self.seen_m + stack.band_m).collect();
        for p in low.iter().step_by(low.len().div_ceil(COLUMNS).max(1)) {
            let away = (p.xy() - eye).try_normalize(1e-3).unwrap_or_else(Vector2::zeros);
            let inside = p.xy() + away * stack.below_m;
            for step in 1..STEPS {
                let place = Point3::new(inside.x, inside.y, self.seen_m - gap_m * step as f32 / STEPS as f32);
                let read = match self.seen.view.reading(&place) {
                    None => 5,
                    Some(reading) if reading.object == self.id => 0,
                    Some(reading) if reading.behind_m > stack.through_m => 3,
                    Some(reading) if reading.behind_m < -stack.same_place_m => 4,
                    Some(reading) => 1 + usize::from(reading.object == 0),
                };
                counts[read] += 1;
            }
        }
        let asked = counts.iter().sum::<usize>().max(1) as f32;
        counts.map(|count| count as f32 / asked)
    }
}

/// Where the measures of [`bearing`] are that are read.
fn places_in_bearing() -> &'static [usize] {
    static PLACES: LazyLock<Vec<usize>> = LazyLock::new(|| {
        let place = |name: &&str| bearing::MEASURES.iter().position(|measure| measure == name).expect("a test reads them");
        MEASURES[OF_BEARING..OF_BEARING + BEARING_COUNT].iter().map(place).collect()
    });
    &PLACES
}

fn cut(length_m: f32) -> f32 {
    length_m.clamp(-FAR_M, FAR_M)
}

#[cfg(test)]
mod tests {
    use repose_made_scenes::{SceneBuilder, world_from_camera};

    use super::*;
    use crate::tests::believed;
    use crate::{Belief, BeliefSettings, SeenScene};

    #[test]
    fn the_measures_of_what_bears_it_are_there_by_name() {
        let read: Vec<&str> = places_in_bearing().iter().map(|at| bearing::MEASURES[*at]).collect();
        assert_eq!(MEASURES[OF_BEARING..OF_BEARING + BEARING_COUNT], read);
    }

    #[test]
    fn levels_are_those_of_what_is_under_an_object_and_none_is_above_its_points() {
        let scene = SceneBuilder::table()
            .object(1, [0.0, 0.0], [0.15, 0.12, 0.1])
            .object_at(2, [0.0, 0.0], 0.1, [0.06, 0.06, 0.08])
            .object(3, [0.25, 0.0], [0.05, 0.05, 0.05])
            .scene();
        let levels = Belief::foot_levels(&SeenScene::of(&scene, &world_from_camera()), &BeliefSettings::default()).unwrap();
        for (id, levels) in &levels {
            let lowest_m = scene.points_of(*id).map(|p| p[2]).fold(f32::INFINITY, f32::min);
            let highest_m = scene.points_of(*id).map(|p| p[2]).fold(f32::NEG_INFINITY, f32::max);
            assert!(levels.iter().skip(1).all(|level| level.height_m < lowest_m + 0.01 && level.height_m < highest_m));
            assert!(levels.iter().all(|level| level.measures.len() == MEASURES.len() && level.measures.iter().all(|m| m.is_finite())));
        }
        let is_tried = |id: u16, height_m: f32| levels[&id].iter().any(|level| (level.height_m - height_m).abs() < 0.004);
        assert!(is_tried(2, 0.1) && is_tried(2, 0.0) && is_tried(3, 0.0));
        let sure = |id: u16| believed(&scene).objects[&id].shape.as_ref().map(|shape| shape.foot_probability);
        assert!([1, 2, 3].map(sure).iter().all(|p| p.is_some_and(|p| p > 0.8)), "{:?}", [1, 2, 3].map(sure));
    }

    #[test]
    fn levels_are_told_with_what_the_network_says_of_the_space_around_them() {
        let scene =
            SceneBuilder::table().object(1, [0.0, 0.0], [0.15, 0.12, 0.1]).object_at(2, [0.0, 0.0], 0.1, [0.06, 0.06, 0.08]).scene();
        let levels = Belief::foot_levels(&SeenScene::of(&scene, &world_from_camera()), &BeliefSettings::default()).unwrap();
        let says = |height_m: f32, name: &str| {
            let level = levels[&2].iter().find(|level| (level.height_m - height_m).abs() < 0.004).unwrap();
            level.measures[MEASURES.iter().position(|measure| *measure == name).unwrap()]
        };
        // On the block it stands as the rule says, and at the table its lowest level is.
        assert!(says(0.1, "rule_above").abs() < 0.004 && says(0.0, "low_above").abs() < 0.004 && says(0.0, "low_under") < 0.0);
        assert!((says(0.1, "low_above") - 0.1).abs() < 0.006 && (0.0..=1.0).contains(&says(0.1, "low_under")));
        assert!(says(0.1, "rule_over") > 0.9 && says(0.1, "low_over") > says(0.0, "low_over"), "it is there, and less likely below that");
        assert_eq!(says(0.0, "low_over"), says(0.1, "low_first"));
    }
}
