//! Whether spheres touch what is in the world: the observed cloud with its support surfaces, or known solids.
//!
//! Support surfaces count as solid slabs, so that holes of the cloud (behind and under objects) do not let the arm through the table. Questions
//! come for one sphere in double precision, and for the spheres of many configurations in the lanes of a vector.

mod cell_grid;
mod shape;

use nalgebra::Point3;
use repose_geometry::cloud;
use repose_simd::Lanes;

use crate::scene::SupportArea;
use cell_grid::CellGrid;
pub use shape::ObstacleShape;

/// How the obstacles are built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObstacleSettings {
    /// Edge of the voxels that the cloud is thinned to, metres; larger is faster and less exact. Default 0.005.
    pub voxel_m: f32,
    /// Edge of the grid's cells, metres. Default 0.02.
    pub cell_m: f32,
    /// How deep a support surface of the furniture is solid at least, metres. Default 0.05.
    pub surface_depth_m: f64,
    /// Points this near to a support surface of the furniture are taken for its noise: the surface stands for them, metres. Default 0.008.
    pub surface_noise_m: f64,
}

impl Default for ObstacleSettings {
    fn default() -> Self {
        Self { voxel_m: 0.005, cell_m: 0.02, surface_depth_m: 0.05, surface_noise_m: 0.008 }
    }
}

/// What is in the world, ready for questions.
#[derive(Debug, Clone)]
pub struct Obstacles {
    shapes: Vec<ObstacleShape>,
    /// Where the keep-out zones begin among them.
    first_zone: usize,
    grid: Option<CellGrid>,
}

impl Obstacles {
    /// The obstacles of a cloud and its support surfaces, both in the world frame.
    pub fn new(points: &[Point3<f32>], surfaces: &[SupportArea], settings: &ObstacleSettings) -> Self {
        // An object's top is backed by its own points only: it may be the lid of something hollow.
        let unknown_m = |s: &SupportArea| if s.object.is_some() { 0.0 } else { settings.surface_depth_m };
        let depth_m = |s: &SupportArea| s.depth_m.unwrap_or(unknown_m(s)).max(unknown_m(s));
        let shapes: Vec<ObstacleShape> =
            surfaces.iter().map(|s| ObstacleShape::slab(s.footprint.clone(), s.height_m, depth_m(s))).collect();
        let furniture: Vec<&SupportArea> = surfaces.iter().filter(|s| s.object.is_none()).collect();
        let is_noise = |p: &Point3<f32>| {
            let near = |s: &&&SupportArea| (f64::from(p.z) - s.height_m).abs() < settings.surface_noise_m;
            furniture.iter().filter(near).any(|s| s.footprint.margin(&p.xy()) >= 0.0)
        };
        let standing: Vec<Point3<f32>> = points.iter().filter(|p| !is_noise(p)).copied().collect();
        Self {
            first_zone: shapes.len(),
            shapes,
            grid: CellGrid::new(&cloud::voxel_downsampled(&standing, settings.voxel_m), settings.cell_m),
        }
    }

    /// Known solids.
    pub fn solids(shapes: Vec<ObstacleShape>) -> Self {
        Self { first_zone: shapes.len(), shapes, grid: None }
    }

    /// The same with known solids beside what was seen.
    #[must_use]
    pub fn with_solids(mut self, solids: &[ObstacleShape]) -> Self {
        self.shapes.splice(self.first_zone..self.first_zone, solids.iter().cloned());
        self.first_zone += solids.len();
        self
    }

    /// The same with zones that the arm must keep out of, as solid as the rest.
    #[must_use]
    pub fn with_keep_out(mut self, zones: &[ObstacleShape]) -> Self {
        self.shapes.truncate(self.first_zone);
        self.shapes.extend_from_slice(zones);
        self
    }

    /// The first keep-out zone, from 0, that lies within `radius_m` of `center`.
    pub fn zone_touched(&self, center: &Point3<f64>, radius_m: f64) -> Option<usize> {
        self.shapes[self.first_zone..].iter().position(|zone| zone.distance_m(center) < radius_m)
    }

    /// The solids, support surfaces among them.
    pub fn shapes(&self) -> &[ObstacleShape] {
        &self.shapes
    }

    /// Whether anything lies within `radius_m` of `center`, both in the world frame.
    pub fn touches(&self, center: &Point3<f64>, radius_m: f64) -> bool {
        self.shapes.iter().any(|shape| shape.distance_m(center) < radius_m) || self.touches_points(center, radius_m)
    }

    /// Whether any observed point lies within `radius_m` of `center`: support surfaces do not count.
    pub fn touches_points(&self, center: &Point3<f64>, radius_m: f64) -> bool {
        self.grid.as_ref().is_some_and(|grid| grid.touches(&center.cast::<f32>(), radius_m as f32))
    }

    /// The lanes in which an observed point may lie within `radius_m` of the place; the others have none.
    ///
    /// # Safety
    /// The instruction set of `S` must be present.
    #[inline(always)]
    pub(crate) unsafe fn near_points<S: Lanes>(&self, place: &[S::V; 3], radius_m: f32) -> u32 {
        let Some(grid) = &self.grid else { return 0 };
        // SAFETY: by this function's contract.
        unsafe { S::less(grid.gap::<S>(place), S::splat(radius_m)) }
    }

    /// Whether an observed point lies within `radius_m` of the place, where [`Self::near_points`] could not rule it out.
    ///
    /// # Safety
    /// The instruction set of `S` must be present.
    #[inline(always)]
    pub(crate) unsafe fn has_point_within<S: Lanes>(&self, place: &Point3<f32>, radius_m: f32) -> bool {
        let Some(grid) = &self.grid else { return false };
        // SAFETY: by this function's contract.
        unsafe { grid.scan::<S>(place, radius_m) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point2;
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
        let table = SupportArea::new(0.0, &outline, None).unwrap();
        let obstacles = Obstacles::new(&[], &[table], &ObstacleSettings::default());
        assert!(obstacles.touches(&Point3::new(0.5, 0.0, 0.02), 0.03));
        assert!(obstacles.touches(&Point3::new(0.5, 0.0, -0.03), 0.01), "inside the table top");
        assert!(!obstacles.touches(&Point3::new(0.5, 0.0, 0.04), 0.03));
        assert!(!obstacles.touches(&Point3::new(0.0, 0.0, 0.0), 0.05), "beside the table");
        assert!(!obstacles.touches_points(&Point3::new(0.5, 0.0, 0.0), 0.05));
    }
}
