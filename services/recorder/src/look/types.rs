//! Parts of Foxglove's messages, made of ours.

use foxglove::messages::{
    Color, FrameTransform, LinePrimitive, Pose, Quaternion, SceneEntity, SceneEntityDeletion, Timestamp, Vector3 as Vector, line_primitive,
    scene_entity_deletion,
};
use nalgebra::{Isometry3, Point3, Vector3};

/// The frame that everything stands in.
pub const WORLD: &str = "world";

/// An instant, from nanoseconds since the Unix epoch.
pub fn instant(ns: u64) -> Option<Timestamp> {
    Timestamp::new_checked(u32::try_from(ns / 1_000_000_000).ok()?, (ns % 1_000_000_000) as u32)
}

/// A vector.
pub fn vector(v: &Vector3<f64>) -> Vector {
    Vector { x: v.x, y: v.y, z: v.z }
}

/// A pose.
pub fn pose(pose: &Isometry3<f64>) -> Pose {
    let [x, y, z, w]: [f64; 4] = pose.rotation.coords.into();
    Pose { position: Some(vector(&pose.translation.vector)), orientation: Some(Quaternion { x, y, z, w }) }
}

/// Red, green, blue and opacity, 0 to 1.
pub fn color([r, g, b, a]: [f64; 4]) -> Color {
    Color { r, g, b, a }
}

/// Where a frame is in its parent.
pub fn transform(at: Option<Timestamp>, parent: &str, child: String, parent_from_child: &Isometry3<f64>) -> FrameTransform {
    let Pose { position, orientation } = pose(parent_from_child);
    FrameTransform {
        timestamp: at,
        parent_frame_id: parent.to_owned(),
        child_frame_id: child,
        translation: position,
        rotation: orientation,
    }
}

/// Something in the scene, without a shape, until it is drawn anew or taken away.
pub fn entity(at: Option<Timestamp>, id: String) -> SceneEntity {
    SceneEntity { timestamp: at, frame_id: WORLD.to_owned(), id, ..SceneEntity::default() }
}

/// A closed line, some pixels thick.
pub fn closed_line(points: impl Iterator<Item = Point3<f64>>, thickness: f64, of: [f64; 4]) -> LinePrimitive {
    LinePrimitive {
        r#type: line_primitive::Type::LineLoop.into(),
        pose: Some(pose(&Isometry3::identity())),
        thickness,
        scale_invariant: true,
        points: points.map(|p| foxglove::messages::Point3 { x: p.x, y: p.y, z: p.z }).collect(),
        color: Some(color(of)),
        ..LinePrimitive::default()
    }
}

/// Everything of the topic is taken away.
pub fn all_deleted(at: Option<Timestamp>) -> SceneEntityDeletion {
    SceneEntityDeletion { timestamp: at, r#type: scene_entity_deletion::Type::All.into(), id: String::new() }
}
