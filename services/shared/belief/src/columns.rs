//! What was observed above each small cell of the floor plan, as vertical runs: the map that support and collision are read from.
//!
//! A run is a stretch of height that one object's (or the furniture's) points fill without a larger gap. Its top may carry something,
//! its whole stretch is in the way of something. Runs that were not seen but must be there, because an object has a back, are marked.

use nalgebra::{Point2, Point3};
use repose_geometry::{Aabb, Footprint};

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
    origin: Point2<f32>,
    cell_m: f32,
    cells: [usize; 2],
    starts: Vec<u32>,
    runs: Vec<ColumnRun>,
    /// The highest top of each cell, −∞ without a run.
    tops: Vec<f32>,
    /// The highest top of each block of [`BLOCK`] × [`BLOCK`] cells, row by row.
    block_tops: Vec<f32>,
}

/// Cells along a side of a block.
const BLOCK: usize = 8;

impl ColumnMap {
    /// The runs of labelled points (world frame) within `bounds`; gaps in height up to `gap_m` are filled.
    pub fn of_points(points: &[[f32; 3]], labels: &[u16], bounds: &Aabb, cell_m: f32, gap_m: f32) -> Self {
        let origin = bounds.min.xy();
        let cells = cells_of_map(bounds, cell_m);
        let mut grid = Self::empty(origin, cell_m, cells);
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
        grid.index(runs);
        grid
    }

    /// The same map with runs added, each at a place in the world; those outside are dropped.
    #[must_use]
    pub fn with(&self, added: impl IntoIterator<Item = (Point2<f32>, ColumnRun)>) -> Self {
        let mut runs: Vec<(u32, ColumnRun)> = Vec::with_capacity(self.runs.len());
        for cell in 0..self.cells[0] * self.cells[1] {
            runs.extend(self.in_cell(cell).iter().map(|r| (cell as u32, *r)));
        }
        runs.extend(added.into_iter().filter_map(|(p, run)| self.cell_of(p.x, p.y).map(|cell| (cell as u32, run))));
        runs.sort_by_key(|(cell, _)| *cell);
        let mut grid = Self::empty(self.origin, self.cell_m, self.cells);
        grid.index(runs);
        grid
    }

    /// The runs above a place, none outside the map.
    pub fn at(&self, place: &Point2<f32>) -> &[ColumnRun] {
        self.cell_of(place.x, place.y).map_or(&[], |cell| self.in_cell(cell))
    }

    /// The highest top above a place and the runs there; −∞ and none outside the map.
    pub fn top_and_runs(&self, place: &Point2<f32>) -> (f32, &[ColumnRun]) {
        self.cell_of(place.x, place.y).map_or((f32::NEG_INFINITY, Default::default()), |cell| (self.tops[cell], self.in_cell(cell)))
    }

    /// No top within `reach_m` of a place is higher, seen from above; −∞ where nothing is. A broad phase: what is a block farther may count.
    pub fn top_around(&self, place: &Point2<f32>, reach_m: f32) -> f32 {
        let blocks = self.cells.map(|count| count.div_ceil(BLOCK));
        let block_m = self.cell_m * BLOCK as f32;
        let index = |along_m: f32, most: usize| ((along_m / block_m).floor().max(0.0) as usize).min(most);
        let range = |k: usize| {
            let along_m = place[k] - self.origin[k];
            // Outside the map there is nothing.
            let is_off = along_m + reach_m < 0.0 || along_m - reach_m > self.cells[k] as f32 * self.cell_m;
            (!is_off).then(|| index(along_m - reach_m, blocks[k] - 1)..=index(along_m + reach_m, blocks[k] - 1))
        };
        let (Some(columns), Some(rows)) = (range(0), range(1)) else { return f32::NEG_INFINITY };
        let tops = rows.flat_map(|row| &self.block_tops[row * blocks[0] + columns.start()..=row * blocks[0] + columns.end()]);
        tops.copied().fold(f32::NEG_INFINITY, f32::max)
    }

    /// Edge length of a cell, metres.
    pub fn cell_m(&self) -> f32 {
        self.cell_m
    }

    /// The centres of all cells whose centre lies in a rectangle of the floor plan, whether on the map or not; row by row.
    pub fn centers_within(&self, min: &Point2<f32>, max: &Point2<f32>) -> impl Iterator<Item = Point2<f32>> + use<> {
        let (origin, cell_m) = (self.origin, self.cell_m);
        let first = (min - origin).map(|v| (v / cell_m - 0.5).ceil() as i32);
        let last = (max - origin).map(|v| (v / cell_m - 0.5).floor() as i32);
        (first.y..=last.y)
            .flat_map(move |y| (first.x..=last.x).map(move |x| origin + nalgebra::Vector2::new(x as f32 + 0.5, y as f32 + 0.5) * cell_m))
    }

    fn in_cell(&self, cell: usize) -> &[ColumnRun] {
        &self.runs[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    fn cell_of(&self, x: f32, y: f32) -> Option<usize> {
        let (u, v) = ((x - self.origin.x) / self.cell_m, (y - self.origin.y) / self.cell_m);
        (u >= 0.0 && v >= 0.0 && u < self.cells[0] as f32 && v < self.cells[1] as f32).then(|| v as usize * self.cells[0] + u as usize)
    }

    /// Takes runs sorted by cell.
    fn index(&mut self, runs: Vec<(u32, ColumnRun)>) {
        let cells = self.cells[0] * self.cells[1];
        self.starts = vec![0; cells + 1];
        for (cell, _) in &runs {
            self.starts[*cell as usize + 1] += 1;
        }
        for cell in 0..cells {
            self.starts[cell + 1] += self.starts[cell];
        }
        self.runs = runs.into_iter().map(|(_, run)| run).collect();
        let [columns, rows] = self.cells;
        self.tops = (0..cells).map(|cell| self.in_cell(cell).iter().map(|run| run.high_m).fold(f32::NEG_INFINITY, f32::max)).collect();
        self.block_tops = vec![f32::NEG_INFINITY; columns.div_ceil(BLOCK) * rows.div_ceil(BLOCK)];
        for (cell, top_m) in self.tops.iter().enumerate() {
            let block = &mut self.block_tops[cell / columns / BLOCK * columns.div_ceil(BLOCK) + cell % columns / BLOCK];
            *block = block.max(*top_m);
        }
    }

    fn empty(origin: Point2<f32>, cell_m: f32, cells: [usize; 2]) -> Self {
        Self { origin, cell_m, cells, starts: Vec::new(), runs: Vec::new(), tops: Vec::new(), block_tops: Vec::new() }
    }
}

/// Cells along x and y of a map within bounds.
pub fn cells_of_map(bounds: &Aabb, cell_m: f32) -> [usize; 2] {
    [0, 1].map(|k| ((bounds.max[k] - bounds.min[k]) / cell_m).ceil().max(1.0) as usize)
}

/// The centres of the map's cells within an outline and a strip around it.
pub fn cells_of<'a>(outline: &'a Footprint, strip_m: f32, columns: &ColumnMap) -> impl Iterator<Item = Point2<f32>> + use<'a> {
    let corners = outline.corners();
    let (min, max) = corners.iter().fold((corners[0], corners[0]), |(min, max), c| (min.inf(c), max.sup(c)));
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
            assert!(columns.top_around(&place, 0.0) >= columns.top_and_runs(&place).0);
        }
        assert_eq!(columns.top_around(&Point2::new(2.0, 0.1), 0.1), f32::NEG_INFINITY);
        let low = Aabb { min: Point3::origin(), max: Point3::new(0.6, 0.3, 0.2) };
        let step = ColumnMap::of_points(&[[0.3, 0.1, 0.1], [0.01, 0.01, 0.0]], &[0, 0], &low, 0.005, 0.01);
        assert_eq!(step.top_around(&Point2::new(0.05, 0.1), 0.1), 0.0, "far from what is high");
    }
}
