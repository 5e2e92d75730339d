//! A cloud made for questions by spheres: points sorted into cells, and how far each cell is from the nearest occupied one.
//!
//! Most spheres of a moving arm are answered by that one number, which the lanes of a vector fetch for all their configurations at once; the
//! rest scan the few cells they reach. Chosen over a tree because a fetch has no branches, and over a full distance field because it is built in
//! a few milliseconds for every scene.

use nalgebra::{Point3, Vector3};
use repose_geometry::Aabb;
use repose_simd::{Lanes, Plain};

/// How many cells away an occupied cell is looked for; beyond, a cell is free as far as that.
const GAP_CELLS: usize = 7;
/// The most cells of the grid; fewer than 2²⁴, so that an index is exact in single precision. A cloud that spans more gets larger cells.
const CELLS_MAX: usize = 1 << 21;
/// As many as the most lanes of a vector: a vector that begins at the last point ends within them.
const PADDING: usize = 16;

/// Points sorted into cells, with the gap from each cell to the nearest occupied one.
#[derive(Debug, Clone)]
pub(super) struct CellGrid {
    bounds: Aabb,
    cell_m: f32,
    size: [usize; 3],
    /// First point of each cell; one more entry than cells.
    starts: Vec<u32>,
    /// The points' coordinates, an axis each, with [`PADDING`] places that nothing is near at the end.
    along: [Vec<f32>; 3],
    /// No point lies nearer to any place in the cell than this, metres.
    gaps_m: Vec<f32>,
}

impl CellGrid {
    /// The grid of a cloud; nothing for an empty one.
    pub(super) fn new(points: &[Point3<f32>], wanted_cell_m: f32) -> Option<Self> {
        // A border of one gap on every side lets places around the cloud be answered by their cell too.
        let tight = Aabb::of(points)?;
        let mut cell_m = wanted_cell_m;
        let (bounds, size) = loop {
            let bounds = tight.inflated(cell_m * (GAP_CELLS as f32 + 0.5));
            let size = [0, 1, 2].map(|k| (bounds.extent()[k] / cell_m).ceil() as usize + 1);
            if size.iter().try_fold(1usize, |n, s| n.checked_mul(*s)).is_some_and(|n| n <= CELLS_MAX) {
                break (bounds, size);
            }
            cell_m *= 1.5;
        };
        let mut grid = Self { bounds, cell_m, size, starts: Vec::new(), along: Default::default(), gaps_m: Vec::new() };
        let cells: Vec<usize> = points.iter().map(|p| grid.index(grid.cell_of(p))).collect();
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        order.sort_by_key(|i| cells[*i as usize]);
        for (k, along) in grid.along.iter_mut().enumerate() {
            *along = order.iter().map(|i| points[*i as usize][k]).chain([f32::INFINITY; PADDING]).collect();
        }
        grid.starts = vec![0; size.iter().product::<usize>() + 1];
        cells.iter().for_each(|c| grid.starts[c + 1] += 1);
        (1..grid.starts.len()).for_each(|i| grid.starts[i] += grid.starts[i - 1]);
        grid.gaps_m = grid.gaps();
        Some(grid)
    }

    /// Whether a point lies within `radius_m` of `center`.
    pub(super) fn touches(&self, center: &Point3<f32>, radius_m: f32) -> bool {
        // SAFETY: every machine has the plain lanes.
        let scan = || unsafe { self.scan::<Plain>(center, radius_m) };
        if !self.bounds.contains(center) {
            // The border is wider than any sphere of the arm; a larger one would need the scan.
            return radius_m > GAP_CELLS as f32 * self.cell_m && scan();
        }
        self.gaps_m[self.index(self.cell_of(center))] <= radius_m && scan()
    }

    /// A distance, for the place in each lane, within which there is no point.
    ///
    /// # Safety
    /// The instruction set of `S` must be present.
    #[inline(always)]
    pub(super) unsafe fn gap<S: Lanes>(&self, place: &[S::V; 3]) -> S::V {
        // SAFETY: by this function's contract; each coordinate is brought within the grid, so the index lies within `gaps_m`.
        unsafe {
            let mut index = S::splat(0.0);
            for (k, along) in place.iter().enumerate() {
                let from = S::mul(S::sub(*along, S::splat(self.bounds.min[k])), S::splat(1.0 / self.cell_m));
                let within = S::min(S::max(from, S::splat(0.0)), S::splat((self.size[k] - 1) as f32));
                index = S::fma(index, S::splat(self.size[k] as f32), S::truncate(within));
            }
            S::gather(self.gaps_m.as_ptr(), index)
        }
    }

    /// Whether a point lies within `radius_m` of `center`, by looking at all cells around.
    ///
    /// # Safety
    /// The instruction set of `S` must be present.
    #[inline(always)]
    pub(super) unsafe fn scan<S: Lanes>(&self, center: &Point3<f32>, radius_m: f32) -> bool {
        let reach = Vector3::repeat(radius_m);
        let (low, high) = (self.cell_of(&(center - reach)), self.cell_of(&(center + reach)));
        // SAFETY: by this function's contract; a run begins before the padding, so that a vector from any place of it ends within it.
        unsafe {
            let (limit, beyond) = (S::splat(radius_m * radius_m), u32::MAX >> (32 - S::COUNT));
            let middle = [S::splat(center.x), S::splat(center.y), S::splat(center.z)];
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    // Cells along z follow each other, so a column of them is one run of points.
                    let column = self.index([x, y, 0]);
                    let (mut first, end) = (self.starts[column + low[2]] as usize, self.starts[column + high[2] + 1] as usize);
                    while first < end {
                        let mut squared = S::splat(0.0);
                        for (along, middle) in self.along.iter().zip(middle) {
                            let apart = S::sub(S::load(along.as_ptr().add(first)), middle);
                            squared = S::add(squared, S::mul(apart, apart));
                        }
                        // What follows the run are points of other cells: they count as well.
                        if S::less(limit, squared) != beyond {
                            return true;
                        }
                        first += S::COUNT;
                    }
                }
            }
        }
        false
    }

    /// The cell of a place; places outside the grid get the nearest cell.
    #[inline(always)]
    fn cell_of(&self, p: &Point3<f32>) -> [usize; 3] {
        let mut cell = [0; 3];
        for (k, cell) in cell.iter_mut().enumerate() {
            let along = ((p[k] - self.bounds.min[k]) * (1.0 / self.cell_m)).max(0.0).min((self.size[k] - 1) as f32);
            // SAFETY: from 0, which is what is no number has become, to the largest index.
            *cell = unsafe { along.to_int_unchecked::<i32>() } as usize;
        }
        cell
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (x * self.size[1] + y) * self.size[2] + z
    }

    /// Between cells `n` apart along an axis lie `n − 1` whole ones; the squares of these gaps add up over the axes, so one pass an axis
    /// finds the smallest sum.
    fn gaps(&self) -> Vec<f32> {
        let limit = (GAP_CELLS * GAP_CELLS) as u32;
        let mut squares: Vec<u32> = self.starts.windows(2).map(|w| if w[1] > w[0] { 0 } else { limit }).collect();
        let strides = [self.size[1] * self.size[2], self.size[2], 1];
        // Along z first: there lines lie together in memory, and most of them hold nothing and are passed over.
        for (stride, length) in strides.into_iter().zip(self.size).rev() {
            let mut line = vec![limit; length];
            for outer in (0..squares.len()).step_by(stride * length) {
                for first in outer..outer + stride {
                    let near = (0..length).filter(|k| squares[first + k * stride] < limit);
                    let near: Vec<(usize, u32)> = near.map(|k| (k, squares[first + k * stride])).collect();
                    if near.is_empty() {
                        continue;
                    }
                    line.fill(limit);
                    for (k, square) in near {
                        let low = k.saturating_sub(GAP_CELLS);
                        for (j, nearest) in (low..=k + GAP_CELLS).zip(&mut line[low..]) {
                            *nearest = (*nearest).min(square + (k.abs_diff(j).saturating_sub(1) as u32).pow(2));
                        }
                    }
                    (0..length).for_each(|k| squares[first + k * stride] = line[k]);
                }
            }
        }
        squares.into_iter().map(|s| (s as f32).sqrt() * self.cell_m).collect()
    }
}
