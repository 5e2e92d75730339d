//! A tiny ray caster for unit tests: boxes and a table seen by a pinhole camera without noise.

use repose_geometry::{Image, Isometry3, Pinhole, Point3, Vector3};

use crate::readings::point_map::{MISSING, PointMap};

/// An axis-aligned box in the world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Solid {
    center: Vector3<f64>,
    half: Vector3<f64>,
}

impl Solid {
    /// A box from its centre and half its edge lengths, metres.
    pub(crate) fn cuboid(center: [f64; 3], half: [f64; 3]) -> Self {
        Self { center: Vector3::from(center), half: Vector3::from(half) }
    }

    /// A table top of 2.4 m by 2.4 m at a height.
    pub(crate) fn table(height_m: f64) -> Self {
        Self::cuboid([0.0, 0.0, height_m - 0.01], [1.2, 1.2, 0.01])
    }

    /// Distance along the ray to the box (slab method).
    fn hit(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        let (mut near, mut far) = (0.0f64, f64::INFINITY);
        for k in 0..3 {
            let a = (self.center[k] - self.half[k] - origin[k]) / direction[k];
            let b = (self.center[k] + self.half[k] - origin[k]) / direction[k];
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        (near <= far && near > 0.0).then_some(near)
    }
}

/// Per pixel, the depth and the index of the solid seen.
pub(crate) fn cast(solids: &[Solid], camera: &Pinhole, world_from_camera: &Isometry3<f64>) -> Image<Option<(f64, usize)>> {
    let mut seen = Image::filled(camera.width, camera.height, None);
    let origin = Point3::from(world_from_camera.translation.vector);
    for v in 0..camera.height {
        for u in 0..camera.width {
            // A direction of unit z in the camera: the ray's parameter is the depth.
            let direction = world_from_camera * camera.unproject(u as f64, v as f64, 1.0).coords;
            let hits = solids.iter().enumerate().filter_map(|(i, s)| Some((s.hit(&origin, &direction)?, i)));
            seen[(u, v)] = hits.min_by(|a, b| a.0.total_cmp(&b.0));
        }
    }
    seen
}

/// The points seen, in the camera frame.
pub(crate) fn render(solids: &[Solid], camera: &Pinhole, world_from_camera: &Isometry3<f64>) -> PointMap {
    let seen = cast(solids, camera, world_from_camera);
    let mut points = PointMap::filled(camera.width, camera.height, MISSING);
    for v in 0..camera.height {
        for u in 0..camera.width {
            if let Some((depth, _)) = seen[(u, v)] {
                points[(u, v)] = camera.unproject(u as f64, v as f64, depth).cast();
            }
        }
    }
    points
}
