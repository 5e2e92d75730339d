//! Horizontal surfaces on which things can stand: the table, shelves, boxes, and the tops of objects.
//!
//! A height histogram of the points that face up has a peak per surface. The slice around the highest peak is spread over square
//! cells of the floor plan, connected cells are one surface, its points leave the histogram, and the next peak follows. Furniture and
//! each object are searched apart, so that a low box keeps its top though the table is a centimetre below it.
//!
//! Where the camera's pose errs by a degree or two, a table slopes and leaves the slice; it goes on in the next one, on the plane of the first.

use std::collections::BTreeMap;

use repose_geometry::{Footprint, Point2, Point3};

use crate::settings::SurfaceSettings;
use crate::supports::plane::LevelPlane;

/// Most bins of the height histogram; a larger range of heights gets higher bins, so that memory is bounded.
const MAX_BINS: f32 = 10_000.0;
/// Points that a plane is fitted to, at most: more do not make it better.
const FITTED: usize = 2000;
/// What lies on a plane is off it by at most this share of a slice's half thickness, in the middle.
const MOST_OFF: f32 = 0.5;

/// A horizontal surface.
#[derive(Debug, Clone, PartialEq)]
pub struct SupportSurface {
    /// Height, world z, metres: the median of its points.
    pub height_m: f32,
    /// Convex outline of what was seen of it, in the world's horizontal plane.
    pub outline: Footprint,
    /// Area of the cells that hold points of it, square metres; at most the outline's, which covers what stands on it too.
    pub seen_m2: f32,
    /// The object whose top it is, none for furniture.
    pub object: Option<u16>,
    /// The plane of a surface that slopes by more than a slice holds; none of one within its slice.
    pub sloping: Option<LevelPlane>,
}

/// The surfaces among points that face up, furniture first, then by object, each from the largest seen area down.
///
/// `upward` gives world points with the object they belong to (0 = none). A surface may slope by `max_slope`, by errors of the camera's pose.
pub fn find(upward: impl Iterator<Item = (Point3<f32>, u16)>, settings: &SurfaceSettings, max_slope: f32) -> Vec<SupportSurface> {
    let mut by_object: BTreeMap<u16, Vec<Point3<f32>>> = BTreeMap::new();
    for (p, object) in upward {
        by_object.entry(object).or_default().push(p);
    }
    let mut surfaces = Vec::new();
    for (object, points) in by_object {
        surfaces.extend(surfaces_of(points, (object != 0).then_some(object), settings, max_slope));
    }
    surfaces
}

/// The surfaces of one object, or of the furniture.
fn surfaces_of(mut points: Vec<Point3<f32>>, object: Option<u16>, settings: &SurfaceSettings, max_slope: f32) -> Vec<SupportSurface> {
    let (cell_m, min_area_m2) = match object {
        Some(_) => (settings.object_cell_m, settings.min_object_area_m2),
        None => (settings.cell_m, settings.min_area_m2),
    };
    // Enough points for the least area if every cell held one.
    let least = (min_area_m2 / (cell_m * cell_m)).ceil().max(3.0) as usize;
    let limits = Limits { max_slope, apart_m: cell_m, slice_m: settings.tolerance_m };
    let mut found: Vec<Piece> = Vec::new();
    while found.len() < settings.max_count && points.len() >= least {
        let Some((peak_m, most)) = highest_peak(&points, settings) else { break };
        if most < least {
            break;
        }
        let (slice, rest): (Vec<_>, Vec<_>) = points.into_iter().partition(|p| (p.z - peak_m).abs() <= settings.tolerance_m);
        points = rest;
        // A slice that is thinner than the peak may hold nothing; the next would be the same.
        if slice.is_empty() {
            break;
        }
        let mut of_slice: Vec<Piece> = Vec::new();
        for patch in patches(slice, cell_m) {
            let seen_m2 = patch.cells as f32 * cell_m * cell_m;
            if seen_m2 < min_area_m2 {
                continue;
            }
            let Some(outline) = Footprint::of(&patch.points) else { continue };
            let seen_m2 = seen_m2.min(outline.area());
            let surface = SupportSurface { height_m: median_height(&patch.points), outline, seen_m2, object, sloping: None };
            let piece = Piece { surface, points: patch.points, peak_m };
            if let Some(at) = found.iter().position(|earlier| earlier.goes_on_in(&piece, &limits)) {
                widen(&mut found, at, piece, &limits);
            } else if !found.iter().any(|earlier| echoes(&piece.surface, &earlier.surface, settings)) {
                // The noisy rim of a surface of a fuller slice is not another one.
                of_slice.push(piece);
            }
        }
        found.extend(of_slice);
    }
    let mut surfaces: Vec<SupportSurface> = found.into_iter().map(|piece| piece.surface).collect();
    surfaces.sort_by(|a, b| b.seen_m2.total_cmp(&a.seen_m2));
    surfaces.truncate(settings.max_count);
    surfaces
}

/// What a surface may be like that goes on beyond its slice.
struct Limits {
    /// Its steepest slope.
    max_slope: f32,
    /// How far apart its pieces may lie, metres.
    apart_m: f32,
    /// Half the thickness of a slice, metres.
    slice_m: f32,
}

/// A surface with what it was made of.
struct Piece {
    surface: SupportSurface,
    points: Vec<Point3<f32>>,
    /// The middle of the slice that it was first seen in, metres.
    peak_m: f32,
}

impl Piece {
    /// Whether another piece is more of the same surface: it touches this one, and lies on its plane where that has left its slice.
    fn goes_on_in(&self, other: &Self, limits: &Limits) -> bool {
        let (own, others) = (&self.surface.outline, &other.surface.outline);
        let touches = |one: &Footprint, other: &Footprint| one.corners().iter().any(|c| other.margin(c) > -limits.apart_m);
        if !touches(own, others) && !touches(others, own) {
            return false;
        }
        let Some(plane) = self.plane(limits.max_slope) else { return false };
        let has_left = |c: &Point2<f32>| (plane.height_at(c) - self.peak_m).abs() > limits.slice_m;
        let off_m = || median(other.points.iter().map(|p| plane.rise_m(p)).collect());
        others.corners().iter().any(has_left) && off_m().abs() <= MOST_OFF * limits.slice_m
    }

    /// The plane of its points, level where that would be too steep.
    fn plane(&self, max_slope: f32) -> Option<LevelPlane> {
        let every = self.points.len().div_ceil(FITTED).max(1);
        let fitted: Vec<Point3<f32>> = self.points.iter().step_by(every).copied().collect();
        LevelPlane::fit(&fitted, max_slope)
    }

    /// Takes another piece in.
    fn take_in(&mut self, other: Self, max_slope: f32) {
        self.points.extend(other.points);
        let (plane, height_m) = (self.plane(max_slope), median_height(&self.points));
        let surface = &mut self.surface;
        if let Some(both) = surface.outline.around_both(&other.surface.outline) {
            surface.outline = both;
        }
        surface.seen_m2 = (surface.seen_m2 + other.surface.seen_m2).min(surface.outline.area());
        (surface.sloping, surface.height_m) = (plane, height_m);
    }
}

/// Widens the piece at a place among those found by another one, and by those of them that it reaches with it.
fn widen(found: &mut Vec<Piece>, at: usize, by: Piece, limits: &Limits) {
    let mut whole = found.remove(at);
    whole.take_in(by, limits.max_slope);
    while let Some(next) = found.iter().position(|other| whole.goes_on_in(other, limits)) {
        whole.take_in(found.remove(next), limits.max_slope);
    }
    found.insert(at.min(found.len()), whole);
}

/// The middle of the fullest stretch of three bins, and how many points it holds.
fn highest_peak(points: &[Point3<f32>], settings: &SurfaceSettings) -> Option<(f32, usize)> {
    let (low, high) = points.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), p| (low.min(p.z), high.max(p.z)));
    if !(low.is_finite() && high.is_finite()) {
        return None;
    }
    let bin_m = settings.bin_m.max((high - low) / MAX_BINS);
    let bins = ((high - low) / bin_m) as usize + 1;
    let mut counts = vec![0usize; bins + 2];
    for p in points {
        counts[((p.z - low) / bin_m) as usize + 1] += 1;
    }
    let sums = counts.windows(3).map(|w| w.iter().sum::<usize>());
    let (best, most) = sums.enumerate().fold((0, 0), |best, (i, n)| if n > best.1 { (i, n) } else { best });
    Some((low + (best as f32 + 0.5) * bin_m, most))
}

/// Points of one height whose cells touch.
struct Patch {
    points: Vec<Point3<f32>>,
    cells: usize,
}

/// Splits a slice into patches of cells that touch, corners included; in order of first point.
fn patches(slice: Vec<Point3<f32>>, cell_m: f32) -> Vec<Patch> {
    let mut plan = FloorPlan::of(&slice, cell_m);
    let mut patches: Vec<Patch> = Vec::new();
    for p in slice {
        let cell = plan.cell_of(&p);
        if plan.cells[cell] == FloorPlan::OPEN {
            let cells = plan.flood(cell, patches.len() as u32);
            patches.push(Patch { points: Vec::new(), cells });
        }
        patches[plan.cells[cell] as usize].points.push(p);
    }
    patches
}

/// Square cells over the extent of some points: empty, open (holding points, not yet in a patch) or the number of a patch.
struct FloorPlan {
    cells: Vec<u32>,
    columns: usize,
    low: Point2<f32>,
    cell_m: f32,
}

impl FloorPlan {
    const EMPTY: u32 = u32::MAX;
    const OPEN: u32 = u32::MAX - 1;
    /// Most cells along a side; a larger extent gets larger cells, so that memory is bounded.
    const MAX_SIDE: f32 = 1000.0;

    /// The plan of points, with a rim of empty cells so that every cell of a point has eight neighbours.
    fn of(points: &[Point3<f32>], cell_m: f32) -> Self {
        let (low, high) = points
            .iter()
            .fold((Point2::new(f32::INFINITY, f32::INFINITY), Point2::new(f32::NEG_INFINITY, f32::NEG_INFINITY)), |(low, high), p| {
                (low.inf(&p.xy()), high.sup(&p.xy()))
            });
        let cell_m = cell_m.max((high - low).max() / Self::MAX_SIDE);
        let side = |k: usize| ((high[k] - low[k]) / cell_m) as usize + 3;
        let mut plan = Self { cells: vec![Self::EMPTY; side(0) * side(1)], columns: side(0), low, cell_m };
        for p in points {
            let cell = plan.cell_of(p);
            plan.cells[cell] = Self::OPEN;
        }
        plan
    }

    fn cell_of(&self, p: &Point3<f32>) -> usize {
        let along = |k: usize| ((p[k] - self.low[k]) / self.cell_m) as usize + 1;
        along(1) * self.columns + along(0)
    }

    /// Marks every open cell connected to `start` as belonging to `patch`; how many there are.
    fn flood(&mut self, start: usize, patch: u32) -> usize {
        let mut pending = vec![start];
        let mut count = 0;
        while let Some(cell) = pending.pop() {
            if self.cells[cell] != Self::OPEN {
                continue;
            }
            self.cells[cell] = patch;
            count += 1;
            for row in [cell - self.columns, cell, cell + self.columns] {
                pending.extend((row - 1..=row + 1).filter(|n| self.cells[*n] == Self::OPEN));
            }
        }
        count
    }
}

fn median_height(points: &[Point3<f32>]) -> f32 {
    median(points.iter().map(|p| p.z).collect())
}

/// The middle one of some numbers, of which there is one at least.
fn median(mut values: Vec<f32>) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Whether a surface is a thinner copy of a larger one just above or below it.
fn echoes(surface: &SupportSurface, other: &SupportSurface, settings: &SurfaceSettings) -> bool {
    let near = (surface.height_m - other.height_m).abs() < settings.separation_m;
    near && surface.outline.corners().iter().any(|c| other.outline.margin(c) > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::LevelSettings;
    use proptest::prelude::*;

    /// Those that points have with the settings as they come.
    fn found(points: impl Iterator<Item = (Point3<f32>, u16)>) -> Vec<SupportSurface> {
        find(points, &SurfaceSettings::default(), LevelSettings::default().max_slope)
    }

    /// A horizontal square of points, `side_m` wide around (x, y), 5 mm apart.
    fn square(x: f32, y: f32, z: f32, side_m: f32) -> impl Iterator<Item = Point3<f32>> {
        let n = (side_m / 0.005) as i32;
        (0..n * n).map(move |i| Point3::new(x + ((i % n) - n / 2) as f32 * 0.005, y + ((i / n) - n / 2) as f32 * 0.005, z))
    }

    proptest! {
        #[test]
        fn table_shelf_and_top_are_found_at_their_heights(table in -0.3..0.3f32, shelf in 0.1..0.5f32, top in 0.02..0.3f32, side in 0.05..0.2f32) {
            let points = square(0.0, 0.0, table, 0.9).map(|p| (p, 0))
                .chain(square(0.0, 1.0, table + shelf, 0.4).map(|p| (p, 0)))
                .chain(square(0.1, 0.1, table + top, side).map(|p| (p, 7)));
            let found = found(points);
            let heights: Vec<_> = found.iter().map(|s| (s.object, s.height_m)).collect();
            prop_assert_eq!(heights, vec![(None, table), (None, table + shelf), (Some(7), table + top)]);
            prop_assert!((found[0].outline.area() - 0.9 * 0.9).abs() < 0.02);
            prop_assert!(found.iter().all(|s| s.seen_m2 <= s.outline.area()));
        }
    }

    /// A number from -1 to 1 for each of many points, without an order.
    fn scattered(i: usize) -> f32 {
        ((i * 7919) % 61) as f32 / 30.0 - 1.0
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn surfaces_within_their_slices_are_what_they_are_without_any_slope(
            slope in 0.0..0.01f32, noise_m in 0.0..0.006f32, shelf in 0.03..0.5f32, top in 0.02..0.3f32,
        ) {
            let points = || {
                let noisy = |(i, p): (usize, Point3<f32>)| Point3::new(p.x, p.y, p.z + slope * p.x + noise_m * scattered(i));
                let furniture = square(0.0, 0.0, 0.0, 0.9).chain(square(0.0, 0.6, shelf, 0.4));
                let things = square(0.1, 0.1, top, 0.2).enumerate().map(noisy).map(|p| (p, 7));
                furniture.enumerate().map(noisy).map(|p| (p, 0)).chain(things).collect::<Vec<_>>()
            };
            let level = find(points().into_iter(), &SurfaceSettings::default(), 0.0);
            prop_assert_eq!(found(points().into_iter()), level);
        }
    }

    #[test]
    fn a_table_that_a_pose_two_degrees_off_tilts_is_one_surface() {
        let tilted = |side_m: f32, slope: f32, noise_m: f32| {
            let points = square(0.0, 0.0, 0.0, side_m).enumerate();
            let found = found(points.map(|(i, p)| (Point3::new(p.x, p.y, slope * p.x + noise_m * scattered(i)), 0)));
            assert_eq!(found.len(), 1, "{found:?}");
            let surface = &found[0];
            assert!(surface.outline.area() > 0.9 * side_m * side_m && surface.seen_m2 > 0.9 * side_m * side_m, "{surface:?}");
            let plane = surface.sloping.unwrap();
            assert!((plane.slope_x - slope).abs() < 0.002 && plane.slope_y.abs() < 0.002 && surface.height_m.abs() < 0.003, "{surface:?}");
        };
        for (side_m, slope) in [(1.0, 0.035), (1.6, 0.045)] {
            tilted(side_m, slope, 0.0);
            tilted(side_m, slope, 0.003);
        }
    }

    #[test]
    fn a_board_over_the_edge_of_a_tilted_table_does_not_widen_it() {
        let tilted = |p: Point3<f32>| (Point3::new(p.x, p.y, p.z + 0.035 * p.x), 0);
        for thick_m in [0.012, 0.02] {
            let found = found(square(0.0, 0.0, 0.0, 1.0).chain(square(0.55, 0.0, thick_m, 0.3)).map(tilted));
            assert!(found[0].outline.area() < 1.0 && found[0].outline.area() > 0.97, "{thick_m}: {found:?}");
        }
    }

    #[test]
    fn two_tables_of_one_height_stay_two() {
        let points = square(0.0, 0.0, 0.7, 0.4).chain(square(1.0, 0.0, 0.7, 0.4)).map(|p| (p, 0));
        assert_eq!(found(points).len(), 2);
    }

    #[test]
    fn noise_on_a_table_is_not_a_second_table() {
        let wavy = square(0.0, 0.0, 0.0, 0.8).map(|p| Point3::new(p.x, p.y, 0.02 * (p.x + 0.4)));
        assert_eq!(found(wavy.map(|p| (p, 0))).len(), 1);
    }

    #[test]
    fn a_slice_that_misses_its_peak_ends_the_search() {
        // The peak is in the middle of the bin between two levels.
        let settings = SurfaceSettings { bin_m: 0.01, tolerance_m: 0.002, ..SurfaceSettings::default() };
        let points = || square(0.0, 0.0, 0.0, 0.4).chain(square(0.0, 0.0, 0.02, 0.4));
        assert!(find(points().map(|p| (p, 0)), &settings, LevelSettings::default().max_slope).is_empty());
        assert!(!found(points().map(|p| (p, 0))).is_empty());
    }

    #[test]
    fn nothing_faces_up_in_nothing() {
        assert!(found(std::iter::empty()).is_empty());
        assert!(found([(Point3::origin(), 3u16); 2].into_iter()).is_empty());
    }
}
