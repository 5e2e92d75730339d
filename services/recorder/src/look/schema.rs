//! The schemas of what is looked at, as JSON Schema: viewers go by their names, and find bytes by their encoding.

use serde_json::{Value, json};

/// A kind of message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A picture.
    CompressedImage,
    /// A camera's intrinsics.
    CameraCalibration,
    /// Points.
    PointCloud,
    /// Boxes, spheres and texts that come and go.
    SceneUpdate,
    /// Where frames are.
    FrameTransforms,
    /// Joint positions.
    JointStates,
    /// A line of a log.
    Log,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 7] = [
        Self::CompressedImage,
        Self::CameraCalibration,
        Self::PointCloud,
        Self::SceneUpdate,
        Self::FrameTransforms,
        Self::JointStates,
        Self::Log,
    ];

    /// The name that viewers know it by.
    pub fn schema_name(self) -> &'static str {
        match self {
            Self::CompressedImage => "foxglove.CompressedImage",
            Self::CameraCalibration => "foxglove.CameraCalibration",
            Self::PointCloud => "foxglove.PointCloud",
            Self::SceneUpdate => "foxglove.SceneUpdate",
            Self::FrameTransforms => "foxglove.FrameTransforms",
            Self::JointStates => "foxglove.JointStates",
            Self::Log => "foxglove.Log",
        }
    }

    /// The schema, JSON Schema without references.
    pub fn schema(self) -> String {
        let properties = match self {
            Self::CompressedImage => json!({"timestamp": time(), "frame_id": text(), "data": bytes(), "format": text()}),
            Self::CameraCalibration => json!({
                "timestamp": time(), "frame_id": text(), "width": integer(), "height": integer(), "distortion_model": text(),
                "D": list(number()), "K": list(number()), "R": list(number()), "P": list(number()),
            }),
            Self::PointCloud => json!({
                "timestamp": time(), "frame_id": text(), "pose": pose(), "point_stride": integer(), "data": bytes(),
                "fields": list(object(json!({"name": text(), "offset": integer(), "type": integer()}))),
            }),
            Self::SceneUpdate => json!({
                "deletions": list(object(json!({"timestamp": time(), "type": integer(), "id": text()}))),
                "entities": list(entity()),
            }),
            Self::FrameTransforms => json!({"transforms": list(object(json!({
                "timestamp": time(), "parent_frame_id": text(), "child_frame_id": text(), "translation": vector(), "rotation": quaternion(),
            })))}),
            Self::JointStates => json!({
                "timestamp": time(), "joints": list(object(json!({"name": text(), "position": number(), "velocity": number()}))),
            }),
            Self::Log => {
                json!({"timestamp": time(), "level": integer(), "message": text(), "name": text(), "file": text(), "line": integer()})
            }
        };
        let mut schema = object(properties);
        schema["$schema"] = json!("http://json-schema.org/draft-07/schema#");
        schema["title"] = json!(self.schema_name());
        schema.to_string()
    }
}

fn entity() -> Value {
    let shape = |own: Value| {
        let mut properties = json!({"pose": pose(), "color": color()});
        if let (Some(all), Value::Object(own)) = (properties.as_object_mut(), own) {
            all.extend(own);
        }
        list(object(properties))
    };
    object(json!({
        "timestamp": time(), "frame_id": text(), "id": text(), "lifetime": duration(), "frame_locked": {"type": "boolean"},
        "metadata": list(object(json!({"key": text(), "value": text()}))),
        "cubes": shape(json!({"size": vector()})),
        "spheres": shape(json!({"size": vector()})),
        "texts": shape(json!({"billboard": {"type": "boolean"}, "font_size": number(), "scale_invariant": {"type": "boolean"}, "text": text()})),
        "lines": shape(json!({
            "type": integer(), "thickness": number(), "scale_invariant": {"type": "boolean"}, "points": list(vector()),
            "colors": list(color()), "indices": list(integer()),
        })),
        "arrows": list(object(json!({}))), "cylinders": list(object(json!({}))), "triangles": list(object(json!({}))), "models": list(object(json!({}))),
    }))
}

fn object(properties: Value) -> Value {
    of_type("object", "properties", properties)
}

fn list(items: Value) -> Value {
    of_type("array", "items", items)
}

fn of_type(name: &str, content: &str, inner: Value) -> Value {
    Value::Object([("type".to_owned(), json!(name)), (content.to_owned(), inner)].into_iter().collect())
}

fn text() -> Value {
    json!({"type": "string"})
}

fn bytes() -> Value {
    json!({"type": "string", "contentEncoding": "base64"})
}

fn number() -> Value {
    json!({"type": "number"})
}

fn integer() -> Value {
    json!({"type": "integer"})
}

fn numbers(names: &[&str]) -> Value {
    object(names.iter().map(|name| ((*name).to_owned(), number())).collect::<serde_json::Map<_, _>>().into())
}

fn vector() -> Value {
    numbers(&["x", "y", "z"])
}

fn quaternion() -> Value {
    numbers(&["x", "y", "z", "w"])
}

fn color() -> Value {
    numbers(&["r", "g", "b", "a"])
}

fn pose() -> Value {
    object(json!({"position": vector(), "orientation": quaternion()}))
}

fn instant(title: &str) -> Value {
    let nanoseconds = json!({"type": "integer", "minimum": 0, "maximum": 999_999_999});
    json!({"type": "object", "title": title, "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": nanoseconds}})
}

fn time() -> Value {
    instant("time")
}

fn duration() -> Value {
    instant("duration")
}
