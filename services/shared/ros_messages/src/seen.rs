//! What others are shown: `vision_msgs`, `visualization_msgs` and `diagnostic_msgs`.

use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;

use crate::common::{ColorRgba, Duration, Header, Point, Pose, PoseWithCovariance, Vector3};
use crate::sensor::CompressedImage;

/// `vision_msgs/msg/ObjectHypothesis`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectHypothesis {
    /// What it is.
    pub class_id: String,
    /// How sure that is.
    pub score: f64,
}

/// `vision_msgs/msg/ObjectHypothesisWithPose`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectHypothesisWithPose {
    /// What it is.
    pub hypothesis: ObjectHypothesis,
    /// Where it is.
    pub pose: PoseWithCovariance,
}

/// `vision_msgs/msg/BoundingBox3D`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct BoundingBox3D {
    /// Its middle.
    pub center: Pose,
    /// Its edges, metres.
    pub size: Vector3,
}

/// `vision_msgs/msg/Detection3D`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Detection3D {
    /// When, and in which frame.
    pub header: Header,
    /// What it may be.
    pub results: Vec<ObjectHypothesisWithPose>,
    /// Its box.
    pub bbox: BoundingBox3D,
    /// Its id.
    pub id: String,
}

/// `vision_msgs/msg/Detection3DArray`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Detection3DArray {
    /// When, and in which frame.
    pub header: Header,
    /// What was found.
    pub detections: Vec<Detection3D>,
}

/// Kinds and actions of markers.
pub mod marker {
    /// A box.
    pub const CUBE: i32 = 1;
    /// Words that face the viewer.
    pub const TEXT_VIEW_FACING: i32 = 9;
    /// Shows it.
    pub const ADD: i32 = 0;
    /// Takes all markers of the topic away.
    pub const DELETE_ALL: i32 = 3;
}

/// `visualization_msgs/msg/UVCoordinate`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct UvCoordinate {
    /// Along the texture's width.
    pub u: f32,
    /// Along its height.
    pub v: f32,
}

/// `visualization_msgs/msg/MeshFile`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeshFile {
    /// Its name.
    pub filename: String,
    /// Its content.
    pub data: ByteBuf,
}

/// `visualization_msgs/msg/Marker`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Marker {
    /// When, and in which frame.
    pub header: Header,
    /// With the id, its name.
    pub ns: String,
    /// With the namespace, its name.
    pub id: i32,
    /// One of [`marker`].
    #[serde(rename = "type")]
    pub kind: i32,
    /// What happens to it.
    pub action: i32,
    /// Where it is.
    pub pose: Pose,
    /// Its size, metres.
    pub scale: Vector3,
    /// Its color.
    pub color: ColorRgba,
    /// How long it stays; zero: for ever.
    pub lifetime: Duration,
    /// Whether it goes along with its frame.
    pub frame_locked: bool,
    /// Points of lists.
    pub points: Vec<Point>,
    /// Their colors.
    pub colors: Vec<ColorRgba>,
    /// The texture's name.
    pub texture_resource: String,
    /// The texture.
    pub texture: CompressedImage,
    /// Where the points are on it.
    pub uv_coordinates: Vec<UvCoordinate>,
    /// Words.
    pub text: String,
    /// The mesh's name.
    pub mesh_resource: String,
    /// The mesh.
    pub mesh_file: MeshFile,
    /// Whether the mesh's own materials are used.
    pub mesh_use_embedded_materials: bool,
}

/// `visualization_msgs/msg/MarkerArray`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MarkerArray {
    /// The markers.
    pub markers: Vec<Marker>,
}

/// `diagnostic_msgs/msg/KeyValue`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// What.
    pub key: String,
    /// How much.
    pub value: String,
}

/// `diagnostic_msgs/msg/DiagnosticStatus`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// 0 good, 1 a warning, 2 an error, 3 stale.
    pub level: u8,
    /// Of what.
    pub name: String,
    /// The state in words.
    pub message: String,
    /// The device.
    pub hardware_id: String,
    /// Figures.
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/msg/DiagnosticArray`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// When.
    pub header: Header,
    /// The states.
    pub status: Vec<DiagnosticStatus>,
}
