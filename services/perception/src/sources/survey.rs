//! Which topics of a recording make its frames: first a depth topic, then what belongs to its camera.
//!
//! A recording may hold several cameras, and infrared or disparity pictures with the encoding of depth. Intrinsics of another camera
//! would bend every scene without a word, so they are taken only where the namespace or the frame says whose they are.

use std::collections::BTreeMap;

use super::messages::Channel;
use repose_ros_messages::frames::model_of;
use repose_ros_messages::{CameraInfo, Header, MessageError, PointCloud2, RosImage};

/// Which topics make the frames. Of those that are not named the best fitting ones do.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Topics {
    /// Depth images (`16UC1` or `32FC1`; `mono16`, which is infrared more often, only where named).
    pub depth: Option<String>,
    /// Color images (`rgb8`, `bgr8`, `rgba8`, `bgra8`).
    pub color: Option<String>,
    /// Intrinsics.
    pub info: Option<String>,
    /// Organised clouds; used instead of depth images where named, or where [`Topics::clouds`] is set.
    pub points: Option<String>,
    /// Whether frames are made of clouds rather than of depth images.
    pub clouds: bool,
}

impl Topics {
    /// Whether frames are made of clouds.
    pub fn of_clouds(&self) -> bool {
        self.clouds || self.points.is_some()
    }
}

/// The topics that make the frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Chosen {
    /// Depth images or organized clouds.
    pub depth: String,
    /// Intrinsics.
    pub info: String,
    /// Color images, where there are any.
    pub color: Option<String>,
}

/// What the messages so far say of their topics.
#[derive(Debug, Default)]
pub struct Survey {
    /// In the order of their first messages.
    topics: Vec<Seen>,
    /// The type of every topic.
    schemas: BTreeMap<String, String>,
    /// The first message that could not be read.
    unreadable: Option<(String, MessageError)>,
}

/// A topic by its first message.
#[derive(Debug)]
struct Seen {
    topic: String,
    kind: Kind,
    frame_id: String,
    size: (u32, u32),
}

#[derive(Debug)]
enum Kind {
    Image { encoding: String },
    Cloud,
    Info,
}

impl Survey {
    /// Takes note of a message.
    pub fn take(&mut self, channel: &Channel, bytes: &[u8]) {
        let topic = &channel.topic;
        self.schemas.entry(topic.clone()).or_insert_with(|| channel.schema.clone());
        if self.topics.iter().any(|seen| seen.topic == *topic) {
            return;
        }
        match seen(channel, bytes) {
            Ok(Some(seen)) => self.topics.push(seen),
            Ok(None) => {}
            Err(error) => {
                self.unreadable.get_or_insert_with(|| (topic.clone(), error));
            }
        }
    }

    /// The first message that could not be read, with its topic.
    pub fn unreadable(self) -> Option<(String, MessageError)> {
        self.unreadable
    }

    /// Every topic with its type, to be told where nothing fits.
    pub fn listing(&self) -> String {
        let topics: Vec<String> = self.schemas.iter().map(|(topic, schema)| format!("{topic} ({schema})")).collect();
        topics.join(", ")
    }

    /// The topics that fit: depth with "depth" in its name before others, one that has intrinsics before one that has none, then the
    /// first. `None` where that one has no intrinsics.
    pub fn choose(&self, wanted: &Topics) -> Option<Chosen> {
        let is_named = |name: &Option<String>, seen: &Seen| name.as_ref().is_none_or(|name| *name == seen.topic);
        let is_source = |seen: &&Seen| match &seen.kind {
            Kind::Cloud => wanted.of_clouds() && is_named(&wanted.points, seen),
            Kind::Image { encoding } if !wanted.of_clouds() && is_named(&wanted.depth, seen) => {
                matches!(encoding.as_str(), "16UC1" | "32FC1") || (encoding == "mono16" && wanted.depth.is_some())
            }
            _ => false,
        };
        let sources = self.topics.iter().filter(is_source).map(|source| (source, self.info_of(source, wanted)));
        let other_name = |source: &Seen| !wanted.of_clouds() && !source.topic.to_lowercase().contains("depth");
        let (source, info) = sources.min_by_key(|(source, info)| (other_name(source), info.is_none()))?;
        let color = self.color_of(source, wanted).map(|color| color.topic.clone());
        Some(Chosen { depth: source.topic.clone(), info: info?.topic.clone(), color })
    }

    /// The intrinsics of a source: as named, else those of its size beside it in its namespace, else those of its size and frame.
    fn info_of(&self, source: &Seen, wanted: &Topics) -> Option<&Seen> {
        let infos = self.topics.iter().filter(|seen| matches!(seen.kind, Kind::Info) && seen.size == source.size);
        if let Some(name) = &wanted.info {
            return infos.into_iter().find(|seen| seen.topic == *name);
        }
        let rank = |info: &Seen| {
            let (namespace, name) = split(&info.topic);
            let beside = namespace == split(&source.topic).0;
            let same_frame = info.frame_id == source.frame_id && !info.frame_id.is_empty();
            match (beside, same_frame) {
                (true, true) => Some(0),
                (true, false) if name == "camera_info" => Some(1),
                (false, true) => Some(2),
                _ => None,
            }
        };
        infos.filter_map(|info| Some((rank(info)?, info))).min_by_key(|(rank, _)| *rank).map(|(_, info)| info)
    }

    /// The color images of a source: as named, else those of its size and frame, else those of its size that share most of its namespace.
    fn color_of(&self, source: &Seen, wanted: &Topics) -> Option<&Seen> {
        let is_color = |seen: &&Seen| matches!(&seen.kind, Kind::Image { encoding } if matches!(encoding.as_str(), "rgb8" | "bgr8" | "rgba8" | "bgra8"));
        let mut colors = self.topics.iter().filter(is_color);
        if let Some(name) = &wanted.color {
            return colors.find(|seen| seen.topic == *name);
        }
        let shared = |color: &Seen| parts(split(&color.topic).0).zip(parts(split(&source.topic).0)).take_while(|(a, b)| a == b).count();
        let same_frame = |color: &Seen| color.frame_id == source.frame_id && !color.frame_id.is_empty();
        let beside = |color: &Seen| split(&color.topic).0 == split(&source.topic).0;
        let theirs = colors.filter(|c| c.size == source.size && (same_frame(c) || beside(c) || shared(c) > 0));
        // Of equal ones the first: the last of the reversed.
        theirs.rev().max_by_key(|color| (same_frame(color), shared(color)))
    }
}

/// What the first message of a topic says; `None` of types that frames are not made of, and of a camera that was never calibrated.
fn seen(channel: &Channel, bytes: &[u8]) -> Result<Option<Seen>, MessageError> {
    let of = |header: Header, kind: Kind, size: (u32, u32)| Seen { topic: channel.topic.clone(), kind, frame_id: header.frame_id, size };
    Ok(match channel.schema.as_str() {
        "sensor_msgs/msg/Image" => {
            let image = RosImage::read(bytes)?;
            Some(of(image.header, Kind::Image { encoding: image.encoding }, (image.width, image.height)))
        }
        "sensor_msgs/msg/PointCloud2" => {
            let cloud = PointCloud2::read(bytes)?;
            Some(of(cloud.header, Kind::Cloud, (cloud.width, cloud.height)))
        }
        "sensor_msgs/msg/CameraInfo" => {
            let info = CameraInfo::read(bytes)?;
            let calibrated = model_of(&info, (info.width as usize, info.height as usize), 1.0).is_some();
            calibrated.then(|| of(info.header, Kind::Info, (info.width, info.height)))
        }
        _ => None,
    })
}

/// A topic's namespace and its last part.
fn split(topic: &str) -> (&str, &str) {
    topic.rsplit_once('/').unwrap_or(("", topic))
}

fn parts(namespace: &str) -> impl Iterator<Item = &str> {
    namespace.split('/').filter(|part| !part.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sources::synthetic::{self, SyntheticMessage};

    fn chosen(messages: &[SyntheticMessage], wanted: &Topics) -> Option<[String; 3]> {
        let mut survey = Survey::default();
        for message in messages {
            survey.take(&message.channel(), &message.bytes);
        }
        survey.choose(wanted).map(|chosen| [chosen.depth, chosen.info, chosen.color.unwrap_or_default()])
    }

    fn topics(depth: &str, info: &str, color: &str) -> Option<[String; 3]> {
        Some([depth, info, color].map(str::to_owned))
    }

    #[test]
    fn depth_is_chosen_first_and_then_what_belongs_to_its_camera() {
        let (image, info) = (synthetic::image, synthetic::info);
        let wrist = [info("/wrist/camera_info", "wrist", 4), image("/wrist/color", "wrist", "rgb8", 4)];
        let infrared = [image("/front/infra/image", "front_ir", "mono16", 4), image("/front/disparity", "front_ir", "32FC1", 4)];
        let front = [
            info("/front/depth/camera_info", "front", 4),
            image("/front/depth/image", "front", "16UC1", 4),
            image("/front/color/image", "front_color", "rgb8", 4),
        ];
        let messages: Vec<SyntheticMessage> = wrist.into_iter().chain(infrared).chain(front).collect();
        let of = |wanted: Topics| chosen(&messages, &wanted);
        assert_eq!(of(Topics::default()), topics("/front/depth/image", "/front/depth/camera_info", "/front/color/image"));
        let named = Topics { info: Some("/wrist/camera_info".to_owned()), color: Some("/wrist/color".to_owned()), ..Topics::default() };
        assert_eq!(of(named.clone()), topics("/front/depth/image", "/wrist/camera_info", "/wrist/color"));
        let infra = Topics { depth: Some("/front/infra/image".to_owned()), ..named };
        assert_eq!(of(infra), topics("/front/infra/image", "/wrist/camera_info", "/wrist/color"));
        assert_eq!(of(Topics { depth: Some("/nothing".to_owned()), ..Topics::default() }), None);
        assert_eq!(of(Topics { clouds: true, ..Topics::default() }), None);
    }

    #[test]
    fn intrinsics_are_of_the_namespace_or_of_the_frame_and_never_of_another_camera() {
        let (image, info) = (synthetic::image, synthetic::info);
        let depth = || image("/a/depth", "a", "16UC1", 4);
        assert_eq!(chosen(&[info("/b/camera_info", "b", 4), depth()], &Topics::default()), None);
        let frame = [info("/b/camera_info", "b", 4), info("/c/camera_info", "a", 4), depth()];
        assert_eq!(chosen(&frame, &Topics::default()), topics("/a/depth", "/c/camera_info", ""));
        let namespace = [info("/c/camera_info", "a", 4), info("/a/camera_info", "", 4), depth()];
        assert_eq!(chosen(&namespace, &Topics::default()), topics("/a/depth", "/a/camera_info", ""));
        // Another size is another camera's, or another mode's.
        let size = [info("/a/camera_info", "a", 8), info("/c/camera_info", "a", 4), depth()];
        assert_eq!(chosen(&size, &Topics::default()), topics("/a/depth", "/c/camera_info", ""));
        // Of two depth topics the one that can be used.
        let usable = [image("/b/depth", "b", "16UC1", 4), depth(), info("/a/camera_info", "a", 4)];
        assert_eq!(chosen(&usable, &Topics::default()), topics("/a/depth", "/a/camera_info", ""));
    }
}
