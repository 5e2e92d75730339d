//! The little scenes of `sentences.toml` and `close_calls.toml` as a camera sees them: points of visible surfaces only, with noise and shading.

use nalgebra::{Isometry3, Point3, Rotation3, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal, Uniform};
use rand_pcg::Pcg64;
use repose_geometry::Pinhole;
use repose_geometry::transform::look_at;
use repose_proto::scene::{ObjectSummary, SceneMeta, WorldFrame};
use repose_proto::{CameraModel, Scene, Unseen};
use serde::Deserialize;

const SEED: u64 = 20_261_122;
/// Points drawn per square metre of surface before what is hidden is left out.
const DENSITY: f64 = 600_000.0;
/// Standard deviations of a depth reading (metres) and of a color channel.
const NOISE_M: f64 = 0.001;
const COLOR_NOISE: f64 = 4.0;
/// Where the light comes from, and the share of light in the shade.
const LIGHT: [f64; 3] = [-0.3, -0.4, 0.9];
const AMBIENT: f64 = 0.55;

#[derive(Deserialize)]
pub struct Table {
    pub scene: Vec<SceneCase>,
}

#[derive(Deserialize)]
pub struct SceneCase {
    pub name: String,
    #[serde(default = "yes")]
    pub colors: bool,
    pub objects: Vec<ObjectCase>,
    /// Sentence, object to move, terms.
    pub clear: Vec<(String, u16, Vec<String>)>,
    /// Sentence, objects that the refusal names (none: all).
    #[serde(default)]
    pub unclear: Vec<(String, Vec<u16>)>,
    /// Sentence, words of the error, objects that it names (none: all).
    #[serde(default)]
    pub refused: Vec<(String, String, Vec<u16>)>,
}

fn yes() -> bool {
    true
}

#[derive(Deserialize)]
pub struct ObjectCase {
    pub id: u16,
    pub kind: String,
    pub color: [u8; 3],
    pub size: Vec<f64>,
    pub at: [f64; 2],
    #[serde(default)]
    pub yaw: f64,
    /// How high it stands, metres.
    #[serde(default)]
    pub z: f64,
}

pub fn table() -> Table {
    toml::from_str(include_str!("../sentences.toml")).expect("the table of sentences")
}

pub fn close_calls() -> Table {
    toml::from_str(include_str!("../close_calls.toml")).expect("the table of close calls")
}

/// A point of a surface with its outward normal, in the world.
struct Surfel {
    at: Point3<f64>,
    normal: Vector3<f64>,
    object: usize,
}

pub fn scene(case: &SceneCase) -> Scene {
    let mut random = Pcg64::seed_from_u64(SEED);
    let world_from_camera = look_at(&Point3::new(0.0, -0.9, 0.7), &Point3::new(0.0, 0.05, 0.05), &Vector3::z());
    let camera = CameraModel {
        width: 640,
        height: 480,
        fx: 525.0,
        fy: 525.0,
        cx: 319.5,
        cy: 239.5,
        depth_unit_m: 0.001,
        world_from_camera: Some(repose_proto::RigidTransform(repose_geometry::transform::to_row_major(&world_from_camera))),
    };
    let surfels: Vec<Surfel> = case.objects.iter().enumerate().flat_map(|(i, o)| surface(i, o, &mut random)).collect();
    let mut scene = seen(case, &surfels, &world_from_camera, &camera, &mut random);
    if !case.colors {
        scene.colors = None;
    }
    scene
}

/// The surfels that the camera sees: facing it, and nearest in their pixel.
fn seen(case: &SceneCase, surfels: &[Surfel], world_from_camera: &Isometry3<f64>, camera: &CameraModel, random: &mut Pcg64) -> Scene {
    let pinhole = Pinhole { width: camera.width, height: camera.height, fx: camera.fx, fy: camera.fy, cx: camera.cx, cy: camera.cy };
    let camera_from_world = world_from_camera.inverse();
    let eye = Point3::from(world_from_camera.translation.vector);
    let mut nearest: Vec<Option<(f64, usize)>> = vec![None; camera.width * camera.height];
    for (i, surfel) in surfels.iter().enumerate() {
        if surfel.normal.dot(&(eye - surfel.at)) <= 0.0 {
            continue;
        }
        let in_camera = camera_from_world * surfel.at;
        let Some(pixel) = pinhole.project(&in_camera) else { continue };
        let slot = pixel.y.round() as usize * camera.width + pixel.x.round() as usize;
        if slot < nearest.len() && nearest[slot].is_none_or(|(depth, _)| in_camera.z < depth) {
            nearest[slot] = Some((in_camera.z, i));
        }
    }
    let noise_m = Normal::new(0.0, NOISE_M).expect("a distribution");
    let noise = Normal::new(0.0, COLOR_NOISE).expect("a distribution");
    let light = Vector3::from(LIGHT).normalize();
    let (mut points, mut labels, mut colors) = (Vec::new(), Vec::new(), Vec::new());
    for (_, i) in nearest.into_iter().flatten() {
        let surfel = &surfels[i];
        let at = surfel.at + (surfel.at - eye).normalize() * noise_m.sample(random);
        points.push(at.cast::<f32>().into());
        labels.push(case.objects[surfel.object].id);
        let lit = AMBIENT + (1.0 - AMBIENT) * surfel.normal.dot(&light).max(0.0);
        colors.push(case.objects[surfel.object].color.map(|c| (f64::from(c) * lit + noise.sample(random)).clamp(0.0, 255.0) as u8));
    }
    let summary = |o: &ObjectCase| ObjectSummary {
        id: o.id,
        points: labels.iter().filter(|l| **l == o.id).count(),
        centroid_m: [o.at[0], o.at[1], 0.05],
        extent_m: [0.1; 3],
        completeness: 0.5,
        score: None,
    };
    let meta = SceneMeta {
        objects: case.objects.iter().map(summary).collect(),
        surfaces: Vec::new(),
        camera: camera.clone(),
        world_frame: WorldFrame::Extrinsics,
        view_yaw_rad: 0.0,
        unseen: Unseen::default(),
        left_out: Vec::new(),
        warnings: Vec::new(),
    };
    Scene { camera_name: "front".to_owned(), stamp_ns: 0, points, labels, colors: Some(colors), meta, as_sent: None }
}

fn surface(object: usize, case: &ObjectCase, random: &mut Pcg64) -> Vec<Surfel> {
    let size = |k: usize| case.size[k];
    let parts: Vec<Part> = match case.kind.as_str() {
        "box" => vec![Part::Box([size(0), size(1), size(2)])],
        "can" => vec![Part::Side(size(0) / 2.0, size(0) / 2.0, 0.0, size(1)), Part::Disc(size(0) / 2.0, size(1))],
        "plate" => vec![Part::Side(size(0) / 2.7, size(0) / 2.0, 0.0, size(1)), Part::Inside(size(0) / 2.7, size(0) / 2.0, 0.006, size(1))],
        "mug" | "bowl" => {
            let (r, h) = (size(0) / 2.0, size(1));
            let foot = if case.kind == "mug" { r } else { 0.55 * r };
            vec![Part::Side(foot, r, 0.0, h), Part::Inside(foot - 0.003, r - 0.003, 0.006, h), Part::Rim(r - 0.003, r, h)]
        }
        "bottle" => {
            let (r, h) = (size(0) / 2.0, size(1));
            let (neck, shoulder) = (0.4 * r, 0.7 * h);
            vec![
                Part::Side(r, r, 0.0, shoulder),
                Part::Side(r, neck, shoulder, 0.82 * h),
                Part::Side(neck, neck, 0.82 * h, h),
                Part::Disc(neck, h),
            ]
        }
        "ball" => vec![Part::Ball(size(0) / 2.0)],
        other => panic!("no object of kind {other:?}"),
    };
    let world_from_object = Isometry3::from_parts(
        nalgebra::Translation3::new(case.at[0], case.at[1], case.z),
        Rotation3::from_axis_angle(&Vector3::z_axis(), case.yaw.to_radians()).into(),
    );
    let mut surfels = Vec::new();
    for part in parts {
        for _ in 0..(part.area() * DENSITY) as usize {
            let (at, normal) = part.draw(random);
            surfels.push(Surfel { at: world_from_object * at, normal: world_from_object * normal, object });
        }
    }
    surfels
}

/// Parts of surfaces in an object's frame, standing on z = 0.
enum Part {
    /// A box of edges.
    Box([f64; 3]),
    /// Outside of a cone's frustum: radii at the bottom and the top, heights of both.
    Side(f64, f64, f64, f64),
    /// Inside of a vessel: radii at its floor and its top, heights of both; with the floor.
    Inside(f64, f64, f64, f64),
    /// A flat ring that faces up: radii, height.
    Rim(f64, f64, f64),
    /// A disc that faces up: radius, height.
    Disc(f64, f64),
    /// A ball that stands on the table: radius.
    Ball(f64),
}

impl Part {
    fn area(&self) -> f64 {
        use std::f64::consts::PI;
        match *self {
            Self::Box([x, y, z]) => 2.0 * (x * y + y * z + x * z),
            Self::Side(a, b, low, high) => PI * (a + b) * (high - low).hypot(b - a),
            Self::Inside(a, b, low, high) => PI * (a + b) * (high - low).hypot(b - a) + PI * a * a,
            Self::Rim(a, b, _) => PI * (b * b - a * a),
            Self::Disc(r, _) => PI * r * r,
            Self::Ball(r) => 4.0 * PI * r * r,
        }
    }

    /// A point and its normal, evenly over the part but for slight crowding at the narrow end of a frustum.
    fn draw(&self, random: &mut Pcg64) -> (Point3<f64>, Vector3<f64>) {
        let unit = Uniform::new(0.0, 1.0).expect("a range");
        let (u, v, w) = (unit.sample(random), unit.sample(random), unit.sample(random));
        let turn = u * std::f64::consts::TAU;
        let around = Vector3::new(turn.cos(), turn.sin(), 0.0);
        let ring = |a: f64, b: f64| (a * a + v * (b * b - a * a)).sqrt();
        match *self {
            Self::Box([x, y, z]) => {
                let faces = [(x * y, 2, 0, 1), (y * z, 0, 1, 2), (x * z, 1, 0, 2)];
                let mut left = w * faces.iter().map(|f| f.0).sum::<f64>();
                let face = faces
                    .into_iter()
                    .find(|f| {
                        left -= f.0;
                        left <= 0.0
                    })
                    .unwrap_or(faces[0]);
                let edges = [x, y, z];
                let (mut at, mut normal) = (Vector3::zeros(), Vector3::zeros());
                at[face.2] = (u - 0.5) * edges[face.2];
                at[face.3] = (v * 2.0).fract().mul_add(edges[face.3], -0.5 * edges[face.3]);
                normal[face.1] = if v < 0.5 { 1.0 } else { -1.0 };
                at[face.1] = normal[face.1] * edges[face.1] / 2.0;
                (Point3::from(at + Vector3::z() * z / 2.0), normal)
            }
            Self::Side(a, b, low, high) => frustum(a, b, low, high, v, &around, 1.0),
            Self::Inside(a, b, low, high) => {
                let wall = (a + b) * (high - low).hypot(b - a);
                if w * (wall + a * a) < wall {
                    frustum(a, b, low, high, v, &around, -1.0)
                } else {
                    (Point3::from(around * ring(0.0, a) + Vector3::z() * low), Vector3::z())
                }
            }
            Self::Rim(a, b, height) => (Point3::from(around * ring(a, b) + Vector3::z() * height), Vector3::z()),
            Self::Disc(r, height) => (Point3::from(around * ring(0.0, r) + Vector3::z() * height), Vector3::z()),
            Self::Ball(r) => {
                let z = 2.0 * v - 1.0;
                let normal = around * (1.0 - z * z).sqrt() + Vector3::z() * z;
                (Point3::from(normal * r + Vector3::z() * r), normal)
            }
        }
    }
}

fn frustum(a: f64, b: f64, low: f64, high: f64, v: f64, around: &Vector3<f64>, outward: f64) -> (Point3<f64>, Vector3<f64>) {
    let normal = (around * (high - low) + Vector3::z() * (a - b)).normalize() * outward;
    (Point3::from(around * (a + v * (b - a)) + Vector3::z() * (low + v * (high - low))), normal)
}
