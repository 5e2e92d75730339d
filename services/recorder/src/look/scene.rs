//! A scene's cloud, its objects as boxes with their numbers, its surfaces as outlines; and placements as ghosts of the object's box.

use std::collections::{BTreeMap, VecDeque};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use repose_geometry::transform::from_row_major;
use repose_proto::{PlaceResult, Scene};
use serde::Serialize;

use super::message::Look;
use super::schema::Kind;
use super::types::{Color, Deletion, Entity, KeyValue, Line, Pose, SceneUpdate, Solid, Text, Time, WORLD};

/// Points that are drawn of a cloud.
const MOST_POINTS: usize = 30_000;
/// Bytes of a drawn point: three `f32` and four bytes of color.
const STRIDE: usize = 16;
/// Scenes whose boxes are kept for placements on them.
const SCENES: usize = 16;
/// Height of numbers, metres.
const FONT_M: f64 = 0.04;

/// A box, world frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Bounds {
    low: Vector3<f64>,
    high: Vector3<f64>,
}

impl Bounds {
    /// The box around each label of a scene, in one go over its points.
    fn of_objects(scene: &Scene) -> BTreeMap<u16, Self> {
        let mut bounds: BTreeMap<u16, Self> = BTreeMap::new();
        for (point, label) in scene.points.iter().zip(&scene.labels).filter(|(_, label)| **label > 0) {
            let point = Vector3::from(point.map(f64::from));
            let of = bounds.entry(*label).or_insert(Self { low: point, high: point });
            *of = Self { low: of.low.inf(&point), high: of.high.sup(&point) };
        }
        bounds
    }

    fn solid(&self, moved: &Isometry3<f64>, color: Color) -> Solid {
        let pose = moved * Isometry3::from_parts(((self.low + self.high) / 2.0).into(), UnitQuaternion::identity());
        Solid { pose: (&pose).into(), size: (self.high - self.low).into(), color }
    }
}

/// The boxes of the objects of the newest scenes, newest first.
#[derive(Debug, Default)]
pub struct Boxes {
    scenes: VecDeque<(String, BTreeMap<u16, Bounds>)>,
}

impl Boxes {
    /// A scene's cloud and its objects; keeps its boxes.
    pub fn looks(&mut self, scene_id: &str, scene: &Scene) -> Vec<Look> {
        let bounds = Bounds::of_objects(scene);
        let looks = looks(scene, &bounds);
        if self.scenes.iter().all(|(known, _)| known != scene_id) {
            self.scenes.truncate(SCENES - 1);
            self.scenes.push_front((scene_id.to_owned(), bounds));
        }
        looks
    }

    /// The placements of an answer, best first; takes the ones before away. None where the scene is not known.
    pub fn ghosts(&self, result: &PlaceResult, at_ns: u64) -> Option<Look> {
        let (_, bounds) = self.scenes.iter().find(|(id, _)| *id == result.scene_id)?;
        let (bounds, at) = (bounds.get(&result.query)?, Time::of_ns(at_ns));
        let ghost = |(rank, placement): (usize, &repose_proto::place::Placement)| {
            let moved = from_row_major(&placement.placed_from_observed.0).ok()?;
            let color = if rank == 0 { Color { r: 0.1, g: 0.64, b: 0.3, a: 0.45 } } else { Color { r: 0.4, g: 0.55, b: 0.75, a: 0.3 } };
            let solid = bounds.solid(&moved, color);
            let likely = placement.realism.map_or_else(String::new, |p| format!(" ({:.0} %)", 100.0 * p));
            let mut entity = Entity::new(at, format!("placement {}", rank + 1));
            entity.texts.push(label(solid.pose, solid.size.z, format!("{}{likely}", rank + 1)));
            entity.cubes.push(solid);
            entity.metadata.push(KeyValue { key: "cost", value: format!("{:.4}", placement.cost) });
            Some(entity)
        };
        let entities = result.placements.iter().enumerate().filter_map(ghost).collect();
        Some(Look::new("/placements".to_owned(), Kind::SceneUpdate, at_ns, &SceneUpdate { deletions: vec![Deletion::all(at)], entities }))
    }
}

/// A number above a box of height `tall`.
fn label(mut pose: Pose, tall: f64, text: String) -> Text {
    pose.position.z += tall / 2.0 + FONT_M;
    let color = Color { r: 1.0, g: 1.0, b: 1.0, a: 1.0 };
    Text { pose, billboard: true, font_size: FONT_M, scale_invariant: false, color, text }
}

#[derive(Serialize)]
struct PointCloud {
    timestamp: Time,
    frame_id: &'static str,
    pose: Pose,
    point_stride: usize,
    fields: Vec<Field>,
    data: String,
}

#[derive(Serialize)]
struct Field {
    name: &'static str,
    offset: usize,
    #[serde(rename = "type")]
    kind: u8,
}

/// Foxglove's numbers for element types.
const UINT8: u8 = 1;
const FLOAT32: u8 = 7;

fn looks(scene: &Scene, bounds: &BTreeMap<u16, Bounds>) -> Vec<Look> {
    let (camera, at_ns) = (&scene.camera_name, scene.stamp_ns);
    let cloud = Look::new(format!("/scene/{camera}/cloud"), Kind::PointCloud, at_ns, &cloud(scene));
    vec![cloud, Look::new(format!("/scene/{camera}/objects"), Kind::SceneUpdate, at_ns, &objects(scene, bounds))]
}

fn cloud(scene: &Scene) -> PointCloud {
    let step = scene.points.len().div_ceil(MOST_POINTS).max(1);
    let mut data = Vec::with_capacity(STRIDE * scene.points.len() / step + STRIDE);
    for i in (0..scene.points.len()).step_by(step) {
        scene.points[i].iter().for_each(|v| data.extend_from_slice(&v.to_le_bytes()));
        let [r, g, b] = scene.colors.as_ref().map_or([190; 3], |colors| colors[i]);
        data.extend_from_slice(&[r, g, b, 255]);
    }
    let field = |name, offset, kind| Field { name, offset, kind };
    PointCloud {
        timestamp: Time::of_ns(scene.stamp_ns),
        frame_id: WORLD,
        pose: (&Isometry3::identity()).into(),
        point_stride: STRIDE,
        fields: vec![
            field("x", 0, FLOAT32),
            field("y", 4, FLOAT32),
            field("z", 8, FLOAT32),
            field("red", 12, UINT8),
            field("green", 13, UINT8),
            field("blue", 14, UINT8),
            field("alpha", 15, UINT8),
        ],
        data: STANDARD.encode(data),
    }
}

fn objects(scene: &Scene, bounds: &BTreeMap<u16, Bounds>) -> SceneUpdate {
    let at = Time::of_ns(scene.stamp_ns);
    let outlined = Color { r: 0.9, g: 0.6, b: 0.15, a: 0.35 };
    let object = |object: &repose_proto::ObjectSummary| {
        let solid = bounds.get(&object.id)?.solid(&Isometry3::identity(), outlined);
        let mut entity = Entity::new(at, format!("object {}", object.id));
        entity.texts.push(label(solid.pose, solid.size.z, object.id.to_string()));
        entity.cubes.push(solid);
        Some(entity)
    };
    let mut surfaces = Entity::new(at, "surfaces".to_owned());
    surfaces.lines = scene
        .meta
        .surfaces
        .iter()
        .map(|surface| Line {
            // A closed line.
            kind: 1,
            pose: (&Isometry3::identity()).into(),
            thickness: 2.0,
            scale_invariant: true,
            points: surface.outline_m.iter().map(|[x, y]| Vector3::new(*x, *y, surface.height_m).into()).collect(),
            color: Color { r: 0.42, g: 0.56, b: 0.5, a: 1.0 },
            colors: [],
            indices: [],
        })
        .collect();
    let entities = scene.meta.objects.iter().filter_map(object).chain([surfaces]).collect();
    SceneUpdate { deletions: vec![Deletion::all(at)], entities }
}
