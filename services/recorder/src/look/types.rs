//! Parts of Foxglove's messages, named as there.

use nalgebra::{Isometry3, Vector3};
use serde::Serialize;

/// The frame that everything stands in.
pub const WORLD: &str = "world";

/// An instant or a duration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Time {
    pub sec: u64,
    pub nsec: u32,
}

impl Time {
    pub fn of_ns(ns: u64) -> Self {
        Self { sec: ns / 1_000_000_000, nsec: (ns % 1_000_000_000) as u32 }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Vector {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

impl From<Vector3<f64>> for Vector {
    fn from(v: Vector3<f64>) -> Self {
        Self { x: v.x, y: v.y, z: v.z }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quaternion {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub w: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pose {
    pub position: Vector,
    pub orientation: Quaternion,
}

impl From<&Isometry3<f64>> for Pose {
    fn from(pose: &Isometry3<f64>) -> Self {
        let [x, y, z, w]: [f64; 4] = pose.rotation.coords.into();
        Self { position: pose.translation.vector.into(), orientation: Quaternion { x, y, z, w } }
    }
}

/// Red, green, blue and opacity, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Color {
    pub r: f64,
    pub g: f64,
    pub b: f64,
    pub a: f64,
}

/// Where a frame is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameTransform {
    pub timestamp: Time,
    pub parent_frame_id: String,
    pub child_frame_id: String,
    pub translation: Vector,
    pub rotation: Quaternion,
}

impl FrameTransform {
    pub fn new(at: Time, parent: &str, child: String, pose: &Isometry3<f64>) -> Self {
        let Pose { position, orientation } = pose.into();
        Self { timestamp: at, parent_frame_id: parent.to_owned(), child_frame_id: child, translation: position, rotation: orientation }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameTransforms {
    pub transforms: Vec<FrameTransform>,
}

/// A cube, or a sphere.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Solid {
    pub pose: Pose,
    pub size: Vector,
    pub color: Color,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Text {
    pub pose: Pose,
    pub billboard: bool,
    pub font_size: f64,
    pub scale_invariant: bool,
    pub color: Color,
    pub text: String,
}

/// A closed line.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Line {
    #[serde(rename = "type")]
    pub kind: u8,
    pub pose: Pose,
    pub thickness: f64,
    pub scale_invariant: bool,
    pub points: Vec<Vector>,
    pub color: Color,
    pub colors: [Color; 0],
    pub indices: [u32; 0],
}

/// Something in the scene, until it is drawn anew or taken away.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Entity {
    pub timestamp: Time,
    pub frame_id: &'static str,
    pub id: String,
    pub lifetime: Time,
    pub frame_locked: bool,
    pub metadata: Vec<KeyValue>,
    pub cubes: Vec<Solid>,
    pub spheres: Vec<Solid>,
    pub texts: Vec<Text>,
    pub lines: Vec<Line>,
    pub arrows: [u8; 0],
    pub cylinders: [u8; 0],
    pub triangles: [u8; 0],
    pub models: [u8; 0],
}

impl Entity {
    pub fn new(at: Time, id: String) -> Self {
        Self {
            timestamp: at,
            frame_id: WORLD,
            id,
            lifetime: Time { sec: 0, nsec: 0 },
            frame_locked: false,
            metadata: Vec::new(),
            cubes: Vec::new(),
            spheres: Vec::new(),
            texts: Vec::new(),
            lines: Vec::new(),
            arrows: [],
            cylinders: [],
            triangles: [],
            models: [],
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KeyValue {
    pub key: &'static str,
    pub value: String,
}

/// What is taken away: everything of the topic.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Deletion {
    pub timestamp: Time,
    #[serde(rename = "type")]
    pub kind: u8,
    pub id: &'static str,
}

impl Deletion {
    /// All entities of the topic.
    pub fn all(at: Time) -> Self {
        Self { timestamp: at, kind: 1, id: "" }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneUpdate {
    pub deletions: Vec<Deletion>,
    pub entities: Vec<Entity>,
}
