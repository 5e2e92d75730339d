//! Horizontal surfaces on which things can stand: the table, shelves, boxes, and the tops of objects.
//!
//! A height histogram of the points that face up has a peak per surface. The slice around the highest peak is spread over square
//! cells of the floor plan, connected cells are one surface, its points leave the histogram, and the next peak follows. Furniture and
//! each object are searched apart, so that a low box keeps its top though the table is a centimetre below it.

use std::collections::BTreeMap;

use repose_geometry::{Footprint, Point2, Point3};

use crate::settings::SurfaceSettings;

/// Most bins of the height histogram; a larger range of heights gets higher bins, so that memory is bounded.
const MAX_BINS: f32 = 10_000.0;

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
}

/// The surfaces among points that face up, furniture first, then by object, each from the largest seen area down.
///
/// `upward` gives world points with the object they belong to (0 = none).
pub fn find(upward: impl Iterator<Item = (Point3<f32>, u16)>, settings: &SurfaceSettings) -> Vec<SupportSurface> {
    let mut by_object: BTreeMap<u16, Vec<Point3<f32>>> = BTreeMap::new();
    for (p, object) in upward {
        by_object.entry(object).or_default().push(p);
    }
    let mut surfaces = Vec::new();
    for (object, points) in by_object {
        surfaces.extend(surfaces_of(points, (object != 0).then_some(object), settings));
    }
    surfaces
}

/// The surfaces of one object, or of the furniture.
fn surfaces_of(mut points: Vec<Point3<f32>>, object: Option<u16>, settings: &SurfaceSettings) -> Vec<SupportSurface> {
    let (cell_m, min_area_m2) = match object {
        Some(_) => (settings.object_cell_m, settings.min_object_area_m2),
        None => (settings.cell_m, settings.min_area_m2),
    };
    // Enough points for the least area if every cell held one.
    let least = (min_area_m2 / (cell_m * cell_m)).ceil().max(3.0) as usize;
    let mut found: Vec<SupportSurface> = Vec::new();
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
        let earlier = found.len();
        for patch in patches(slice, cell_m) {
            let seen_m2 = patch.cells as f32 * cell_m * cell_m;
            if seen_m2 < min_area_m2 {
                continue;
            }
            let Some(outline) = Footprint::of(&patch.points) else { continue };
            let seen_m2 = seen_m2.min(outline.area());
            let surface = SupportSurface { height_m: median_height(patch.points), outline, seen_m2, object };
            // The noisy rim of a surface of a fuller slice is not another one.
            if !found[..earlier].iter().any(|other| echoes(&surface, other, settings)) {
                found.push(surface);
            }
        }
    }
    found.sort_by(|a, b| b.seen_m2.total_cmp(&a.seen_m2));
    found.truncate(settings.max_count);
    found
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

fn median_height(mut points: Vec<Point3<f32>>) -> f32 {
    let middle = points.len() / 2;
    points.select_nth_unstable_by(middle, |a, b| a.z.total_cmp(&b.z)).1.z
}

/// Whether a surface is a thinner copy of a larger one just above or below it.
fn echoes(surface: &SupportSurface, other: &SupportSurface, settings: &SurfaceSettings) -> bool {
    let near = (surface.height_m - other.height_m).abs() < settings.separation_m;
    near && surface.outline.corners().iter().any(|c| other.outline.margin(c) > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

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
            let found = find(points, &SurfaceSettings::default());
            let heights: Vec<_> = found.iter().map(|s| (s.object, s.height_m)).collect();
            prop_assert_eq!(heights, vec![(None, table), (None, table + shelf), (Some(7), table + top)]);
            prop_assert!((found[0].outline.area() - 0.9 * 0.9).abs() < 0.02);
            prop_assert!(found.iter().all(|s| s.seen_m2 <= s.outline.area()));
        }
    }

    #[test]
    fn two_tables_of_one_height_stay_two() {
        let points = square(0.0, 0.0, 0.7, 0.4).chain(square(1.0, 0.0, 0.7, 0.4)).map(|p| (p, 0));
        assert_eq!(find(points, &SurfaceSettings::default()).len(), 2);
    }

    #[test]
    fn noise_on_a_table_is_not_a_second_table() {
        let wavy = square(0.0, 0.0, 0.0, 0.8).map(|p| Point3::new(p.x, p.y, 0.02 * (p.x + 0.4)));
        let found = find(wavy.map(|p| (p, 0)), &SurfaceSettings::default());
        assert_eq!(found.len(), 1);
    }

    #[test]
    fn a_slice_that_misses_its_peak_ends_the_search() {
        // The peak is in the middle of the bin between two levels.
        let settings = SurfaceSettings { bin_m: 0.01, tolerance_m: 0.002, ..SurfaceSettings::default() };
        let points = || square(0.0, 0.0, 0.0, 0.4).chain(square(0.0, 0.0, 0.02, 0.4));
        assert!(find(points().map(|p| (p, 0)), &settings).is_empty());
        assert!(!find(points().map(|p| (p, 0)), &SurfaceSettings::default()).is_empty());
    }

    #[test]
    fn nothing_faces_up_in_nothing() {
        assert!(find(std::iter::empty(), &SurfaceSettings::default()).is_empty());
        assert!(find([(Point3::origin(), 3u16); 2].into_iter(), &SurfaceSettings::default()).is_empty());
    }
}
