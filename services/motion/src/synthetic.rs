//! Clouds of simple things as one camera sees them: the known scenes of this crate's tests and benches.

use nalgebra::{Isometry3, Point2, Point3, Vector3};
use repose_belief::{BelievedObject, SeenScene};
use repose_geometry::Aabb;
use repose_geometry::transform::{look_at, to_row_major};
use repose_proto::scene::WorldFrame;
use repose_proto::{CameraModel, ObjectSummary, RigidTransform, Scene, SceneMeta, Surface, Unseen};

use crate::scene::{PlanningScene, SupportArea};

/// The camera looks at the table from the far side and above.
pub const CAMERA: Point3<f64> = Point3::new(1.3, 0.0, 0.9);

/// The outline of the table, world x and y, metres.
const TABLE: [[f32; 2]; 4] = [[0.25, -0.45], [0.85, -0.45], [0.85, 0.45], [0.25, 0.45]];

/// The default cell's table top.
pub fn table() -> SupportArea {
    SupportArea::new(0.0, &TABLE.map(Point2::from), None).expect("the outline has an area")
}

/// The points of the table top, 8 mm apart.
pub fn table_points() -> Vec<Point3<f32>> {
    (0..75).flat_map(|i| (0..112).map(move |k| Point3::new(0.25 + 0.008 * i as f32, -0.45 + 0.008 * k as f32, 0.0))).collect()
}

/// What the camera sees of a box of edges `size` that stands on the table at `center`, turned by `yaw`: 3 mm between points.
pub fn seen_box(center: [f64; 2], size: [f64; 3], yaw: f64) -> Vec<Point3<f32>> {
    let world_from_box = Isometry3::new(Vector3::new(center[0], center[1], size[2] / 2.0), Vector3::z() * yaw);
    let mut points = Vec::new();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let mut normal = Vector3::zeros();
            normal[axis] = side;
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let (nu, nv) = ((size[u] / 0.003) as usize, (size[v] / 0.003) as usize);
            for (i, k) in (0..=nu).flat_map(|i| (0..=nv).map(move |k| (i, k))) {
                let mut p = Point3::origin();
                p[axis] = side * size[axis] / 2.0;
                p[u] = size[u] * (i as f64 / nu as f64 - 0.5);
                p[v] = size[v] * (k as f64 / nv as f64 - 0.5);
                let in_world = world_from_box * p;
                if (world_from_box * normal).dot(&(CAMERA - in_world)) > 0.0 && in_world.z > 0.004 {
                    points.push(in_world.cast::<f32>());
                }
            }
        }
    }
    points
}

/// What the camera sees of an open cylinder of thin wall: the outside in front, the inside at the back, and the bottom.
pub fn seen_bowl(center: [f64; 2], radius: f64, height: f64) -> Vec<Point3<f32>> {
    let mut points = Vec::new();
    let around = (std::f64::consts::TAU * radius / 0.003) as usize;
    for (i, k) in (0..around).flat_map(|i| (2..=(height / 0.003) as usize).map(move |k| (i, k))) {
        let angle = std::f64::consts::TAU * i as f64 / around as f64;
        points.push(Point3::new(center[0] + radius * angle.cos(), center[1] + radius * angle.sin(), 0.003 * k as f64).cast::<f32>());
    }
    let n = (radius / 0.003) as i32;
    for (x, y) in (-n..=n).flat_map(|x| (-n..=n).map(move |y| (f64::from(x) * 0.003, f64::from(y) * 0.003))) {
        if x.hypot(y) < radius {
            points.push(Point3::new(center[0] + x, center[1] + y, 0.006).cast::<f32>());
        }
    }
    points
}

/// A table with a box to move (1), a second box (2) and a bowl (3).
pub fn scene() -> PlanningScene {
    let objects = [
        (0, table_points()),
        (1, seen_box([0.45, -0.2], [0.05, 0.07, 0.10], 0.3)),
        (2, seen_box([0.55, 0.1], [0.10, 0.10, 0.15], -0.2)),
        (3, seen_bowl([0.6, -0.25], 0.06, 0.05)),
    ];
    scene_of(&objects)
}

/// The scene of objects by label (0: none) on the table.
///
/// # Panics
/// Where they are tens of metres apart.
pub fn scene_of(objects: &[(u16, Vec<Point3<f32>>)]) -> PlanningScene {
    let labelled = || objects.iter().flat_map(|(label, points)| points.iter().map(move |p| (p, *label)));
    let points: Vec<[f32; 3]> = labelled().map(|(p, _)| p.coords.into()).collect();
    let labels: Vec<u16> = labelled().map(|(_, label)| label).collect();
    let world_from_camera = world_from_camera();
    let seen =
        SeenScene { points: &points, labels: &labels, surfaces: &[surface()], camera: &camera(), world_from_camera: &world_from_camera };
    PlanningScene::of(&seen).expect("a table's objects are near each other")
}

/// [`scene`] as perception would send it, seen at `stamp_ns`.
pub fn wire_scene(stamp_ns: u64) -> Scene {
    let seen = scene();
    let summary = |(id, object): (&u16, &BelievedObject)| ObjectSummary {
        id: *id,
        points: object.points.len(),
        centroid_m: object.centroid.coords.into(),
        extent_m: Aabb::of(&object.points).map_or([0.0; 3], |bounds| (bounds.max - bounds.min).cast::<f64>().into()),
        completeness: 1.0,
        score: None,
    };
    Scene {
        camera_name: "front".to_owned(),
        stamp_ns,
        points: seen.points.iter().map(|p| p.coords.into()).collect(),
        labels: seen.labels,
        colors: None,
        meta: SceneMeta {
            objects: seen.belief.objects.iter().map(summary).collect(),
            surfaces: vec![surface()],
            camera: camera(),
            world_frame: WorldFrame::Extrinsics,
            view_yaw_rad: 0.0,
            unseen: Unseen::default(),
            left_out: Vec::new(),
            warnings: Vec::new(),
        },
        as_sent: None,
    }
}

/// The table's top.
fn surface() -> Surface {
    Surface { height_m: 0.0, outline_m: TABLE.map(|corner| corner.map(f64::from)).to_vec(), area_m2: 0.54, object: None }
}

/// The camera, calibrated.
fn camera() -> CameraModel {
    let world_from_camera = Some(RigidTransform(to_row_major(&world_from_camera())));
    CameraModel { width: 640, height: 480, fx: 525.0, fy: 525.0, cx: 319.5, cy: 239.5, depth_unit_m: 0.001, world_from_camera }
}

fn world_from_camera() -> Isometry3<f64> {
    look_at(&CAMERA, &Point3::new(0.5, 0.0, 0.0), &Vector3::z())
}
