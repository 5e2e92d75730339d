//! A uniform grid over a cloud for neighbours within a radius.
//!
//! Cells are sorted runs of point indices, so that a query visits points in index order within a cell and cells in a fixed order:
//! the same cloud and query give the same result, which the deterministic planner needs.

use foldhash::{HashMap, HashMapExt};
use nalgebra::Point3;

/// Points hashed into cubic cells.
#[derive(Debug, Clone)]
pub struct PointGrid {
    cell_m: f32,
    points: Vec<Point3<f32>>,
    cells: HashMap<[i32; 3], Vec<u32>>,
}

impl PointGrid {
    /// A grid whose cells have edge `cell_m`; queries are fastest for radii near it.
    ///
    /// # Panics
    /// When `cell_m` is not positive: a program error, not an input.
    pub fn new(points: Vec<Point3<f32>>, cell_m: f32) -> Self {
        assert!(cell_m > 0.0, "cell size must be positive, got {cell_m}");
        let mut cells: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
        for (i, p) in points.iter().enumerate() {
            cells.entry(cell_of(p, cell_m)).or_default().push(i as u32);
        }
        Self { cell_m, points, cells }
    }

    /// The points, in the order given.
    pub fn points(&self) -> &[Point3<f32>] {
        &self.points
    }

    /// Calls `visit(index, squared distance)` for every point within `radius_m` of `center`.
    pub fn for_each_within(&self, center: &Point3<f32>, radius_m: f32, mut visit: impl FnMut(u32, f32)) {
        let low = cell_of(&(center - nalgebra::Vector3::repeat(radius_m)), self.cell_m);
        let high = cell_of(&(center + nalgebra::Vector3::repeat(radius_m)), self.cell_m);
        let limit = radius_m * radius_m;
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    for &i in self.cells.get(&[x, y, z]).map_or(&[][..], Vec::as_slice) {
                        let d = (self.points[i as usize] - center).norm_squared();
                        if d <= limit {
                            visit(i, d);
                        }
                    }
                }
            }
        }
    }

    /// The distance to the nearest point, or `None` when none lies within `limit_m`.
    pub fn nearest_distance(&self, center: &Point3<f32>, limit_m: f32) -> Option<f32> {
        let mut best = f32::INFINITY;
        self.for_each_within(center, limit_m, |_, d| best = best.min(d));
        best.is_finite().then(|| best.sqrt())
    }
}

/// The index along each axis of the cube of edge `edge_m` in which a place lies; beyond what an index can say it is that of the outermost cube.
pub(crate) fn cell_of(p: &Point3<f32>, edge_m: f32) -> [i32; 3] {
    // Without `floor`, which is a call where the target's vectors cannot round.
    let below = |along: f32| {
        let towards_zero = along as i32;
        towards_zero.saturating_sub(i32::from((towards_zero as f32) > along))
    };
    [below(p.x / edge_m), below(p.y / edge_m), below(p.z / edge_m)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_cell_of_a_place_is_the_one_below_it(p in prop::array::uniform3(-3e4..3e4f32), edge_m in 0.001..0.1f32) {
            prop_assert_eq!(cell_of(&Point3::from(p), edge_m), p.map(|along| (along / edge_m).floor() as i32));
        }

        #[test]
        fn it_finds_what_a_linear_scan_finds(
            raw in prop::collection::vec(prop::array::uniform3(-0.3..0.3f32), 1..80),
            c in prop::array::uniform3(-0.3..0.3f32), radius in 0.01..0.2f32,
        ) {
            let points: Vec<_> = raw.into_iter().map(Point3::from).collect();
            let center = Point3::from(c);
            let mut expected: Vec<u32> =
                (0..points.len() as u32).filter(|&i| (points[i as usize] - center).norm_squared() <= radius * radius).collect();
            let mut found = Vec::new();
            PointGrid::new(points, 0.05).for_each_within(&center, radius, |i, _| found.push(i));
            found.sort_unstable();
            expected.sort_unstable();
            prop_assert_eq!(found, expected);
        }
    }
}
