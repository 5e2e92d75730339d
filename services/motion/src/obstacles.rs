//! Whether a sphere touches the observed scene.
//!
//! The cloud is thinned to one point a voxel and sorted into the cells of a dense grid; beside it, every cell holds how far the nearest
//! occupied cell is at least. Most spheres of a moving arm are answered by that one number, the rest by a scan of the few cells they reach.
//! Support surfaces count as solid slabs, so that holes of the cloud (behind and under objects) do not let the arm through the table.

use nalgebra::{Point2, Point3, Vector3};
use repose_geometry::{Aabb, cloud};

use crate::scene::SupportSurface;

/// How the obstacles are built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObstacleSettings {
    /// Edge of the voxels that the cloud is thinned to, metres; larger is faster and less exact. Default 0.005.
    pub voxel_m: f32,
    /// Edge of the grid's cells, metres. Default 0.02.
    pub cell_m: f32,
    /// How deep a support surface of the furniture is solid, metres. Default 0.05.
    pub surface_depth_m: f64,
    /// Points this near to a support surface of the furniture are taken for its noise: the surface stands for them, metres. Default 0.008.
    pub surface_noise_m: f64,
}

impl Default for ObstacleSettings {
    fn default() -> Self {
        Self { voxel_m: 0.005, cell_m: 0.02, surface_depth_m: 0.05, surface_noise_m: 0.008 }
    }
}

/// How many cells away an occupied cell is looked for; beyond, a cell is free as far as that.
const GAP_CELLS: usize = 7;
/// The most cells of the grid. A cloud that spans more gets larger cells.
const CELLS_MAX: usize = 1 << 21;

/// The observed scene, ready for questions.
#[derive(Debug, Clone)]
pub struct Obstacles {
    slabs: Vec<Slab>,
    grid: Option<CellGrid>,
}

#[derive(Debug, Clone)]
struct Slab {
    surface: SupportSurface,
    depth_m: f64,
}

impl Obstacles {
    /// The obstacles of a cloud and its support surfaces, both in the world frame.
    pub fn new(points: &[Point3<f32>], surfaces: &[SupportSurface], settings: &ObstacleSettings) -> Self {
        // An object's top is backed by its own points only: it may be the lid of something hollow.
        let depth_m = |s: &SupportSurface| if s.object.is_some() { 0.0 } else { settings.surface_depth_m };
        let slabs = surfaces.iter().map(|s| Slab { surface: s.clone(), depth_m: depth_m(s) }).collect();
        let furniture: Vec<&SupportSurface> = surfaces.iter().filter(|s| s.object.is_none()).collect();
        let is_noise = |p: &Point3<f32>| {
            let near = |s: &&&SupportSurface| (f64::from(p.z) - s.height_m).abs() < settings.surface_noise_m;
            furniture.iter().filter(near).any(|s| s.footprint.margin(&p.xy()) >= 0.0)
        };
        let standing: Vec<Point3<f32>> = points.iter().filter(|p| !is_noise(p)).copied().collect();
        Self { slabs, grid: CellGrid::new(&cloud::voxel_downsampled(&standing, settings.voxel_m), settings.cell_m) }
    }

    /// Whether anything lies within `radius_m` of `center`, both in the world frame.
    pub fn touches(&self, center: &Point3<f64>, radius_m: f64) -> bool {
        self.slabs.iter().any(|slab| slab.touches(center, radius_m)) || self.touches_points(center, radius_m)
    }

    /// Whether any observed point lies within `radius_m` of `center`: support surfaces do not count.
    pub fn touches_points(&self, center: &Point3<f64>, radius_m: f64) -> bool {
        self.grid.as_ref().is_some_and(|grid| grid.touches(&center.cast::<f32>(), radius_m as f32))
    }
}

impl Slab {
    fn touches(&self, center: &Point3<f64>, radius_m: f64) -> bool {
        let above_m = center.z - self.surface.height_m;
        above_m < radius_m
            && above_m > -(radius_m + self.depth_m)
            && f64::from(self.surface.footprint.margin(&Point2::new(center.x as f32, center.y as f32))) > -radius_m
    }
}

/// Points sorted into cells, with the gap from each cell to the nearest occupied one.
#[derive(Debug, Clone)]
struct CellGrid {
    bounds: Aabb,
    cell_m: f32,
    size: [usize; 3],
    /// First point of each cell; one more entry than cells.
    starts: Vec<u32>,
    points: Vec<Point3<f32>>,
    /// No point lies nearer to any place in the cell than this, metres.
    gaps_m: Vec<f32>,
}

impl CellGrid {
    fn new(points: &[Point3<f32>], wanted_cell_m: f32) -> Option<Self> {
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
        let mut grid = Self { bounds, cell_m, size, starts: Vec::new(), points: Vec::new(), gaps_m: Vec::new() };
        let cells: Vec<usize> = points.iter().map(|p| grid.index(grid.cell_of(p))).collect();
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        order.sort_by_key(|i| cells[*i as usize]);
        grid.points = order.iter().map(|i| points[*i as usize]).collect();
        grid.starts = vec![0; size.iter().product::<usize>() + 1];
        cells.iter().for_each(|c| grid.starts[c + 1] += 1);
        (1..grid.starts.len()).for_each(|i| grid.starts[i] += grid.starts[i - 1]);
        grid.gaps_m = grid.gaps();
        Some(grid)
    }

    fn touches(&self, center: &Point3<f32>, radius_m: f32) -> bool {
        if !self.bounds.contains(center) {
            // The border is wider than any sphere of the arm; a larger one would need the scan.
            return radius_m > GAP_CELLS as f32 * self.cell_m && self.scan(center, radius_m);
        }
        self.gaps_m[self.index(self.cell_of(center))] <= radius_m && self.scan(center, radius_m)
    }

    fn scan(&self, center: &Point3<f32>, radius_m: f32) -> bool {
        let reach = Vector3::repeat(radius_m);
        let (low, high) = (self.cell_of(&(center - reach)), self.cell_of(&(center + reach)));
        let limit = radius_m * radius_m;
        (low[0]..=high[0]).any(|x| {
            (low[1]..=high[1]).any(|y| {
                // Cells along z follow each other, so a column of them is one run of points.
                let run = self.starts[self.index([x, y, low[2]])]..self.starts[self.index([x, y, high[2]]) + 1];
                self.points[run.start as usize..run.end as usize].iter().any(|p| (p - center).norm_squared() <= limit)
            })
        })
    }

    /// The cell of a place; places outside the grid get the nearest cell.
    fn cell_of(&self, p: &Point3<f32>) -> [usize; 3] {
        [0, 1, 2].map(|k| (((p[k] - self.bounds.min[k]) / self.cell_m).max(0.0) as usize).min(self.size[k] - 1))
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn spheres_touch_what_a_linear_scan_finds(
            raw in prop::collection::vec(prop::array::uniform3(-0.3..0.3f32), 1..60),
            centers in prop::collection::vec(prop::array::uniform3(-0.6..0.6f64), 20), radius in 0.005..0.1f64,
        ) {
            let points: Vec<Point3<f32>> = raw.into_iter().map(Point3::from).collect();
            let obstacles = Obstacles::new(&points, &[], &ObstacleSettings { voxel_m: 1e-4, ..ObstacleSettings::default() });
            for center in centers.into_iter().map(Point3::from) {
                let nearest = points.iter().map(|p| (p.cast::<f64>() - center).norm()).fold(f64::INFINITY, f64::min);
                if (nearest - radius).abs() > 2e-4 {
                    prop_assert_eq!(obstacles.touches(&center, radius), nearest < radius);
                }
            }
        }
    }

    #[test]
    fn a_surface_is_solid_where_the_cloud_has_a_hole() {
        let outline = [[0.2, -0.4], [0.8, -0.4], [0.8, 0.4], [0.2, 0.4]].map(Point2::from);
        let table = SupportSurface::new(0.0, &outline, None).unwrap();
        let obstacles = Obstacles::new(&[], &[table], &ObstacleSettings::default());
        assert!(obstacles.touches(&Point3::new(0.5, 0.0, 0.02), 0.03));
        assert!(obstacles.touches(&Point3::new(0.5, 0.0, -0.03), 0.01), "inside the table top");
        assert!(!obstacles.touches(&Point3::new(0.5, 0.0, 0.04), 0.03));
        assert!(!obstacles.touches(&Point3::new(0.0, 0.0, 0.0), 0.05), "beside the table");
        assert!(!obstacles.touches_points(&Point3::new(0.5, 0.0, 0.0), 0.05));
    }
}
