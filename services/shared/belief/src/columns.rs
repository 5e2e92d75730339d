//! What was observed above each small cell of the floor plan, as vertical runs: the map that support and collision are read from.
//!
//! A run is a stretch of height that one object's (or the furniture's) points fill without a larger gap. Its top may carry something,
//! its whole stretch is in the way of something. Runs that were not seen but must be there, because an object has a back, are marked.

use nalgebra::{Point2, Point3};
use repose_geometry::{Aabb, Footprint};
use repose_simd::InstructionSet;

use crate::offsets::{Carry, Grid, Landing, Offsets};

/// A filled stretch of height above one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColumnRun {
    /// Lowest height, world z, metres.
    pub low_m: f32,
    /// Highest height, world z, metres.
    pub high_m: f32,
    /// The object whose it is, 0 for furniture.
    pub object: u16,
    /// Whether it was observed; otherwise it is the completed part of an object.
    pub seen: bool,
}

/// Runs by cell.
#[derive(Debug, Clone)]
pub struct ColumnMap {
    grid: Grid,
    instruction_set: InstructionSet,
    /// Where the runs of each cell begin; behind the last cell is one without runs, which everything off the map is in.
    starts: Vec<u32>,
    runs: Vec<ColumnRun>,
    /// The highest top of each cell, −∞ without a run.
    tops: Vec<f32>,
    /// The highest top of each block of [`BLOCK`] × [`BLOCK`] cells, row by row.
    block_tops: Vec<f32>,
}

/// Cells along a side of a block.
const BLOCK: usize = 8;

/// A cell of the map, or all that is off it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FloorCell(u32);

impl ColumnMap {
    /// The runs of labelled points (world frame) within `bounds`; gaps in height up to `gap_m` are filled.
    pub fn of_points(points: &[[f32; 3]], labels: &[u16], bounds: &Aabb, cell_m: f32, gap_m: f32) -> Self {
        let grid = Grid { origin: bounds.min.xy(), cell_m, cells: cells_of_map(bounds, cell_m) };
        let mut at: Vec<(u32, u16, f32)> =
            points.iter().zip(labels).filter_map(|(p, label)| grid.cell_of(p[0], p[1]).map(|cell| (cell as u32, *label, p[2]))).collect();
        at.sort_unstable_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)).then(a.2.total_cmp(&b.2)));
        let mut runs: Vec<(u32, ColumnRun)> = Vec::new();
        for (cell, object, z) in at {
            match runs.last_mut() {
                Some((c, run)) if *c == cell && run.object == object && z - run.high_m <= gap_m => run.high_m = z,
                _ => runs.push((cell, ColumnRun { low_m: z, high_m: z, object, seen: true })),
            }
        }
        Self::indexed(grid, runs)
    }

    /// The same map with runs added, each at a place in the world; those outside are dropped.
    #[must_use]
    pub fn with(&self, added: impl IntoIterator<Item = (Point2<f32>, ColumnRun)>) -> Self {
        let mut runs: Vec<(u32, ColumnRun)> = Vec::with_capacity(self.runs.len());
        for cell in 0..self.grid.count() {
            runs.extend(self.in_cell(cell).iter().map(|r| (cell as u32, *r)));
        }
        runs.extend(added.into_iter().filter_map(|(p, run)| self.grid.cell_of(p.x, p.y).map(|cell| (cell as u32, run))));
        runs.sort_by_key(|(cell, _)| *cell);
        Self::indexed(self.grid, runs)
    }

    /// The runs above a place, none outside the map.
    pub fn at(&self, place: &Point2<f32>) -> &[ColumnRun] {
        self.grid.cell_of(place.x, place.y).map_or(&[], |cell| self.in_cell(cell))
    }

    /// Visits the places that offsets are carried to, in order: the offset's number, the place, and its cell.
    #[inline]
    pub fn visit(&self, offsets: &Offsets, carry: &Carry, mut visit: impl FnMut(usize, Point2<f32>, FloorCell)) {
        let mut number = 0;
        for (block, count) in offsets.blocks() {
            let landed = self.instruction_set.run(Landing { block, carry, grid: &self.grid });
            for i in 0..count {
                visit(number, Point2::new(landed.x[i], landed.y[i]), FloorCell(landed.cells[i]));
                number += 1;
            }
        }
    }

    /// The highest top above a cell; −∞ without a run and off the map.
    #[inline]
    pub fn top_m(&self, cell: FloorCell) -> f32 {
        self.tops[cell.0 as usize]
    }

    /// The runs above a cell, none off the map.
    #[inline]
    pub fn runs(&self, cell: FloorCell) -> &[ColumnRun] {
        self.in_cell(cell.0 as usize)
    }

    /// No top within `reach_m` of a place is higher, seen from above; −∞ where nothing is. A broad phase: what is a block farther may count.
    pub fn top_around(&self, place: &Point2<f32>, reach_m: f32) -> f32 {
        let Grid { origin, cell_m, cells } = self.grid;
        let blocks = cells.map(|count| count.div_ceil(BLOCK));
        let block_m = cell_m * BLOCK as f32;
        let index = |along_m: f32, most: usize| ((along_m / block_m).floor().max(0.0) as usize).min(most);
        let range = |k: usize| {
            let along_m = place[k] - origin[k];
            // Outside the map there is nothing.
            let is_off = along_m + reach_m < 0.0 || along_m - reach_m > cells[k] as f32 * cell_m;
            (!is_off).then(|| index(along_m - reach_m, blocks[k] - 1)..=index(along_m + reach_m, blocks[k] - 1))
        };
        let (Some(columns), Some(rows)) = (range(0), range(1)) else { return f32::NEG_INFINITY };
        let tops = rows.flat_map(|row| &self.block_tops[row * blocks[0] + columns.start()..=row * blocks[0] + columns.end()]);
        tops.copied().fold(f32::NEG_INFINITY, f32::max)
    }

    /// Whether all that is within `reach_m` of a place, along x and y, is on the map.
    pub fn covers(&self, place: &Point2<f32>, reach_m: f32) -> bool {
        let Grid { origin, cell_m, cells } = self.grid;
        (0..2).all(|k| {
            let along_m = place[k] - origin[k];
            along_m >= reach_m && along_m + reach_m <= cells[k] as f32 * cell_m
        })
    }

    /// How many cells there are.
    pub fn cell_count(&self) -> usize {
        self.grid.count()
    }

    /// Edge length of a cell, metres.
    pub fn cell_m(&self) -> f32 {
        self.grid.cell_m
    }

    /// The centres of all cells whose centre lies in a rectangle of the floor plan, whether on the map or not; row by row.
    pub fn centers_within(&self, min: &Point2<f32>, max: &Point2<f32>) -> impl Iterator<Item = Point2<f32>> + use<> {
        let (first, last) = self.numbers_within(min, max);
        self.centers(first, last)
    }

    /// Those of them that are on the map.
    pub fn own_centers_within(&self, min: &Point2<f32>, max: &Point2<f32>) -> impl Iterator<Item = Point2<f32>> + use<> {
        let (first, last) = self.numbers_within(min, max);
        let most = Point2::from(self.grid.cells.map(|count| count as i32 - 1));
        self.centers(first.sup(&Point2::origin()), last.inf(&most))
    }

    /// The numbers along x and y of the first and of the last cell whose centre lies in a rectangle; negative before the map.
    fn numbers_within(&self, min: &Point2<f32>, max: &Point2<f32>) -> (Point2<i32>, Point2<i32>) {
        let Grid { origin, cell_m, .. } = self.grid;
        let number = |place: &Point2<f32>, round: fn(f32) -> f32| Point2::from((place - origin).map(|v| round(v / cell_m - 0.5) as i32));
        (number(min, f32::ceil), number(max, f32::floor))
    }

    /// The centres of the cells from one to another, row by row.
    fn centers(&self, first: Point2<i32>, last: Point2<i32>) -> impl Iterator<Item = Point2<f32>> + use<> {
        let Grid { origin, cell_m, .. } = self.grid;
        (first.y..=last.y)
            .flat_map(move |y| (first.x..=last.x).map(move |x| origin + nalgebra::Vector2::new(x as f32 + 0.5, y as f32 + 0.5) * cell_m))
    }

    #[inline]
    fn in_cell(&self, cell: usize) -> &[ColumnRun] {
        &self.runs[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// A map of runs that are sorted by cell.
    fn indexed(grid: Grid, runs: Vec<(u32, ColumnRun)>) -> Self {
        let cells = grid.count();
        let mut starts = vec![0; cells + 2];
        for (cell, _) in &runs {
            starts[*cell as usize + 1] += 1;
        }
        for cell in 0..=cells {
            starts[cell + 1] += starts[cell];
        }
        let runs = runs.into_iter().map(|(_, run)| run).collect();
        let mut map = Self { grid, instruction_set: InstructionSet::detect(), starts, runs, tops: Vec::new(), block_tops: Vec::new() };
        let [columns, rows] = grid.cells;
        map.tops = (0..=cells).map(|cell| map.in_cell(cell).iter().map(|run| run.high_m).fold(f32::NEG_INFINITY, f32::max)).collect();
        map.block_tops = vec![f32::NEG_INFINITY; columns.div_ceil(BLOCK) * rows.div_ceil(BLOCK)];
        for (cell, top_m) in map.tops[..cells].iter().enumerate() {
            let block = &mut map.block_tops[cell / columns / BLOCK * columns.div_ceil(BLOCK) + cell % columns / BLOCK];
            *block = block.max(*top_m);
        }
        map
    }
}

/// Cells along x and y of a map within bounds.
pub fn cells_of_map(bounds: &Aabb, cell_m: f32) -> [usize; 2] {
    [0, 1].map(|k| ((bounds.max[k] - bounds.min[k]) / cell_m).ceil().max(1.0) as usize)
}

/// The centres of the map's cells within an outline and a strip around it.
pub fn cells_of<'a>(outline: &'a Footprint, strip_m: f32, columns: &ColumnMap) -> impl Iterator<Item = Point2<f32>> + use<'a> {
    let (min, max) = outline.bounds();
    let strip = nalgebra::Vector2::repeat(strip_m);
    columns.centers_within(&(min - strip), &(max + strip)).filter(move |c| outline.margin(c) >= -strip_m)
}

/// The bounds of a map: around the objects, `reach_m` farther on each side, but not beyond the points.
pub fn bounds_around(objects: &[Point3<f32>], points: &[[f32; 3]], reach_m: f32) -> Option<Aabb> {
    let near = Aabb::of(objects)?.inflated(reach_m);
    let first = Point3::from(*points.first()?);
    let all = points.iter().fold(Aabb { min: first, max: first }, |b, p| {
        let p = Point3::from(*p);
        Aabb { min: b.min.inf(&p), max: b.max.sup(&p) }
    });
    Some(Aabb { min: near.min.sup(&all.min), max: near.max.inf(&all.max) })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn a_wall_is_one_run_and_a_shelf_above_a_table_is_two() {
        let mut points: Vec<[f32; 3]> = (0..50).map(|i| [0.0125, 0.0125, i as f32 * 0.002]).collect();
        points.extend([[0.0325, 0.0125, 0.0], [0.0325, 0.0125, 0.3]]);
        let labels = vec![0; points.len()];
        let bounds = Aabb { min: Point3::new(0.0, 0.0, 0.0), max: Point3::new(0.1, 0.1, 0.5) };
        let columns = ColumnMap::of_points(&points, &labels, &bounds, 0.005, 0.01);
        let wall = columns.at(&Point2::new(0.011, 0.014));
        assert_eq!(wall.len(), 1);
        assert!((wall[0].high_m - 0.098).abs() < 1e-6 && wall[0].low_m == 0.0);
        assert_eq!(columns.at(&Point2::new(0.0325, 0.0125)).len(), 2);
        assert!(columns.at(&Point2::new(0.5, 0.0)).is_empty());
        let more = columns.with([(Point2::new(0.0325, 0.0125), ColumnRun { low_m: 0.0, high_m: 0.1, object: 4, seen: false })]);
        assert_eq!(more.at(&Point2::new(0.0325, 0.0125)).len(), 3);
        assert_eq!(more.at(&Point2::new(0.011, 0.014)), wall);
    }

    #[test]
    fn no_top_is_higher_than_the_highest_around() {
        let mut rng = Pcg64::seed_from_u64(5);
        let points: Vec<[f32; 3]> =
            (0..400).map(|_| [rng.random_range(0.0..0.6), rng.random_range(0.0..0.3), rng.random_range(0.0..0.2)]).collect();
        let bounds = Aabb { min: Point3::new(0.0, 0.0, 0.0), max: Point3::new(0.6, 0.3, 0.2) };
        let columns = ColumnMap::of_points(&points, &vec![0; points.len()], &bounds, 0.005, 0.01);
        for _ in 0..300 {
            let place = Point2::new(rng.random_range(-0.2..0.8), rng.random_range(-0.2..0.5));
            let reach_m = rng.random_range(0.0..0.15);
            let around = points.iter().filter(|p| (Point2::new(p[0], p[1]) - place).norm() <= reach_m).map(|p| p[2]);
            let highest_m = around.fold(f32::NEG_INFINITY, f32::max);
            assert!(columns.top_around(&place, reach_m) >= highest_m, "{place} {reach_m}");
            columns.visit(&[Vector2::zeros()].into_iter().collect(), &Carry::new(place, 0.3), |_, at, cell| {
                assert_eq!(at, place);
                assert_eq!(columns.runs(cell), columns.at(&place));
                assert!(columns.top_around(&place, 0.0) >= columns.top_m(cell));
            });
        }
        assert_eq!(columns.top_around(&Point2::new(2.0, 0.1), 0.1), f32::NEG_INFINITY);
        let low = Aabb { min: Point3::origin(), max: Point3::new(0.6, 0.3, 0.2) };
        let step = ColumnMap::of_points(&[[0.3, 0.1, 0.1], [0.01, 0.01, 0.0]], &[0, 0], &low, 0.005, 0.01);
        assert_eq!(step.top_around(&Point2::new(0.05, 0.1), 0.1), 0.0, "far from what is high");
    }
}
