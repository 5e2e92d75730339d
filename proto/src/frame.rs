//! A camera's frame and the camera's model.

use safetensors::Dtype;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{check_finite, check_range};
use crate::message::{below, from_entry};
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
    /// Depth counts of `camera.depth_unit_m`; 0 and 65535 are no readings ([`Frame::is_reading`]).
    pub depth: Vec<u16>,
    /// 8-bit RGB.
    pub color: Option<Vec<[u8; 3]>>,
    /// Instance ids, 0 = background.
    pub labels: Option<Vec<u16>>,
    /// The robots at the instant of the picture: what shows of them is neither object nor obstacle.
    pub robots: Vec<RobotInView>,
    /// What a person says about the objects.
    pub hints: SegmentHints,
}

/// Where a robot was when a picture was taken: an entry of the frame's metadata `robots`, and of `robot.json` in a frame folder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RobotInView {
    /// The robot's name.
    pub name: String,
    /// Which robot it is: `panda`, the default.
    #[serde(default = "panda")]
    pub model: String,
    /// Joint positions from the base outwards, radians.
    pub joints_rad: [f64; 7],
    /// Opening of the gripper, metres.
    pub gripper_width_m: f64,
    /// Whether something is between the fingers; where absent, the picture has to tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub holding: Option<bool>,
    /// Pose of the robot's base.
    pub world_from_base: RigidTransform,
}

fn panda() -> String {
    "panda".to_owned()
}

impl RobotInView {
    /// Checks numbers and the pose.
    ///
    /// # Errors
    /// `invalid_argument` that names the field below `field`.
    pub fn validate(&self, field: &str) -> Result<(), CallError> {
        check_finite(&format!("{field}.joints_rad"), &self.joints_rad)?;
        check_range(&format!("{field}.gripper_width_m"), self.gripper_width_m, 0.0..=0.2)?;
        self.world_from_base.validate(&format!("{field}.world_from_base"))
    }
}

/// What a person says about the objects in a picture, beside the labels or instead of them. Pixels are (column, row) from the upper left.
///
/// Ids in `merge` and `split` are those that the same frame gives without hints.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SegmentHints {
    /// Each pixel is on an object of its own.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub clicks_px: Vec<[usize; 2]>,
    /// Each box, `[left, top, right, bottom]`, ends included, encloses one object.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub boxes_px: Vec<[usize; 4]>,
    /// The ids of each list are one object, which keeps the first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub merge: Vec<Vec<u16>>,
    /// Each of these is more than one object.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub split: Vec<u16>,
}

impl SegmentHints {
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Checks that pixels are in the picture, boxes have room, and lists are bounded.
    ///
    /// # Errors
    /// `invalid_argument` that names the field below `hints`.
    pub fn validate(&self, camera: &CameraModel) -> Result<(), CallError> {
        let lists = [
            ("clicks_px", self.clicks_px.len()),
            ("boxes_px", self.boxes_px.len()),
            ("merge", self.merge.len()),
            ("split", self.split.len()),
        ];
        for (field, length) in lists {
            check_range(&format!("hints.{field}"), length as f64, 0.0..=limits::MAX_HINTS as f64)?;
        }
        let size = || format!("{} x {}", camera.width, camera.height);
        let inside = |u: usize, v: usize| u < camera.width && v < camera.height;
        if let Some((i, at)) = self.clicks_px.iter().enumerate().find(|(_, [u, v])| !inside(*u, *v)) {
            return Err(CallError::invalid(format!("hints.clicks_px[{i}]"), format!("{at:?} is outside the picture of {}", size())));
        }
        let fits = |[left, top, right, bottom]: &[usize; 4]| left < right && top < bottom && inside(*right, *bottom);
        if let Some((i, at)) = self.boxes_px.iter().enumerate().find(|(_, at)| !fits(at)) {
            let message = format!("expected left < right and top < bottom within the picture of {}, got {at:?}", size());
            return Err(CallError::invalid(format!("hints.boxes_px[{i}]"), message));
        }
        match self.merge.iter().position(|ids| ids.len() < 2 || ids.contains(&0)) {
            Some(i) => Err(CallError::invalid(format!("hints.merge[{i}]"), "expected two ids or more, none of them 0")),
            None => Ok(()),
        }
    }
}

impl Frame {
    /// The bulk schema's name.
    pub const SCHEMA: &'static str = "Frame.v1";

    /// A frame of depth alone.
    pub fn new(camera_name: String, stamp_ns: u64, camera: CameraModel, depth: Vec<u16>) -> Self {
        Self { camera_name, stamp_ns, camera, depth, color: None, labels: None, robots: Vec::new(), hints: SegmentHints::default() }
    }

    /// Whether a depth count is a reading. 0 is none, and neither is the greatest one: some cameras give it where they read nothing, the others where
    /// what they read was too far away to be counted.
    #[inline]
    pub fn is_reading(count: u16) -> bool {
        (1..u16::MAX).contains(&count)
    }

    /// Checks the camera and that every image has its size.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn validate(&self) -> Result<(), CallError> {
        self.camera.validate()?;
        for (i, robot) in self.robots.iter().enumerate() {
            robot.validate(&format!("robots[{i}]"))?;
        }
        self.hints.validate(&self.camera)?;
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
        if !self.robots.is_empty() {
            bulk.metadata.insert("robots".to_owned(), serde_json::to_string(&self.robots).unwrap_or_default());
        }
        if !self.hints.is_empty() {
            bulk.metadata.insert("hints".to_owned(), serde_json::to_string(&self.hints).unwrap_or_default());
        }
        bulk
    }

    /// Reads and checks the bulk form.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn from_bulk(bulk: &Bulk) -> Result<Self, CallError> {
        let camera: CameraModel = from_entry(bulk, "camera_json")?;
        camera.validate().map_err(|error| below("camera_json", error))?;
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
        let frame = Self {
            camera_name,
            stamp_ns,
            camera,
            depth,
            color,
            labels,
            robots: optional_json(bulk, "robots")?,
            hints: optional_json(bulk, "hints")?,
        };
        frame.validate()?;
        Ok(frame)
    }
}

/// A metadata entry that may be absent.
fn optional_json<T: Default + serde::de::DeserializeOwned>(bulk: &Bulk, entry: &str) -> Result<T, CallError> {
    if bulk.metadata.contains_key(entry) { from_entry(bulk, entry) } else { Ok(T::default()) }
}

/// The `stamp_ns` metadata entry.
pub(crate) fn parse_stamp(bulk: &Bulk) -> Result<u64, CallError> {
    let text = bulk.text("stamp_ns")?;
    text.parse().map_err(|_| CallError::invalid("stamp_ns", format!("expected nanoseconds since the Unix epoch, got {text:?}")))
}
