//! A scene seen from a viewpoint, in layers: furniture alone and each object alone, as the data set keeps them.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};
use repose_dataset::{Composite, Elsewhere, FixtureRecord, Layer, ObjectRecord, ViewRecord};
use repose_geometry::{OrientedBox, TriMesh, ViewerFrame};

use crate::render::{DepthCanvas, Light};
use crate::scene::{SceneObject, SimulatedScene};
use crate::viewpoint::{Viewpoint, ViewpointSettings};

/// How far from its place an object is shown for the second time, at most, metres and as a share of its distance from the camera.
const ELSEWHERE: (f64, f64) = (0.35, 0.4);
/// How much higher than it stands an object is shown for the second time, at most, metres: set down, or lifted.
const ELSEWHERE_UP_M: f64 = 0.06;

/// A view of the scene from a random viewpoint that sees enough of it; `None` when none of `settings.tries` does.
pub fn view_of_scene(
    scene: &SimulatedScene,
    view: u32,
    settings: &ViewpointSettings,
    with_color: bool,
    canvas: &mut DepthCanvas,
    rng: &mut impl Rng,
) -> Option<ViewRecord> {
    let focus = scene.focus();
    for _ in 0..settings.tries.max(1) {
        let viewpoint = Viewpoint::random(&focus, settings, rng);
        if !viewpoint.is_plausible(scene, settings) {
            continue;
        }
        let mut painter = LayerPainter::new(&viewpoint, with_color, canvas);
        let mut record = view_record(scene, view, &viewpoint, &mut painter);
        if sees_enough(&record, settings) {
            for (object, record) in scene.objects.iter().zip(&mut record.objects) {
                record.elsewhere = elsewhere(object, &viewpoint, rng).map(|world_from_elsewhere| Elsewhere {
                    layer: painter.alone(&object.shape.mesh, &world_from_elsewhere, object.color),
                    placed_from_elsewhere: object.world_from_object * world_from_elsewhere.inverse(),
                });
            }
            return Some(record);
        }
    }
    None
}

/// Whether a view shows enough objects, and enough of them.
fn sees_enough(view: &ViewRecord, settings: &ViewpointSettings) -> bool {
    let seen = (0..view.objects.len()).filter(|k| view.is_seen(*k)).count();
    let sum = |px: &dyn Fn(&ObjectRecord) -> u32| view.objects.iter().map(|o| f64::from(px(o))).sum::<f64>();
    seen >= settings.seen_least && sum(&|o| o.visible_px) >= settings.visible_share_least * sum(&|o| o.alone_px)
}

/// What a camera sees of a scene: layers and ground truth. No object has a second layer yet.
fn view_record(scene: &SimulatedScene, view: u32, viewpoint: &Viewpoint, painter: &mut LayerPainter) -> ViewRecord {
    let viewer = ViewerFrame::from_camera(&viewpoint.world_from_camera);
    let objects = scene.objects.iter().map(|object| {
        let alone = painter.alone(&object.shape.mesh, &object.world_from_object, object.color);
        ObjectRecord {
            id: object.id,
            name: object.shape.name.to_string(),
            mass_kg: object.shape.mass_kg,
            world_from_object: object.world_from_object,
            bounds: object.shape.bounds(&object.world_from_object),
            visible_px: 0,
            alone_px: alone.count() as u32,
            alone,
            elsewhere: None,
        }
    });
    let objects = objects.collect();
    let fixtures = scene.fixtures.iter().map(|fixture| FixtureRecord {
        name: fixture.role.name().to_owned(),
        bounds: OrientedBox { world_from_box: fixture.world_from_fixture, half_extents: fixture.half_extents_m },
    });
    let mut record = ViewRecord {
        scene_seed: scene.seed,
        scene_kind: scene.kind.name().to_owned(),
        view,
        camera: viewpoint.camera,
        viewpoint: viewpoint.mount.to_string(),
        world_from_camera: viewpoint.world_from_camera,
        view_yaw_rad: viewer.yaw_rad(),
        background: painter.furniture(scene),
        fixtures: fixtures.collect(),
        objects,
        relations: scene.relations(&viewer),
        gap_m: scene.gaps_m.clone(),
    };
    let visible_px = Composite::of(&record, |_| true).visible_px(record.objects.len());
    for (object, px) in record.objects.iter_mut().zip(visible_px) {
        object.visible_px = px;
    }
    record
}

/// A pose of the object elsewhere in the picture, turned about world z; `None` when no draw was in view.
fn elsewhere(object: &SceneObject, viewpoint: &Viewpoint, rng: &mut impl Rng) -> Option<Isometry3<f64>> {
    const TRIES: usize = 12;
    let camera_from_world = viewpoint.world_from_camera.inverse();
    let middle = object.world_from_object.translation.vector;
    let reach = ELSEWHERE.0.min(ELSEWHERE.1 * (middle - viewpoint.world_from_camera.translation.vector).norm());
    for _ in 0..TRIES {
        let mut offset = || rng.random_range(-reach..=reach);
        let (dx, dy) = (offset(), offset());
        let dz = rng.random_range(0.0..ELSEWHERE_UP_M);
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(-std::f64::consts::PI..std::f64::consts::PI));
        let at = middle + Vector3::new(dx, dy, dz);
        let world_from_elsewhere = Isometry3::from_parts(Translation3::from(at), yaw * object.world_from_object.rotation);
        let corners = object.shape.bounds(&world_from_elsewhere).corners();
        if corners.iter().all(|corner: &Point3<f64>| viewpoint.camera.pixel_of(&(camera_from_world * corner)).is_some()) {
            return Some(world_from_elsewhere);
        }
    }
    None
}

/// Draws layers through one camera.
struct LayerPainter<'a> {
    viewpoint: &'a Viewpoint,
    camera_from_world: Isometry3<f64>,
    canvas: &'a mut DepthCanvas,
    /// The light and a picture of color, as large as the canvas; `None` without color.
    color: Option<(Light, Vec<[u8; 3]>)>,
}

impl<'a> LayerPainter<'a> {
    fn new(viewpoint: &'a Viewpoint, with_color: bool, canvas: &'a mut DepthCanvas) -> Self {
        let pixels = viewpoint.camera.width * viewpoint.camera.height;
        let color = with_color.then(|| (Light::of_camera(&viewpoint.world_from_camera), vec![[0; 3]; pixels]));
        Self { viewpoint, camera_from_world: viewpoint.world_from_camera.inverse(), canvas, color }
    }

    fn alone(&mut self, mesh: &TriMesh, world_from_mesh: &Isometry3<f64>, color: [u8; 3]) -> Layer {
        self.canvas.clear();
        self.draw(mesh, world_from_mesh, color);
        self.layer()
    }

    fn furniture(&mut self, scene: &SimulatedScene) -> Layer {
        self.canvas.clear();
        for fixture in &scene.fixtures {
            self.draw(&fixture.mesh, &fixture.world_from_fixture, fixture.color);
        }
        self.layer()
    }

    fn draw(&mut self, mesh: &TriMesh, world_from_mesh: &Isometry3<f64>, color: [u8; 3]) {
        let camera_from_mesh = (self.camera_from_world * world_from_mesh).cast();
        match &mut self.color {
            None => self.canvas.draw_depth(&self.viewpoint.camera, &camera_from_mesh, mesh),
            Some((light, picture)) => {
                let shading = light.on(mesh, world_from_mesh, color);
                self.canvas.draw(&self.viewpoint.camera, &camera_from_mesh, mesh, |triangle, pixels| {
                    let shaded = shading.of_triangle(triangle);
                    pixels.iter().for_each(|index| picture[*index as usize] = shaded);
                });
            }
        }
    }

    /// What the canvas shows, cropped and rounded.
    fn layer(&self) -> Layer {
        let (rect, width) = (self.canvas.covered(), self.viewpoint.camera.width);
        if rect.x0 >= rect.x1 || rect.y0 >= rect.y1 {
            return Layer::default();
        }
        let span = |y: usize| y * width + rect.x0..y * width + rect.x1;
        let inverse_depth: Vec<f32> = (rect.y0..rect.y1).flat_map(|y| &self.canvas.inverse_depth()[span(y)]).copied().collect();
        let color: Vec<[u8; 3]> = match &self.color {
            None => Vec::new(),
            Some((_, picture)) => {
                let shown = (rect.y0..rect.y1).flat_map(span);
                // What was drawn there for another layer is not this one's.
                shown.map(|i| if self.canvas.inverse_depth()[i] > 0.0 { picture[i] } else { [0; 3] }).collect()
            }
        };
        let mut layer = Layer::from_inverse_depth(&inverse_depth, &color, rect.x1 - rect.x0);
        layer.x0 += rect.x0 as u32;
        layer.y0 += rect.y0 as u32;
        layer
    }
}
