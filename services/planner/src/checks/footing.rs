//! The support under a candidate: where it comes to rest when lowered, and how well it stands there.
//!
//! The height comes from the tops under the base, never from the cloud's own bottom, which border cleaning trims. A cell of the base is
//! carried when a top was seen at its height, or when it is hidden within the outline of a support surface.

use std::collections::BTreeMap;

use nalgebra::{Point2, Point3};

use crate::checks::MISS_PER_METRE;
use crate::checks::contact::Contact;
use crate::scene::candidate::CandidatePose;
use crate::scene::prepared::PreparedScene;
use crate::scene::query::QueryObject;
use crate::settings::SupportSettings;
use repose_belief::columns::ColumnRun;
use repose_belief::offsets::Offsets;
use repose_belief::view::Sight;

/// Margins of one base, turned or not, are the same to this, metres, also where coordinates are large.
const SAME_M: f64 = 1e-4;

/// How well a candidate stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Footing {
    /// Share of the base that was seen to be carried.
    pub seen_share: f64,
    /// Share of the base that is carried, hidden parts of surfaces included.
    pub carried_share: f64,
    /// How far inside the outline of what carries it the axis stands, metres; negative beyond its edge. None when nothing carries it.
    pub margin_m: Option<f64>,
    /// The object that carries most of it, 0 for furniture; none when nothing was seen to carry it.
    pub carrier: Option<u16>,
}

impl Footing {
    /// The margin, or a metre beyond the edge when nothing carries it: as bad as can be, to compare footings by.
    pub fn margin_or_far_m(&self) -> f64 {
        self.margin_m.unwrap_or(-1.0)
    }
}

/// The ground that a query is set down on.
#[derive(Debug, Clone, Copy)]
pub struct Ground<'a> {
    /// The scene.
    pub prepared: &'a PreparedScene,
    /// The object set down, which the ground does not contain.
    pub query: &'a QueryObject,
    /// Tolerances.
    pub settings: &'a SupportSettings,
}

impl Ground<'_> {
    /// The height of the query's bottom when it is lowered at the candidate's place (its height is not looked at) from `ceiling_m`;
    /// none when nothing is under it.
    pub fn rest_m(&self, candidate: &CandidatePose, ceiling_m: f32) -> Option<f32> {
        let columns = &self.prepared.belief.columns;
        let mut tops: Vec<f32> = Vec::with_capacity(self.query.base.len());
        columns.visit(&self.query.base, &candidate.carrying(), |_, _, cell| {
            let under = columns.runs(cell).iter().filter(|r| r.object != self.query.id && r.high_m <= ceiling_m);
            tops.extend(under.map(|r| r.high_m).reduce(f32::max));
        });
        let axis = candidate.carry(&self.query.shape.axis_offset());
        let planes = self.prepared.belief.planes.iter().filter(|p| p.object != self.query.id && p.outline.contains(&axis));
        if tops.is_empty() {
            let under = planes.map(|p| p.height_m).filter(|h| *h <= ceiling_m).reduce(f32::max);
            return under.map(|h| h + self.settings.release_m);
        }
        let from_highest = |tops: &mut [f32], place: usize| *tops.select_nth_unstable_by(place, |a, b| b.total_cmp(a)).1;
        let strays = (self.settings.stray_share * tops.len() as f32) as usize;
        let highest_m = from_highest(&mut tops, strays);
        let first = tops.iter().filter(|t| **t > highest_m).count();
        let last = tops.iter().filter(|t| **t >= highest_m - self.settings.same_support_m).count();
        let mut level_m = from_highest(&mut tops, (first + last) / 2);
        // Two supports that are less apart than the noise of one may be: it stands on the higher.
        let mut higher: Vec<f32> =
            tops.iter().filter(|t| **t > level_m + self.settings.release_m + self.settings.reached_into_m).copied().collect();
        if higher.len() > strays {
            let middle = higher.len() / 2;
            level_m = from_highest(&mut higher, middle);
        }
        let off_m = |height_m: &f32| (height_m - level_m).abs();
        let near = planes.map(|p| p.height_m).filter(|height_m| off_m(height_m) <= self.settings.plane_m);
        let plane_m = near.min_by(|a, b| off_m(a).total_cmp(&off_m(b)));
        Some(plane_m.unwrap_or(level_m) + self.settings.release_m)
    }

    /// How well a candidate stands where it is.
    pub fn footing(&self, candidate: &CandidatePose) -> Footing {
        let level_m = self.query.bottom_of(candidate.centroid_m[2]) - self.settings.release_m;
        let (mut seen, mut contact) = (0usize, Contact::default());
        let mut carriers: BTreeMap<u16, usize> = BTreeMap::new();
        let base = &self.query.base;
        self.carried(base, candidate, level_m, |i, place, carried| {
            contact.add(base.y_m(i), place);
            if let CellSupport::Seen(object) = carried {
                seen += 1;
                *carriers.entry(object).or_default() += 1;
            }
        });
        let cells = self.query.base.len().max(1) as f64;
        let axis = candidate.carry(&self.query.shape.axis_offset());
        let margin_m = contact.outline().map(|outline| f64::from(outline.margin(&axis)));
        // Of equals the lowest id, furniture first.
        let carrier = carriers.into_iter().rev().max_by_key(|(_, count)| *count).map(|(object, _)| object);
        Footing { seen_share: seen as f64 / cells, carried_share: contact.cell_count() as f64 / cells, margin_m, carrier }
    }

    /// The objects that carry a candidate where it is, by more than a few stray cells.
    pub fn objects_under(&self, candidate: &CandidatePose) -> Vec<u16> {
        let level_m = self.query.bottom_of(candidate.centroid_m[2]) - self.settings.release_m;
        let mut cells: BTreeMap<u16, usize> = BTreeMap::new();
        self.carried(&self.query.base, candidate, level_m, |_, _, carried| {
            if let CellSupport::Seen(object) = carried {
                *cells.entry(object).or_default() += 1;
            }
        });
        let enough = self.settings.stray_share * self.query.base.len() as f32;
        cells.into_iter().filter(|(object, count)| *object != 0 && *count as f32 > enough).map(|(object, _)| object).collect()
    }

    /// Share of the band around the base that is carried too: near an edge it is not.
    pub fn rim_share(&self, candidate: &CandidatePose) -> f64 {
        let level_m = self.query.bottom_of(candidate.centroid_m[2]) - self.settings.release_m;
        let mut carried = 0usize;
        self.carried(&self.query.rim, candidate, level_m, |_, _, _| carried += 1);
        carried as f64 / self.query.rim.len().max(1) as f64
    }

    /// Tells of each of the offsets that is carried at a level, in order: its number, where it lands, and what carries it.
    fn carried(&self, offsets: &Offsets, candidate: &CandidatePose, level_m: f32, mut tell: impl FnMut(usize, Point2<f32>, CellSupport)) {
        let columns = &self.prepared.belief.columns;
        let mut landed: Vec<(Point2<f32>, CellTop)> = Vec::with_capacity(offsets.len());
        let mut open: Vec<Point3<f64>> = Vec::new();
        columns.visit(offsets, &candidate.carrying(), |_, place, cell| {
            let mut runs = columns.runs(cell).iter();
            let is_top = |r: &&ColumnRun| r.seen && r.object != self.query.id && (r.high_m - level_m).abs() <= self.settings.tolerance_m;
            let top = runs.rfind(is_top).map_or(CellTop::NotSeen, |run| CellTop::Of(run.object));
            if top == CellTop::NotSeen {
                open.push(Point3::new(place.x, place.y, level_m).cast());
            }
            landed.push((place, top));
        });
        // The camera is asked about all others at once.
        let (view, settings) = (&self.prepared.belief.view, self.settings);
        let mut sights = view.sights(&open, settings.tolerance_m, settings.through_m, self.query.id).into_iter();
        for (i, (place, top)) in landed.into_iter().enumerate() {
            let seen = match top {
                CellTop::Of(object) => Sight::Surface(object),
                CellTop::NotSeen => sights.next().unwrap_or(Sight::Unknown),
            };
            let carried = match seen {
                Sight::Surface(object) => self.prepared.belief.carries(object).then_some(CellSupport::Seen(object)),
                Sight::Empty => None,
                Sight::Unknown => self.goes_on(&place, level_m).then_some(CellSupport::Believed),
            };
            if let Some(carried) = carried {
                tell(i, place, carried);
            }
        }
    }

    /// Whether a surface of a level, seen around a place, is believed to go on there.
    fn goes_on(&self, place: &Point2<f32>, level_m: f32) -> bool {
        let around = self.prepared.belief.planes.iter().filter(|p| p.object != self.query.id);
        let mut level = around.filter(|p| (p.height_m - level_m).abs() <= self.settings.same_support_m);
        level.any(|p| p.outline.contains(place))
    }
}

/// By how much a candidate stands too badly.
pub fn support_miss(footing: &Footing, query: &QueryObject, settings: &SupportSettings) -> Option<f64> {
    let wanted_m = wanted_margin_m(query, settings);
    let margin_miss_m = wanted_m.map_or(0.0, |wanted_m| (wanted_m - footing.margin_or_far_m()).max(0.0));
    // An object may be set down on a smaller one, but for one whose margin nothing tells. On furniture nothing may reach over an edge, nor over what is
    // not known to be there.
    let wanted_share = if wanted_m.is_none() || footing.carrier.unwrap_or(0) == 0 { settings.min_carried_share } else { 0.0 };
    let miss = margin_miss_m * MISS_PER_METRE
        + (settings.min_seen_share - footing.seen_share).max(0.0)
        + (wanted_share - footing.carried_share).max(0.0);
    (miss > 0.0).then_some(miss)
}

/// The margin that what carries an object must give it, metres: a thin object has none to give, so that half of what its own base allows is enough. The
/// cells of a base may tell less than that, and need not tell more of what carries it; where they are a line, as those of a pen, they tell none.
fn wanted_margin_m(query: &QueryObject, settings: &SupportSettings) -> Option<f64> {
    let half_m = 0.5 * query.base_margin_m;
    let allowed_m = if half_m <= SAME_M {
        half_m
    } else {
        match query.told_margin_m? {
            told_m if told_m < half_m => told_m.min(0.5 * told_m) - SAME_M,
            _ => half_m,
        }
    };
    Some(settings.min_margin_m.min(allowed_m))
}

/// The top that was seen at a level over a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CellTop {
    /// Of this object.
    Of(u16),
    /// None in the map; the camera may know of one.
    NotSeen,
}

/// What carries a cell.
#[derive(Debug, Clone, Copy)]
enum CellSupport {
    /// A top of this object (0: furniture) was seen there.
    Seen(u16),
    /// It is hidden, within a surface that was seen around it.
    Believed,
}

#[cfg(test)]
mod tests {
    use repose_geometry::Footprint;

    use super::*;
    use crate::settings::Fixed;
    use crate::tests::synthetic::{Prepared, SceneBuilder, standing_at};

    fn scene() -> (PreparedScene, QueryObject) {
        let prepared =
            SceneBuilder::table().object(1, [0.0, 0.1], [0.15, 0.15, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let query = QueryObject::new(&prepared, 2, 0.0, &Fixed::default()).unwrap();
        (prepared, query)
    }

    fn put(ground: &Ground<'_>, x: f64, y: f64, ceiling_m: f32) -> (Option<f32>, Footing) {
        let query = ground.query;
        let at = |z: f32| CandidatePose::new(&Point3::new(x, y, f64::from(z + query.shape.centroid_height_m())), 0.0);
        let rest_m = ground.rest_m(&at(0.0), ceiling_m);
        (rest_m, ground.footing(&at(rest_m.unwrap_or(0.0))))
    }

    #[test]
    fn it_rests_on_the_table_on_a_box_and_nowhere() {
        let (prepared, query) = scene();
        let settings = SupportSettings::default();
        let ground = Ground { prepared: &prepared, query: &query, settings: &settings };
        let (rest_m, footing) = put(&ground, 0.25, 0.0, f32::INFINITY);
        assert!((rest_m.unwrap() - settings.release_m).abs() < 1e-3);
        assert!(footing.seen_share > 0.95 && footing.carrier == Some(0) && footing.margin_m.unwrap() > 0.02, "{footing:?}");

        let (rest_m, footing) = put(&ground, 0.0, 0.08, f32::INFINITY);
        assert!((rest_m.unwrap() - 0.1 - settings.release_m).abs() < 1e-3);
        assert!(footing.carrier == Some(1) && footing.margin_m.unwrap() > 0.02, "{footing:?}");

        let (rest_m, footing) = put(&ground, 0.7, 0.0, f32::INFINITY);
        assert_eq!((rest_m, footing.margin_m), (None, None));
    }

    #[test]
    fn of_two_supports_that_are_hardly_apart_the_higher_carries_it() {
        // A board 10 mm high, which a fifth of the base is over.
        let prepared = SceneBuilder::table().object(1, [0.0, 0.1], [0.2, 0.2, 0.01]).object(2, [-0.3, -0.2], [0.1, 0.1, 0.08]).prepared();
        let query = QueryObject::new(&prepared, 2, 0.0, &Fixed::default()).unwrap();
        let settings = SupportSettings::default();
        let ground = Ground { prepared: &prepared, query: &query, settings: &settings };
        let offset = query.shape.axis_offset();
        let at = |x: f64| put(&ground, x - f64::from(offset.x), 0.1 - f64::from(offset.y), f32::INFINITY).0.unwrap() - settings.release_m;
        assert!((at(0.13) - 0.01).abs() < 2e-3, "{}", at(0.13));
        assert!(at(0.17).abs() < 2e-3, "beside it the table does: {}", at(0.17));
        assert!((at(0.03) - 0.01).abs() < 2e-3, "{}", at(0.03));
    }

    #[test]
    fn what_is_hardly_wider_than_a_cell_stands_on_the_table_and_not_over_its_edge() {
        let seen = SceneBuilder::table().object(1, [0.0, 0.1], [0.15, 0.15, 0.1]).object(2, [-0.3, -0.2], [0.12, 0.02, 0.02]).prepared();
        let axis = seen.belief.objects[&2].shape.as_ref().unwrap().axis;
        // A base of one row of cells, one whose cells end before its axis, and one that the axis is beside.
        for (near_m, far_m, stands) in [(0.004, 0.004, true), (0.0031, 0.0165, true), (-0.001, 0.005, false)] {
            let mut shapes = seen.belief.shapes();
            let y = [axis.y - near_m, axis.y + far_m];
            let corners = [[-0.06, y[0]], [0.06, y[0]], [0.06, y[1]], [-0.06, y[1]]].map(|[x, y]| Point3::new(axis.x + x, y, 0.0));
            shapes.get_mut(&2).unwrap().base = Footprint::of(&corners).unwrap();
            let prepared = PreparedScene::with_shapes(seen.scene.clone(), shapes);
            let query = QueryObject::new(&prepared, 2, 0.0, &Fixed::default()).unwrap();
            let settings = SupportSettings::default();
            let ground = Ground { prepared: &prepared, query: &query, settings: &settings };
            let misses = |x: f32, yaw_rad: f32| {
                let at = CandidatePose { yaw_rad, ..standing_at(&query, x, -0.1, settings.release_m) };
                support_miss(&ground.footing(&at), &query, &settings)
            };
            for yaw_rad in [0.0, 0.4, 1.1] {
                assert_eq!(misses(0.2, yaw_rad).is_none(), stands, "{near_m} {far_m}, turned by {yaw_rad}: {:?}", misses(0.2, yaw_rad));
            }
            assert!(misses(0.49, 0.0).is_some(), "half of it is over the edge");
        }
    }

    #[test]
    fn half_over_an_edge_the_axis_is_beyond_the_support() {
        let (prepared, query) = scene();
        let settings = SupportSettings::default();
        let ground = Ground { prepared: &prepared, query: &query, settings: &settings };
        let offset = f64::from(query.shape.axis_offset().x);
        let (_, over) = put(&ground, 0.515 - offset, 0.0, f32::INFINITY);
        let (_, on) = put(&ground, 0.44 - offset, 0.0, f32::INFINITY);
        assert!(over.margin_m.unwrap() < -0.005 && on.margin_m.unwrap() > 0.02, "{over:?} {on:?}");
    }

    #[test]
    fn where_the_query_stood_the_table_is_believed_to_go_on() {
        let (prepared, query) = scene();
        let settings = SupportSettings::default();
        let ground = Ground { prepared: &prepared, query: &query, settings: &settings };
        let (_, footing) = put(&ground, -0.3, -0.13, f32::INFINITY);
        assert!(footing.carried_share > 0.95 && footing.seen_share < footing.carried_share, "{footing:?}");
    }
}
