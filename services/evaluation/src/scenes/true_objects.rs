//! The true surfaces and shapes of a scene's objects.

use nalgebra::{Isometry3, Point2, Point3, Vector2, Vector3};
use repose_belief::shape::{Shape, Slab};
use repose_geometry::{Aabb, Footprint};
use repose_simulator::contact::PlacedParts;
use repose_simulator::scene::SceneObject;

/// Edge of the cells in which outlines and volumes are compared, metres.
pub(crate) const CELL_M: f32 = 0.004;
/// Height of a prism, metres, …
const SLAB_M: f32 = 0.015;
/// … of which there are at most so many.
const MAX_SLABS: usize = 8;
/// What is this far above an object's lowest point touches what it stands on, metres.
const BASE_M: f32 = 0.006;

/// The corners of an object's true surface, world frame, metres.
pub fn true_corners(object: &SceneObject) -> Vec<Point3<f32>> {
    let pose: Isometry3<f32> = object.world_from_object.cast();
    object.shape.mesh.vertices.iter().map(|v| pose * v).collect()
}

/// The middles of the cells of a box.
pub(crate) fn cells(bounds: &Aabb) -> impl Iterator<Item = Point3<f32>> {
    let low = bounds.min;
    let [nx, ny, nz] = [0, 1, 2].map(|k| ((bounds.extent()[k] / CELL_M).ceil() as usize).max(1));
    let at = move |k: usize, i: usize| low[k] + (i as f32 + 0.5) * CELL_M;
    (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| Point3::new(at(0, x), at(1, y), at(2, z)))))
}

/// The true shape of an object of which the points that were seen have a centroid; none of one that is smaller than a cell.
pub(crate) fn true_shape(object: &SceneObject, centroid: Point3<f64>) -> Option<Shape> {
    let bounds = Aabb::of(&true_corners(object))?;
    let solid = PlacedParts::new(&object.shape.parts, &object.world_from_object)?;
    let filled: Vec<Point3<f32>> = cells(&bounds).filter(|cell| solid.contains(cell)).collect();
    let middle = filled.iter().map(|p| p.coords).sum::<Vector3<f32>>() / filled.len().max(1) as f32;
    let (bottom_m, top_m) = (bounds.min.z, bounds.max.z);
    let outline = |low_m: f32, high_m: f32| {
        let within = filled.iter().filter(|p| (low_m..=high_m).contains(&p.z));
        let corners = [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]].map(|[x, y]| Vector3::new(x, y, 0.0) * (CELL_M / 2.0));
        Footprint::of(&within.flat_map(|p| corners.map(|corner| p + corner)).collect::<Vec<_>>())
    };
    let count = (((top_m - bottom_m) / SLAB_M) as usize).clamp(1, MAX_SLABS);
    let height_m = |k: usize| bottom_m + (top_m - bottom_m) * k as f32 / count as f32;
    let slab = |k: usize| Some(Slab::of(height_m(k), height_m(k + 1), outline(height_m(k), height_m(k + 1))?));
    let base = outline(bottom_m, bottom_m + BASE_M)?;
    Some(Shape {
        centroid,
        axis: Point2::from(middle.xy()),
        turn_axis: Point2::from(middle.xy()),
        bottom_m,
        top_m,
        slabs: (0..count).map(slab).collect::<Option<_>>()?,
        turn_base: base.clone(),
        base,
        doubt: Vector2::zeros(),
        ends: Vec::new(),
        foot_probability: 1.0,
        foot_doubt_m: 0.0,
        landing_probability: 1.0,
    })
}
