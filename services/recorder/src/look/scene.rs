//! A scene's cloud, its objects as boxes with their numbers, its surfaces as outlines; and placements as ghosts of the object's box.

use std::collections::{BTreeMap, VecDeque};

use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{CubePrimitive, KeyValuePair, PackedElementField, PointCloud, SceneEntity, SceneUpdate, TextPrimitive};
use nalgebra::{Isometry3, Point3, Translation3};
use repose_geometry::transform::from_row_major;
use repose_geometry::{Aabb, OrientedBox};
use repose_proto::{PlaceResult, Scene};

use super::message::VisualMessage;
use super::types::{WORLD, all_deleted, closed_line, color, entity, instant, pose, vector};

/// Points that are drawn of a cloud.
const MOST_POINTS: usize = 30_000;
/// Bytes of a drawn point: three `f32` and four bytes of color.
const STRIDE: usize = 16;
/// Scenes whose boxes are kept for placements on them.
const SCENES: usize = 16;
/// Height of numbers, metres.
const FONT_M: f64 = 0.04;

/// The boxes of the objects of the newest scenes, newest first.
#[derive(Debug, Default)]
pub struct Boxes {
    scenes: VecDeque<(String, BTreeMap<u16, Aabb>)>,
}

impl Boxes {
    /// A scene's cloud and its objects; keeps its boxes.
    pub fn looks(&mut self, scene_id: &str, scene: &Scene) -> Vec<VisualMessage> {
        let bounds = Aabb::of_labels(&scene.points, &scene.labels);
        let looks = looks(scene, &bounds);
        if self.scenes.iter().all(|(known, _)| known != scene_id) {
            self.scenes.truncate(SCENES - 1);
            self.scenes.push_front((scene_id.to_owned(), bounds));
        }
        looks
    }

    /// The placements of an answer, best first; takes the ones before away. None where the scene is not known.
    pub fn ghosts(&self, result: &PlaceResult, at_ns: u64) -> Option<VisualMessage> {
        let (_, bounds) = self.scenes.iter().find(|(id, _)| *id == result.scene_id)?;
        let (bounds, at) = (bounds.get(&result.query)?, instant(at_ns));
        let ghost = |(rank, placement): (usize, &repose_proto::place::Placement)| {
            let moved = from_row_major(&placement.placed_from_observed.0).ok()?;
            let of = if rank == 0 { [0.1, 0.64, 0.3, 0.45] } else { [0.4, 0.55, 0.75, 0.3] };
            let likely = placement.realism.map_or_else(String::new, |p| format!(" ({:.0} %)", 100.0 * p));
            let (cube, text) = drawn(bounds, &moved, of, format!("{}{likely}", rank + 1));
            let cost = KeyValuePair { key: "cost".to_owned(), value: format!("{:.4}", placement.cost) };
            let ghost = entity(at, format!("placement {}", rank + 1));
            Some(SceneEntity { metadata: vec![cost], cubes: vec![cube], texts: vec![text], ..ghost })
        };
        let entities = result.placements.iter().enumerate().filter_map(ghost).collect();
        VisualMessage::new("/placements".to_owned(), at_ns, &SceneUpdate { deletions: vec![all_deleted(at)], entities })
    }
}

fn looks(scene: &Scene, bounds: &BTreeMap<u16, Aabb>) -> Vec<VisualMessage> {
    let (camera, at_ns) = (&scene.camera_name, scene.stamp_ns);
    let cloud = VisualMessage::new(format!("/scene/{camera}/cloud"), at_ns, &cloud(scene));
    let objects = VisualMessage::new(format!("/scene/{camera}/objects"), at_ns, &objects(scene, bounds));
    cloud.into_iter().chain(objects).collect()
}

fn cloud(scene: &Scene) -> PointCloud {
    let step = scene.points.len().div_ceil(MOST_POINTS).max(1);
    let mut data = Vec::with_capacity(STRIDE * scene.points.len() / step + STRIDE);
    for i in (0..scene.points.len()).step_by(step) {
        scene.points[i].iter().for_each(|v| data.extend_from_slice(&v.to_le_bytes()));
        let [r, g, b] = scene.colors.as_ref().map_or([190; 3], |colors| colors[i]);
        data.extend_from_slice(&[r, g, b, 255]);
    }
    let field = |name: &str, offset: u32, of: NumericType| PackedElementField { name: name.to_owned(), offset, r#type: of.into() };
    PointCloud {
        timestamp: instant(scene.stamp_ns),
        frame_id: WORLD.to_owned(),
        pose: Some(pose(&Isometry3::identity())),
        point_stride: STRIDE as u32,
        fields: vec![
            field("x", 0, NumericType::Float32),
            field("y", 4, NumericType::Float32),
            field("z", 8, NumericType::Float32),
            field("red", 12, NumericType::Uint8),
            field("green", 13, NumericType::Uint8),
            field("blue", 14, NumericType::Uint8),
            field("alpha", 15, NumericType::Uint8),
        ],
        data: data.into(),
    }
}

fn objects(scene: &Scene, bounds: &BTreeMap<u16, Aabb>) -> SceneUpdate {
    let at = instant(scene.stamp_ns);
    let object = |object: &repose_proto::ObjectSummary| {
        let (cube, text) = drawn(bounds.get(&object.id)?, &Isometry3::identity(), [0.9, 0.6, 0.15, 0.35], object.id.to_string());
        Some(SceneEntity { cubes: vec![cube], texts: vec![text], ..entity(at, format!("object {}", object.id)) })
    };
    let outline = |surface: &repose_proto::Surface| {
        closed_line(surface.outline_m.iter().map(|[x, y]| Point3::new(*x, *y, surface.height_m)), 2.0, [0.42, 0.56, 0.5, 1.0])
    };
    let lines = scene.meta.surfaces.iter().map(outline).collect();
    let surfaces = SceneEntity { lines, ..entity(at, "surfaces".to_owned()) };
    SceneUpdate { deletions: vec![all_deleted(at)], entities: scene.meta.objects.iter().filter_map(object).chain([surfaces]).collect() }
}

/// A box after a motion, in that color, with its text above it.
fn drawn(bounds: &Aabb, moved: &Isometry3<f64>, of: [f64; 4], text: String) -> (CubePrimitive, TextPrimitive) {
    let OrientedBox { world_from_box: at, half_extents } = bounds.oriented().transformed(moved);
    let above = Translation3::new(0.0, 0.0, half_extents.z + FONT_M) * at;
    let cube = CubePrimitive { pose: Some(pose(&at)), size: Some(vector(&(half_extents * 2.0))), color: Some(color(of)) };
    let text = TextPrimitive {
        pose: Some(pose(&above)),
        billboard: true,
        font_size: FONT_M,
        scale_invariant: false,
        color: Some(color([1.0; 4])),
        text,
    };
    (cube, text)
}
