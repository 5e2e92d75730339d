//! What is in a candidate's way, by cells: every prism of the query against the runs above the floor plan.
//!
//! Cheap enough for every candidate of a search. Completed backs of objects are in the way too. The cells are those around the objects: of what reaches
//! beyond them, the points are asked.

use nalgebra::Point3;

use crate::checks::prisms::PlacedPrisms;
use crate::scene::candidate::CandidatePose;
use crate::scene::prepared::PreparedScene;
use crate::scene::query::{OutlineCell, QueryObject};
use crate::settings::{ClearanceSettings, SupportSettings};

/// What the cells say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Obstruction {
    /// Share of the query's cells that something else fills, strays left out.
    pub colliding_share: f64,
    /// Distance to the nearest obstacle, metres, up to the width of the clearance ring; 0 in collision. Told in steps, rounded down; beyond a corner of
    /// the query it is told from the line of an edge.
    pub clearance_m: f64,
    /// The same, told from the corner there.
    pub apart_m: f64,
    /// Share of the cells where the query's unseen back may reach that something else fills.
    pub doubtful_share: f64,
    /// How likely the query reaches something with an end that may be farther out than is believed.
    pub farther_chance: f64,
}

/// Width of a bin that distances are counted in, metres.
const BIN_M: f32 = 0.005;
/// Bins; larger distances count in the last.
const BINS: usize = 64;
/// Bins that chances are counted in.
const CHANCE_BINS: usize = 20;

impl Obstruction {
    /// The most that the distance to the nearest obstacle may be, where it was told by cells of that edge, metres.
    pub fn most_clear_m(&self, cell_m: f32) -> f64 {
        self.apart_m + f64::from(BIN_M + std::f32::consts::SQRT_2 * cell_m)
    }
}

/// What is in the way of a candidate. `touched` objects may be touched and do not count for the clearance.
pub fn obstruction(
    prepared: &PreparedScene,
    query: &QueryObject,
    candidate: &CandidatePose,
    touched: &[u16],
    settings: &ClearanceSettings,
    support: &SupportSettings,
) -> Obstruction {
    let bottom_m = query.bottom_of(candidate.centroid_m[2]);
    // Runs that end here or lower carry the query and are not in its way.
    let floor_m = bottom_m + support.tolerance_m;
    let (mut in_way, mut deepest) = (InWay::default(), 0usize);
    let carry = candidate.carrying();
    // Broad phase: over most of an open table nothing reaches up beside the query at all.
    let free = prepared.belief.columns.top_around(&carry.at, query.reach_m) <= floor_m;
    let columns = &prepared.belief.columns;
    let top_m = query.prisms.iter().map(|prism| prism.high_m).fold(0.0, f32::max);
    for prism in query.prisms.iter().filter(|_| !free) {
        // It is let go higher than it is judged where its foot may be lower: there is room for that above it, too.
        let raised_m = if prism.high_m >= top_m { query.shape.foot_doubt_m } else { 0.0 };
        let (low_m, high_m) = (bottom_m + prism.low_m, bottom_m + prism.high_m + raised_m);
        in_way.deep = 0;
        let lowest_m = floor_m.max(low_m);
        columns.visit(&prism.offsets, &carry, |i, _, above| {
            // Nearly always nothing reaches up so far.
            if columns.top_m(above) <= lowest_m {
                return;
            }
            let cell = &prism.cells[i];
            let mut runs =
                columns.runs(above).iter().filter(|r| r.object != query.id && r.high_m > floor_m && r.high_m > low_m && r.low_m < high_m);
            let Some(first) = runs.next() else { return };
            // However many runs fill it, it is one cell; what may be touched fills it where nothing else does.
            if !touched.contains(&first.object) || runs.any(|run| !touched.contains(&run.object)) {
                in_way.add(cell, settings);
            } else {
                in_way.add_touched(cell, settings);
            }
        });
        deepest = deepest.max(in_way.deep);
    }
    let cells = query.prisms.iter().map(|p| p.inside).sum::<usize>().max(1);
    let doubtful_share = in_way.doubtful as f64 / query.prisms.iter().map(|p| p.doubtful).sum::<usize>().max(1) as f64;
    let strays = settings.stray_cells.max((settings.stray_share * cells as f32) as usize);
    let farther_chance = in_way.farther_chance(settings.stray_cells);
    let colliding = |colliding_share| Obstruction { colliding_share, clearance_m: 0.0, apart_m: 0.0, doubtful_share, farther_chance };
    if in_way.colliding > strays || deepest > settings.stray_cells {
        return colliding(in_way.colliding as f64 / cells as f64);
    }
    if meets_off_the_map(prepared, query, candidate, floor_m, settings) {
        return colliding(1.0);
    }
    let nearest_m = |by_distance: &[usize; BINS]| {
        let mut found = 0;
        let first = by_distance.iter().position(|n| {
            found += n;
            found > settings.stray_cells
        });
        // Some cells are beyond the ring, in some directions.
        first.map_or(query.ring_m, |bin| (bin as f32 * BIN_M).min(query.ring_m)).into()
    };
    let (clearance_m, apart_m) = (nearest_m(&in_way.near), nearest_m(&in_way.apart));
    Obstruction { colliding_share: 0.0, clearance_m, apart_m, doubtful_share, farther_chance }
}

/// Whether points beyond the map of the columns, which ends a little beyond the objects, are in the query above its floor.
fn meets_off_the_map(
    prepared: &PreparedScene,
    query: &QueryObject,
    candidate: &CandidatePose,
    floor_m: f32,
    settings: &ClearanceSettings,
) -> bool {
    let columns = &prepared.belief.columns;
    if columns.covers(&candidate.carrying().at, query.reach_m) {
        return false;
    }
    let placed = PlacedPrisms::new(&query.shape, candidate);
    let Some(bounds) = placed.bounds() else { return false };
    let points = prepared.point_grid();
    let is_in_it = |point: &Point3<f32>| point.z > floor_m && !columns.covers(&point.xy(), 0.0) && placed.to_point_m(point) <= 0.0;
    points.around(&bounds, 0.0).filter(|(point, label)| *label != query.id && is_in_it(point)).count() > settings.stray_points
}

/// The cells that something else fills.
struct InWay {
    /// In the query's outline.
    colliding: usize,
    /// Of those, deep in it, of the prism that is at hand: what meets one prism is not to hide among the cells of all.
    deep: usize,
    /// Where the query's unseen back may reach.
    doubtful: usize,
    /// Where its ends may be, by how likely that is.
    chances: [usize; CHANCE_BINS],
    /// Outside of it, by how far outside.
    near: [usize; BINS],
    /// The same, by how far from it.
    apart: [usize; BINS],
}

impl Default for InWay {
    fn default() -> Self {
        Self { colliding: 0, deep: 0, doubtful: 0, chances: [0; CHANCE_BINS], near: [0; BINS], apart: [0; BINS] }
    }
}

impl InWay {
    fn add(&mut self, cell: &OutlineCell, settings: &ClearanceSettings) {
        let inside_m = cell.inside_m;
        self.doubtful += usize::from(cell.doubtful);
        if cell.chance > 0.0 {
            self.chances[((cell.chance * CHANCE_BINS as f32) as usize).min(CHANCE_BINS - 1)] += 1;
        }
        if inside_m >= settings.graze_m {
            self.colliding += 1;
            self.deep += usize::from(inside_m >= settings.deep_m);
        } else {
            let bin = |distance_m: f32| ((distance_m.max(0.0) / BIN_M) as usize).min(BINS - 1);
            self.near[bin(-inside_m)] += 1;
            self.apart[bin(cell.apart_m)] += 1;
        }
    }

    /// The chance with which more than so many stray cells are reached.
    fn farther_chance(&self, strays: usize) -> f64 {
        let mut reached = 0;
        let likeliest = (0..CHANCE_BINS).rev().find(|bin| {
            reached += self.chances[*bin];
            reached > strays
        });
        likeliest.map_or(0.0, |bin| (bin as f64 + 0.5) / CHANCE_BINS as f64)
    }

    /// Only something that may be touched fills it: that deep it is no touch, and nothing stray.
    fn add_touched(&mut self, cell: &OutlineCell, settings: &ClearanceSettings) {
        let is_deep = usize::from(cell.inside_m >= settings.touch_m);
        self.colliding += is_deep;
        self.deep += is_deep;
    }
}

#[cfg(test)]
mod tests {
    use repose_belief::unseen_end::UnseenEnd;

    use super::*;
    use crate::settings::Fixed;
    use crate::tests::synthetic::{Prepared, SceneBuilder, standing_at};

    #[test]
    fn it_collides_with_a_box_and_its_hidden_back_and_is_clear_beside_it() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.1], [0.1, 0.1, 0.12]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let at = |x: f32, y: f32, bottom_m: f32| standing_at(&query, x, y, bottom_m);
        let judge = |c: &CandidatePose, touched: &[u16]| obstruction(&prepared, &query, c, touched, &fixed.clearance, &fixed.support);
        assert!(judge(&at(0.0, 0.1, 0.001), &[]).colliding_share > 0.1, "inside the box");
        assert!(judge(&at(0.0, 0.17, 0.001), &[]).colliding_share > 0.05, "in its hidden back");
        let on_top = judge(&at(0.0, 0.1, 0.121), &[]);
        assert!(on_top.colliding_share == 0.0 && on_top.clearance_m > 0.035, "{on_top:?}");
        let beside = judge(&at(0.105, 0.1, 0.001), &[]);
        assert!(beside.colliding_share == 0.0 && (0.01..0.03).contains(&beside.clearance_m), "{beside:?}");
        let touching = at(0.082, 0.1, 0.001);
        assert!(judge(&touching, &[1]).colliding_share == 0.0 && judge(&touching, &[1]).clearance_m > 0.03);
    }

    #[test]
    fn what_stands_far_from_every_object_and_is_none_is_in_the_way_too() {
        // What has label 0 is no object, so that the map of the columns ends 0.8 m beyond the query.
        let unlabelled = |x: f64| {
            let table = SceneBuilder::table().object(2, [-0.45, 0.0], [0.06, 0.06, 0.08]);
            let prepared = table.object(0, [x, 0.0], [0.1, 0.1, 0.2]).prepared();
            let fixed = Fixed::default();
            let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
            let at = |x: f32| obstruction(&prepared, &query, &standing_at(&query, x, -0.05, 0.001), &[], &fixed.clearance, &fixed.support);
            let covered = prepared.belief.columns.covers(&nalgebra::Point2::new(x as f32, 0.0), 0.1);
            (covered, at(x as f32).colliding_share, at(x as f32 + 0.15).colliding_share)
        };
        for x in [0.15, 0.44] {
            let (is_covered, inside, beside) = unlabelled(x);
            assert_eq!(is_covered, x < 0.3);
            assert!(inside > 0.05 && beside == 0.0, "{x} m: {inside}, {beside}");
        }
    }

    #[test]
    fn a_cell_counts_once_though_something_else_far_away_may_be_touched() {
        let prepared = SceneBuilder::table()
            .object(1, [0.0, 0.1], [0.1, 0.1, 0.12])
            .object(2, [-0.3, -0.2], [0.06, 0.06, 0.08])
            .object(3, [0.35, -0.2], [0.06, 0.06, 0.08])
            .prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        for y in [0.0, 0.02, 0.04, 0.1, 0.17] {
            let at = standing_at(&query, 0.0, y, 0.001);
            let judge = |touched: &[u16]| obstruction(&prepared, &query, &at, touched, &fixed.clearance, &fixed.support);
            assert_eq!(judge(&[3]), judge(&[]), "{y}");
            assert!(judge(&[1]).colliding_share <= 1.0, "{y}: {:?}", judge(&[1]));
        }
    }

    #[test]
    fn a_corner_that_reaches_deep_into_a_large_thing_is_in_its_way_however_few_its_cells_are() {
        // A block of 2 cm, and a board of 30 cm by 20 cm that would cover it with one corner.
        let prepared = SceneBuilder::table().object(1, [0.0, 0.1], [0.02, 0.02, 0.06]).object(2, [-0.3, -0.2], [0.3, 0.2, 0.05]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let judge = |x: f32, touched: &[u16]| {
            obstruction(&prepared, &query, &standing_at(&query, x, 0.19, 0.001), touched, &fixed.clearance, &fixed.support).colliding_share
        };
        let colliding = (0..12).map(|k| judge(0.13 + 0.005 * k as f32, &[])).collect::<Vec<_>>();
        assert!(colliding[0] > 0.0 && colliding[11] == 0.0, "{colliding:?}");
        let last = colliding.iter().rposition(|share| *share > 0.0).unwrap();
        // Its outline ends 15 cm from its middle, and the block 1 cm from its own.
        assert!(last >= 4, "it is free from {} mm into the block on: {colliding:?}", 30 - 5 * last);
        assert!(judge(0.13, &[1]) > 0.0 && judge(0.185, &[1]) == 0.0, "what it is to touch may not stand inside of it either");
    }

    #[test]
    fn an_end_that_may_be_farther_out_reaches_what_is_there_as_likely_as_it_comes_so_far() {
        let mut prepared =
            SceneBuilder::table().object(1, [0.0, 0.1], [0.1, 0.1, 0.12]).object(2, [-0.3, -0.2], [0.05, 0.05, 0.08]).prepared();
        let fixed = Fixed::default();
        // To the right it goes on by 5 cm in four of ten cases, and by 8 cm in none.
        let right = UnseenEnd { outwards: nalgebra::Vector2::x(), chances: [0.4, 0.4, 0.4, 0.4, 0.0, 0.0] };
        prepared.belief.objects.get_mut(&2).and_then(|object| object.shape.as_mut()).expect("a shape").ends = vec![right];
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let found =
            |x: f32, y: f32| obstruction(&prepared, &query, &standing_at(&query, x, y, 0.001), &[], &fixed.clearance, &fixed.support);
        let chance = |x: f32, y: f32| found(x, y).farther_chance;
        // The block begins 5 cm left of the middle, the object ends 2.5 cm right of its own.
        assert!((chance(-0.1, 0.1) - 0.4).abs() < 0.05, "{:?}", found(-0.1, 0.1));
        assert!((0.1..0.3).contains(&chance(-0.14, 0.1)), "farther away it is less likely: {:?}", found(-0.14, 0.1));
        assert_eq!((chance(-0.18, 0.1), chance(0.1, 0.1), chance(-0.1, -0.2)), (0.0, 0.0, 0.0), "too far, on the other side, beside it");
        // Beyond the clearance ring it is as clear as can be told, whatever end may be there.
        assert!(found(-0.14, 0.1).clearance_m <= f64::from(query.ring_m), "{:?}", found(-0.14, 0.1));
    }

    #[test]
    fn where_an_unseen_back_may_reach_something_is_doubtful() {
        // Taller than wide, its top hardly seen from the side: it may be deeper than it is wide, away from the camera at −y.
        let prepared = SceneBuilder::table().object(1, [0.0, 0.1], [0.1, 0.1, 0.12]).object(2, [-0.3, -0.2], [0.05, 0.05, 0.2]).prepared();
        let fixed = Fixed::default();
        let mut query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let doubtful = |query: &QueryObject, y: f32| {
            obstruction(&prepared, query, &standing_at(query, 0.0, y, 0.001), &[], &fixed.clearance, &fixed.support).doubtful_share
        };
        assert_eq!(doubtful(&query, 0.0), 0.0, "its top was seen whole");
        query.shape.doubt = nalgebra::Vector2::new(0.0, 0.035);
        for (prism, slab) in query.prisms.iter_mut().zip(&query.shape.slabs) {
            let origin = query.shape.centroid.xy().cast::<f32>();
            prism.doubtful = crate::scene::query::doubt(&mut prism.cells, &slab.outline, &origin, &query.shape.doubt, query.ring_m);
        }
        assert!(doubtful(&query, 0.0) > 0.2, "in front of the box its back may reach into it: {}", doubtful(&query, 0.0));
        assert_eq!(doubtful(&query, -0.2), 0.0, "far from it nothing is doubtful");
        assert_eq!(doubtful(&query, 0.2), 0.0, "behind the box its front is known");
    }
}
