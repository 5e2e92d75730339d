//! A camera of the configuration: the topics that its frames are made of.

use repose_proto::RigidTransform;
use repose_ros_messages::view::is_rectified_topic;
use serde::Deserialize;

use super::checks::{check_chunk, check_name, check_pose, within};
use crate::error::BridgeError;

/// One camera: the topics that its frames are made of.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Its name in the cell, a chunk of a key.
    pub name: String,
    /// Depth: `sensor_msgs/msg/Image` of `16UC1`, `mono16` or `32FC1`; or what image_transport publishes under names that end in
    /// `/compressedDepth` (PNG, RVL) or `/compressed` (PNG of `16UC1`).
    #[serde(default)]
    pub depth: Option<String>,
    /// In place of depth: an organized `sensor_msgs/msg/PointCloud2`, a point per pixel, in the camera's optical frame. Its `rgb` or `rgba` is the
    /// color where `color` is not set.
    #[serde(default)]
    pub cloud: Option<String>,
    /// Intrinsics of the depth: `sensor_msgs/msg/CameraInfo`. Without it they are told from a cloud's points; depth images need it.
    #[serde(default)]
    pub info: Option<String>,
    /// Color of the same size, registered to the depth: `sensor_msgs/msg/Image`, or JPEG or PNG under a name that ends in `/compressed`. Frames have
    /// no color without it; with it, depth without color is no frame.
    #[serde(default)]
    pub color: Option<String>,
    /// Whether the pictures are rectified. Default: if `rect` is in the depth topic's name, as ROS names such topics; clouds are. Others are rectified
    /// here.
    #[serde(default)]
    pub rectified: Option<bool>,
    /// The camera's optical frame. Default: the one that its messages name.
    #[serde(default)]
    pub frame: Option<String>,
    /// Where the camera stands. Default: from the transforms, at each picture's stamp.
    #[serde(default)]
    pub world_from_camera: Option<RigidTransform>,
    /// How far apart the stamps of depth and color may be, milliseconds. Default 17: half a picture at 30/s.
    #[serde(default = "tolerance_ms")]
    pub tolerance_ms: f64,
    /// How long depth waits for its color and for the transform at its stamp, milliseconds. Default 200; longer delays every frame that misses
    /// something.
    #[serde(default = "patience_ms")]
    pub patience_ms: u64,
    /// How old a picture may be when it comes, by its stamp and this machine's clock, milliseconds; older ones are late. Default 2000.
    #[serde(default = "max_age_ms")]
    pub max_age_ms: u64,
    /// Whether frames are stamped with when their depth came, where ROS's clock is not this machine's (`use_sim_time`). Default false.
    #[serde(default)]
    pub stamp_on_arrival: bool,
}

fn tolerance_ms() -> f64 {
    17.0
}

fn patience_ms() -> u64 {
    200
}

fn max_age_ms() -> u64 {
    2000
}

/// Where a camera's depth comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthSource<'a> {
    /// Images as they are.
    Plain(&'a str),
    /// Images packed by image_transport.
    Packed(&'a str),
    /// Organized clouds.
    Cloud(&'a str),
}

impl<'a> DepthSource<'a> {
    /// The topic.
    pub fn topic(self) -> &'a str {
        match self {
            Self::Plain(topic) | Self::Packed(topic) | Self::Cloud(topic) => topic,
        }
    }

    /// Its type.
    pub fn type_name(self) -> &'static str {
        match self {
            Self::Plain(_) => "sensor_msgs/msg/Image",
            Self::Packed(_) => "sensor_msgs/msg/CompressedImage",
            Self::Cloud(_) => "sensor_msgs/msg/PointCloud2",
        }
    }
}

/// Whether image_transport packs what it publishes under a name.
pub fn is_packed(topic: &str) -> bool {
    topic.ends_with("/compressed") || topic.ends_with("/compressedDepth")
}

/// Packings of image_transport that are not read, by the ends of their topics.
const UNREAD: [&str; 6] = ["/theora", "/zstd", "/zlib", "/ffmpeg", "/avif", "/draco"];

impl CameraConfig {
    /// Where its depth comes from. [`CameraConfig::validate`] sees to it that there is one.
    pub fn depth_source(&self) -> DepthSource<'_> {
        match (&self.cloud, self.depth.as_deref().unwrap_or_default()) {
            (Some(cloud), _) => DepthSource::Cloud(cloud),
            (None, packed) if is_packed(packed) => DepthSource::Packed(packed),
            (None, plain) => DepthSource::Plain(plain),
        }
    }

    /// Whether its pictures are rectified already.
    pub fn is_rectified(&self) -> bool {
        self.rectified.unwrap_or_else(|| self.depth.as_ref().is_none_or(|depth| is_rectified_topic(depth)))
    }

    pub(super) fn validate(&self, field: &str) -> Result<(), BridgeError> {
        check_chunk(&format!("{field}.name"), &self.name)?;
        if self.depth.is_some() == self.cloud.is_some() {
            return Err(BridgeError::config(format!("{field}.depth"), "expected one of `depth` and `cloud`"));
        }
        if self.info.is_none() && self.cloud.is_none() {
            return Err(BridgeError::config(format!("{field}.info"), "depth images need the topic of their CameraInfo"));
        }
        for (name, topic) in [("depth", &self.depth), ("cloud", &self.cloud), ("info", &self.info), ("color", &self.color)] {
            let field = format!("{field}.{name}");
            let Some(topic) = topic else { continue };
            check_name(&field, topic)?;
            if let Some(unread) = UNREAD.iter().find(|end| topic.ends_with(*end)) {
                let message = format!("{topic:?}: {unread} is not read; name the plain topic, …/compressed or …/compressedDepth");
                return Err(BridgeError::config(field, message));
            }
        }
        if let Some(color) = self.color.as_ref().filter(|color| color.ends_with("/compressedDepth")) {
            return Err(BridgeError::config(format!("{field}.color"), format!("{color:?} is of depth")));
        }
        check_pose(&format!("{field}.world_from_camera"), self.world_from_camera.as_ref())?;
        within(&format!("{field}.tolerance_ms"), self.tolerance_ms, 0.0, 1000.0)?;
        within(&format!("{field}.patience_ms"), self.patience_ms as f64, 0.0, 10_000.0)?;
        within(&format!("{field}.max_age_ms"), self.max_age_ms as f64, 1.0, 600_000.0)
    }
}
