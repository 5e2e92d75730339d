//! A scene seen from a viewpoint, in layers: furniture alone and each object alone, as the data set keeps them.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};
use repose_dataset::{DEPTH_UNIT_M, Elsewhere, Layer, ObjectRecord, ViewRecord};
use repose_geometry::{Pinhole, TriMesh, ViewerFrame};

use crate::render::DepthCanvas;
use crate::scene::{Scene, SceneObject};

/// How far from its place an object is shown for the second time, at most, metres.
const ELSEWHERE_M: f64 = 0.35;

/// What a camera sees of a scene: layers, ground truth and, for each object, the same object somewhere else.
pub fn view_record(
    scene: &Scene,
    view: u32,
    camera: &Pinhole,
    world_from_camera: &Isometry3<f64>,
    canvas: &mut DepthCanvas,
    rng: &mut impl Rng,
) -> ViewRecord {
    let camera_from_world = world_from_camera.inverse();
    let viewer = ViewerFrame::from_camera(world_from_camera);
    canvas.clear();
    for fixture in &scene.fixtures {
        canvas.draw_depth(camera, &(camera_from_world * fixture.world_from_fixture).cast(), &fixture.mesh);
    }
    let background = layer_of(canvas);
    let mut alone = |mesh: &TriMesh, world_from_object: &Isometry3<f64>| {
        canvas.clear();
        canvas.draw_depth(camera, &(camera_from_world * world_from_object).cast(), mesh);
        layer_of(canvas)
    };
    let objects = scene.objects.iter().map(|object| {
        let layer = alone(&object.shape.mesh, &object.world_from_object);
        let elsewhere = elsewhere(object, camera, &camera_from_world, rng).map(|world_from_elsewhere| Elsewhere {
            layer: alone(&object.shape.mesh, &world_from_elsewhere),
            placed_from_elsewhere: object.world_from_object * world_from_elsewhere.inverse(),
        });
        ObjectRecord {
            id: object.id,
            name: object.shape.name.to_string(),
            world_from_object: object.world_from_object,
            bounds: object.shape.bounds(&object.world_from_object),
            alone: layer,
            elsewhere,
        }
    });
    ViewRecord {
        scene_seed: scene.seed,
        view,
        camera: *camera,
        world_from_camera: *world_from_camera,
        view_yaw_rad: viewer.yaw_rad(),
        background,
        objects: objects.collect(),
        relations: scene.relations(&viewer),
        gap_m: scene.gaps_m.clone(),
    }
}

/// A pose of the object elsewhere in the picture, turned about world z; `None` when no draw was in view.
fn elsewhere(object: &SceneObject, camera: &Pinhole, camera_from_world: &Isometry3<f64>, rng: &mut impl Rng) -> Option<Isometry3<f64>> {
    const TRIES: usize = 12;
    for _ in 0..TRIES {
        let mut offset = || rng.random_range(-ELSEWHERE_M..ELSEWHERE_M);
        let (dx, dy) = (offset(), offset());
        let dz = rng.random_range(-0.05..0.05);
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(-std::f64::consts::PI..std::f64::consts::PI));
        let at = object.world_from_object.translation.vector + Vector3::new(dx, dy, dz);
        let world_from_elsewhere = Isometry3::from_parts(Translation3::from(at), yaw * object.world_from_object.rotation);
        let corners = object.shape.bounds(&world_from_elsewhere).corners();
        if corners.iter().all(|corner: &Point3<f64>| camera.pixel_of(&(camera_from_world * corner)).is_some()) {
            return Some(world_from_elsewhere);
        }
    }
    None
}

/// What the canvas shows, cropped and quantised.
fn layer_of(canvas: &DepthCanvas) -> Layer {
    let rect = canvas.covered();
    if rect.x0 >= rect.x1 || rect.y0 >= rect.y1 {
        return Layer::default();
    }
    let steps = |z: f32| {
        let steps = (z / DEPTH_UNIT_M).round();
        if (1.0..=f32::from(u16::MAX)).contains(&steps) { steps as u16 } else { 0 }
    };
    let depth =
        (rect.y0..rect.y1).flat_map(|y| (rect.x0..rect.x1).map(move |x| (x, y))).map(|(x, y)| steps(canvas.depth_m(x, y))).collect();
    Layer { x0: rect.x0 as u32, y0: rect.y0 as u32, width: (rect.x1 - rect.x0) as u32, height: (rect.y1 - rect.y0) as u32, depth }
}
