//! What a planner would be given if a camera saw everything: points all over the true shapes, and no unseen space.

use std::collections::BTreeMap;

use nalgebra::Point3;
use repose_geometry::{Aabb, TriMesh};
use repose_proto::{ObjectSummary, Scene, Surface, Unseen};
use repose_simulator::scene::SimulatedScene;

/// Spacing of points on an object and on furniture, metres.
const OBJECT_M: f32 = 0.004;
const FURNITURE_M: f64 = 0.005;

/// The true table as a scene, in the observed one's place.
pub fn true_scene(truth: &SimulatedScene, observed: &Scene) -> Scene {
    let mut scene = observed.clone();
    (scene.points, scene.labels, scene.colors) = (Vec::new(), Vec::new(), None);
    (scene.meta.objects, scene.meta.surfaces, scene.meta.left_out) = (Vec::new(), Vec::new(), Vec::new());
    scene.meta.unseen = Unseen::default();
    for surface in &truth.surfaces {
        let half_m = surface.half_extents_m;
        let steps = half_m.map(|half| (half / FURNITURE_M) as i32);
        for (i, j) in (-steps.x..=steps.x).flat_map(|i| (-steps.y..=steps.y).map(move |j| (i, j))) {
            let at = surface.world_from_surface * Point3::new(f64::from(i) * FURNITURE_M, f64::from(j) * FURNITURE_M, 0.0);
            scene.points.push(at.cast::<f32>().coords.into());
            scene.labels.push(0);
        }
        let corner = |x: f64, y: f64| (surface.world_from_surface * Point3::new(x * half_m.x, y * half_m.y, 0.0)).xy();
        let outline_m = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| corner(x, y).coords.into()).to_vec();
        scene.meta.surfaces.push(Surface { height_m: surface.height_m(), outline_m, area_m2: 4.0 * half_m.product(), object: None });
    }
    for object in &truth.objects {
        let points = spread(&object.shape.mesh.transformed(&object.world_from_object.cast()));
        scene.labels.extend(points.iter().map(|_| object.id));
        scene.points.extend(points.iter().map(|p| <[f32; 3]>::from(p.coords)));
        let count = points.len().max(1) as f64;
        let centroid_m = points.iter().fold(nalgebra::Vector3::zeros(), |sum, p| sum + p.coords.cast::<f64>()) / count;
        let extent_m = Aabb::of(points.iter()).map_or([0.0; 3], |b| (b.max - b.min).cast::<f64>().into());
        let summary =
            ObjectSummary { id: object.id, points: points.len(), centroid_m: centroid_m.into(), extent_m, completeness: 1.0, score: None };
        scene.meta.objects.push(summary);
        if let Some(top) = object.shape.top {
            let [cx, cy] = top.center_m.map(f64::from);
            let [hx, hy] = top.half_extents_m.map(f64::from);
            let corner = |x: f64, y: f64| object.world_from_object * Point3::new(cx + x * hx, cy + y * hy, f64::from(top.height_m));
            let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| corner(x, y));
            let outline_m = corners.map(|c| [c.x, c.y]).to_vec();
            scene.meta.surfaces.push(Surface { height_m: corners[0].z, outline_m, area_m2: 4.0 * hx * hy, object: Some(object.id) });
        }
    }
    scene
}

/// Points all over a mesh, one to a cube of [`OBJECT_M`]: meshes have large triangles and small ones.
fn spread(mesh: &TriMesh) -> Vec<Point3<f32>> {
    let mut cells: BTreeMap<[i32; 3], Point3<f32>> = BTreeMap::new();
    for i in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(i);
        let steps = ((b - a).norm().max((c - a).norm()).max((c - b).norm()) / (0.7 * OBJECT_M)).ceil().max(1.0) as i32;
        for (j, k) in (0..=steps).flat_map(|j| (0..=steps - j).map(move |k| (j, k))) {
            let p = a + (b - a) * (j as f32 / steps as f32) + (c - a) * (k as f32 / steps as f32);
            cells.entry(p.coords.map(|v| (v / OBJECT_M).floor() as i32).into()).or_insert(p);
        }
    }
    cells.into_values().collect()
}
