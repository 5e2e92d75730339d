//! A camera's frame and the camera's model.

use safetensors::Dtype;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::message::{check_finite, check_range};
use crate::{Bulk, CallError, RigidTransform, Tensor, limits};

/// Intrinsics and, where known, the pose of a camera: the content of a frame folder's `camera.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CameraModel {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Horizontal focal length, pixels.
    pub fx: f64,
    /// Vertical focal length, pixels.
    pub fy: f64,
    /// Column of the principal point, pixels.
    pub cx: f64,
    /// Row of the principal point, pixels.
    pub cy: f64,
    /// Metres per depth count.
    pub depth_unit_m: f64,
    /// The camera's pose; without it the world is the gravity-aligned frame of the main support plane.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world_from_camera: Option<RigidTransform>,
}

impl CameraModel {
    /// Checks sizes, focal lengths and pose.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn validate(&self) -> Result<(), CallError> {
        for (field, side) in [("width", self.width), ("height", self.height)] {
            check_range(field, side as f64, 1.0..=limits::MAX_IMAGE_SIDE as f64)?;
        }
        for (field, value) in [("fx", self.fx), ("fy", self.fy), ("depth_unit_m", self.depth_unit_m)] {
            check_range(field, value, f64::MIN_POSITIVE..=1e6)?;
        }
        check_finite("cx", &[self.cx])?;
        check_finite("cy", &[self.cy])?;
        self.world_from_camera.map_or(Ok(()), |t| t.validate("world_from_camera"))
    }
}

/// One RGB-D picture, optionally with instance labels. Images are row-major, `[height, width]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The camera's name in the key space.
    pub camera_name: String,
    /// When it was taken, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// The camera.
    pub camera: CameraModel,
    /// Depth counts of `camera.depth_unit_m`, 0 = no reading.
    pub depth: Vec<u16>,
    /// 8-bit RGB.
    pub color: Option<Vec<[u8; 3]>>,
    /// Instance ids, 0 = background.
    pub labels: Option<Vec<u16>>,
}

impl Frame {
    /// The bulk schema's name.
    pub const SCHEMA: &'static str = "Frame.v1";

    /// Checks the camera and that every image has its size.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn validate(&self) -> Result<(), CallError> {
        self.camera.validate()?;
        let pixels = self.camera.width * self.camera.height;
        let sizes = [
            ("depth", Some(self.depth.len())),
            ("color", self.color.as_ref().map(Vec::len)),
            ("labels", self.labels.as_ref().map(Vec::len)),
        ];
        for (field, size) in sizes {
            if let Some(got) = size.filter(|got| *got != pixels) {
                let message = format!("expected {pixels} pixels ({} x {}), got {got}", self.camera.width, self.camera.height);
                return Err(CallError::invalid(field, message));
            }
        }
        Ok(())
    }

    /// The bulk form.
    pub fn to_bulk(&self) -> Bulk {
        let shape = [self.camera.height, self.camera.width];
        let mut bulk = Bulk::default();
        bulk.tensors.insert("depth".to_owned(), Tensor::u16(&shape, &self.depth));
        if let Some(color) = &self.color {
            bulk.tensors.insert("color".to_owned(), Tensor::u8(&[shape[0], shape[1], 3], color.as_flattened()));
        }
        if let Some(labels) = &self.labels {
            bulk.tensors.insert("labels".to_owned(), Tensor::u16(&shape, labels));
        }
        bulk.metadata.insert("camera".to_owned(), self.camera_name.clone());
        bulk.metadata.insert("stamp_ns".to_owned(), self.stamp_ns.to_string());
        bulk.metadata.insert("camera_json".to_owned(), serde_json::to_string(&self.camera).unwrap_or_default());
        bulk
    }

    /// Reads and checks the bulk form.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn from_bulk(bulk: &Bulk) -> Result<Self, CallError> {
        let camera: CameraModel = crate::message::from_json(bulk.text("camera_json")?.as_bytes())?;
        camera.validate()?;
        let shape = [camera.height, camera.width];
        let expected = format!("{shape:?}");
        let flat = |s: &[usize]| s == shape;
        let (_, depth) = bulk.values::<u16>("depth", Dtype::U16, &expected, flat)?;
        let color = match bulk.tensors.contains_key("color") {
            true => {
                let fits = |s: &[usize]| s == [shape[0], shape[1], 3];
                let (_, bytes) = bulk.values::<u8>("color", Dtype::U8, &format!("[{}, {}, 3]", shape[0], shape[1]), fits)?;
                Some(bytes.as_chunks::<3>().0.to_vec())
            }
            false => None,
        };
        let labels = match bulk.tensors.contains_key("labels") {
            true => Some(bulk.values::<u16>("labels", Dtype::U16, &expected, flat)?.1),
            false => None,
        };
        let stamp_ns = parse_stamp(bulk)?;
        let camera_name = bulk.text("camera")?.to_owned();
        crate::keys::validate_chunk("camera", &camera_name)?;
        Ok(Self { camera_name, stamp_ns, camera, depth, color, labels })
    }
}

/// The `stamp_ns` metadata entry.
pub(crate) fn parse_stamp(bulk: &Bulk) -> Result<u64, CallError> {
    let text = bulk.text("stamp_ns")?;
    text.parse().map_err(|_| CallError::invalid("stamp_ns", format!("expected nanoseconds since the Unix epoch, got {text:?}")))
}
