//! Farthest point sampling fast enough for whole scenes.
//!
//! The same order as [`repose_geometry::sampling::farthest_point_order`], which looks at every point for every choice. A new choice can only
//! shorten the distances of points nearer to it than the farthest distance left, so after the first few choices only the grid cells around
//! it are visited, and the next farthest point is found through the best of each cell and of each block of cells.

use nalgebra::Point3;

/// Points in a cell, about.
const POINTS_PER_CELL: f32 = 16.0;
/// Cells whose best is kept together.
const BLOCK: usize = 64;
/// Cells of the grid at most, empty ones included.
const CELLS_MOST: f32 = 4e6;

/// The indices of up to `count` points, each the one farthest from all before it; the first is the one farthest from the mean. Ties go to
/// the lowest index.
pub fn farthest_point_order(points: &[Point3<f32>], count: usize) -> Vec<u32> {
    let count = count.min(points.len());
    if count == 0 {
        return Vec::new();
    }
    let sum = points.iter().fold(nalgebra::Vector3::<f64>::zeros(), |s, p| s + p.coords.cast::<f64>());
    let mean = Point3::from((sum / points.len() as f64).cast::<f32>());
    let cells = Cells::new(points);
    let mut distance = vec![f32::INFINITY; points.len()];
    let mut best_of_cell = vec![NONE; cells.ranges.len()];
    let mut best_of_block = vec![NONE; cells.ranges.len().div_ceil(BLOCK)];
    let mut touched = vec![false; best_of_block.len()];
    let mut next = points.iter().enumerate().fold(NONE, |best, (i, p)| farther(best, ((p - mean).norm_squared(), i as u32))).1;
    let mut reach = f32::INFINITY;
    let mut result = Vec::with_capacity(count);
    loop {
        result.push(next);
        if result.len() == count {
            return result;
        }
        let chosen = points[next as usize];
        cells.for_each_near(&chosen, reach, |c| {
            let mut best = NONE;
            for slot in cells.ranges[c].clone() {
                let d = &mut distance[slot];
                *d = d.min((cells.points[slot] - chosen).norm_squared());
                if cells.order[slot] == next {
                    // Duplicates of a chosen point are at distance 0 and still come out once each, after everything else.
                    *d = -1.0;
                }
                best = farther(best, (*d, cells.order[slot]));
            }
            best_of_cell[c] = best;
            touched[c / BLOCK] = true;
        });
        for (b, touched) in touched.iter_mut().enumerate().filter(|(_, t)| **t) {
            let cells = &best_of_cell[b * BLOCK..((b + 1) * BLOCK).min(best_of_cell.len())];
            best_of_block[b] = cells.iter().copied().fold(NONE, farther);
            *touched = false;
        }
        let (farthest, index) = best_of_block.iter().copied().fold(NONE, farther);
        (reach, next) = (farthest.max(0.0).sqrt(), index);
    }
}

/// Squared distance and index of nothing.
const NONE: (f32, u32) = (f32::NEG_INFINITY, u32::MAX);

fn farther(a: (f32, u32), b: (f32, u32)) -> (f32, u32) {
    if b.0 > a.0 || (b.0 == a.0 && b.1 < a.1) { b } else { a }
}

/// Points sorted into the cells of a uniform grid; only cells with points are kept.
struct Cells {
    low: Point3<f32>,
    edge_m: f32,
    shape: [usize; 3],
    /// Which kept cell a grid cell is, `u32::MAX` for an empty one.
    kept: Vec<u32>,
    ranges: Vec<std::ops::Range<usize>>,
    order: Vec<u32>,
    points: Vec<Point3<f32>>,
}

impl Cells {
    fn new(points: &[Point3<f32>]) -> Self {
        let low = points.iter().fold(points[0], |l, p| l.inf(p));
        let high = points.iter().fold(points[0], |h, p| h.sup(p));
        let extent = (high - low).map(|e| e.max(1e-6));
        // Surfaces fill about the square of what they span, not the cube.
        let mut sorted: [f32; 3] = extent.into();
        sorted.sort_by(f32::total_cmp);
        let by_surface = (sorted[2] * sorted[1].max(0.1 * sorted[2]) * POINTS_PER_CELL / points.len() as f32).sqrt();
        let edge_m = by_surface.max((extent.product() / CELLS_MOST).cbrt()).max(extent.max() / 1000.0);
        let shape: [usize; 3] = std::array::from_fn(|k| (extent[k] / edge_m) as usize + 1);
        let cell_of = |p: &Point3<f32>| {
            let [x, y, z]: [usize; 3] = std::array::from_fn(|k| (((p[k] - low[k]) / edge_m) as usize).min(shape[k] - 1));
            (x * shape[1] + y) * shape[2] + z
        };
        let keys: Vec<usize> = points.iter().map(cell_of).collect();
        let mut counts = vec![0u32; shape.iter().product()];
        for key in &keys {
            counts[*key] += 1;
        }
        let mut kept = vec![u32::MAX; counts.len()];
        let mut ranges = Vec::new();
        let mut start = 0;
        for (cell, count) in counts.iter().enumerate().filter(|(_, n)| **n > 0) {
            kept[cell] = ranges.len() as u32;
            ranges.push(start..start + *count as usize);
            start += *count as usize;
        }
        let mut fill: Vec<usize> = ranges.iter().map(|r| r.start).collect();
        let mut order = vec![0u32; points.len()];
        for (i, key) in keys.iter().enumerate() {
            let at = &mut fill[kept[*key] as usize];
            order[*at] = i as u32;
            *at += 1;
        }
        let sorted = order.iter().map(|i| points[*i as usize]).collect();
        Self { low, edge_m, shape, kept, ranges, order, points: sorted }
    }

    /// Calls `visit` for every kept cell that may hold a point within `reach` of `p`.
    fn for_each_near(&self, p: &Point3<f32>, reach: f32, mut visit: impl FnMut(usize)) {
        // A little more than the reach covers the rounding of distances and cell numbers.
        let reach = reach * 1.001 + 1e-3 * self.edge_m;
        let bound = |k: usize, at: f32| ((at - self.low[k]) / self.edge_m).clamp(0.0, (self.shape[k] - 1) as f32) as usize;
        let [x, y, z]: [std::ops::RangeInclusive<usize>; 3] = std::array::from_fn(|k| bound(k, p[k] - reach)..=bound(k, p[k] + reach));
        for x in x {
            for y in y.clone() {
                let row = (x * self.shape[1] + y) * self.shape[2];
                for kept in &self.kept[row + z.start()..=row + z.end()] {
                    if *kept != u32::MAX {
                        visit(*kept as usize);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_fast_order_is_the_plain_order(
            raw in prop::collection::vec(prop::array::uniform3(-1.0..1.0f32), 1..300), count in 1usize..320, flat in any::<bool>(),
        ) {
            let points: Vec<_> = raw.into_iter().map(|[x, y, z]| Point3::new(x, y, if flat { 0.0 } else { z })).collect();
            prop_assert_eq!(farthest_point_order(&points, count), repose_geometry::sampling::farthest_point_order(&points, count));
        }
    }

    #[test]
    fn duplicates_each_come_once_in_index_order() {
        let points = [Point3::new(1.0, 2.0, 3.0); 5];
        assert_eq!(farthest_point_order(&points, 5), repose_geometry::sampling::farthest_point_order(&points, 5));
    }
}
