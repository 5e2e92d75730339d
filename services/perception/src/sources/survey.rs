//! Which topics of a recording make its frames: first a depth topic, then what belongs to its camera.
//!
//! A recording may hold several cameras, and infrared or disparity pictures with the encoding of depth. Intrinsics of another camera
//! would bend every scene without a word, so they are taken only where the namespace or the frame says whose they are.

use std::collections::BTreeMap;

use super::messages::Channel;
use repose_ros_messages::frames::{model_of, picture_size};
use repose_ros_messages::{CameraInfo, Header, MessageError, PointCloud2, RosImage};

/// Encodings of color.
const COLORS: [&str; 4] = ["rgb8", "bgr8", "rgba8", "bgra8"];
/// The same of a topic that is named: all that can be read.
const NAMED_COLORS: [&str; 8] = ["rgb8", "bgr8", "rgba8", "bgra8", "mono8", "8UC1", "8UC3", "8UC4"];

/// Which topics make the frames. Of those that are not named the best fitting ones do.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Topics {
    /// Depth images (`16UC1` or `32FC1`; `mono16`, which is infrared more often, only where named).
    pub depth: Option<String>,
    /// Color images (`rgb8`, `bgr8`, `rgba8`, `bgra8`; whatever else can be read as color only where named) of the depth's size.
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
    /// Color images that would do but for their frame, where there are no others: they are not registered to the depth.
    pub unregistered: Option<String>,
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
    Image {
        encoding: String,
    },
    Cloud,
    /// Intrinsics, and the size of the pictures where those are a part of the whole.
    Info {
        of_part: (u32, u32),
    },
}

impl Kind {
    /// What an image's pixels are.
    fn encoding(&self) -> Option<&str> {
        match self {
            Self::Image { encoding } => Some(encoding),
            Self::Cloud | Self::Info { .. } => None,
        }
    }
}

/// A topic of depth with what belongs to its camera.
struct Source<'a> {
    seen: &'a Seen,
    info: Option<&'a Seen>,
    color: Option<&'a Seen>,
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

    /// The topics that fit: depth with "depth" in its name before others, one that has intrinsics before one that has none, one that has color
    /// before one that has none, then the first. `None` where that one has no intrinsics, or not the color that is named.
    pub fn choose(&self, wanted: &Topics) -> Option<Chosen> {
        let Source { seen, info, color } = self.source(wanted)?;
        if wanted.color.is_some() && color.is_none() {
            return None;
        }
        let others = || self.colors_beside(seen).find(|other| is_of_another_frame(other, seen));
        let unregistered = if color.is_none() { others() } else { None };
        let name = |seen: &Seen| seen.topic.clone();
        Some(Chosen { depth: name(seen), info: name(info?), color: color.map(name), unregistered: unregistered.map(name) })
    }

    /// What is missing where color is named and does not fit to the depth, which there is.
    pub fn lacks_color(&self, wanted: &Topics) -> Option<String> {
        let topic = wanted.color.as_ref()?;
        let Source { seen: depth, color: None, info: Some(_) } = self.source(wanted)? else { return None };
        let image = self.topics.iter().find(|seen| seen.topic == *topic).and_then(|seen| Some((seen, seen.kind.encoding()?)));
        let (width, height) = depth.size;
        Some(match image {
            None => format!("sensor_msgs/msg/Image of color in {topic}; it has {}", self.listing()),
            Some((_, encoding)) if !NAMED_COLORS.contains(&encoding) => {
                format!("{} in {topic}, which is {encoding}", NAMED_COLORS.join(", "))
            }
            Some((seen, _)) => {
                let (columns, rows) = seen.size;
                format!("color of {width} x {height} in {topic}, as depth in {} is, and not of {columns} x {rows}", depth.topic)
            }
        })
    }

    /// The best fitting depth with what belongs to it.
    fn source(&self, wanted: &Topics) -> Option<Source<'_>> {
        let is_named = |name: &Option<String>, seen: &Seen| name.as_ref().is_none_or(|name| *name == seen.topic);
        let is_source = |seen: &&Seen| match &seen.kind {
            Kind::Cloud => wanted.of_clouds() && is_named(&wanted.points, seen),
            Kind::Image { encoding } if !wanted.of_clouds() && is_named(&wanted.depth, seen) => {
                matches!(encoding.as_str(), "16UC1" | "32FC1") || (encoding == "mono16" && wanted.depth.is_some())
            }
            _ => false,
        };
        let depths = self.topics.iter().filter(is_source);
        let sources = depths.map(|seen| Source { seen, info: self.info_of(seen, wanted), color: self.color_of(seen, wanted) });
        let other_name = |source: &Source<'_>| !wanted.of_clouds() && !source.seen.topic.to_lowercase().contains("depth");
        sources.min_by_key(|source| (other_name(source), source.info.is_none(), source.color.is_none()))
    }

    /// The intrinsics of a source: as named, else those of its size beside it in its namespace, else those of its size and frame.
    fn info_of(&self, source: &Seen, wanted: &Topics) -> Option<&Seen> {
        let is_theirs = |seen: &&Seen| matches!(seen.kind, Kind::Info { of_part } if [seen.size, of_part].contains(&source.size));
        let infos = self.topics.iter().filter(is_theirs);
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

    /// The color images of a source: as named, else those of its frame, else those that share most of its namespace; all of its size.
    fn color_of(&self, source: &Seen, wanted: &Topics) -> Option<&Seen> {
        if let Some(name) = &wanted.color {
            let is_color = |seen: &&Seen| seen.kind.encoding().is_some_and(|encoding| NAMED_COLORS.contains(&encoding));
            return self.topics.iter().filter(is_color).find(|seen| seen.topic == *name && seen.size == source.size);
        }
        let theirs = self.colors_beside(source).filter(|color| !is_of_another_frame(color, source));
        // Of equal ones the first: the last of the reversed.
        theirs.rev().max_by_key(|color| (is_of_same_frame(color, source), shared_namespace(color, source)))
    }

    /// The color images of a source's size that seem to be of its camera.
    fn colors_beside(&self, source: &Seen) -> impl DoubleEndedIterator<Item = &Seen> {
        let is_color = |seen: &Seen| seen.kind.encoding().is_some_and(|encoding| COLORS.contains(&encoding));
        let is_beside = move |color: &Seen| split(&color.topic).0 == split(&source.topic).0 || shared_namespace(color, source) > 0;
        let colors = self.topics.iter().filter(move |seen| is_color(seen) && seen.size == source.size);
        colors.filter(move |color| is_of_same_frame(color, source) || is_beside(color))
    }
}

/// Whether two topics are known to be of one frame.
fn is_of_same_frame(one: &Seen, other: &Seen) -> bool {
    one.frame_id == other.frame_id && !one.frame_id.is_empty()
}

/// Whether two topics are known to be of two frames.
fn is_of_another_frame(one: &Seen, other: &Seen) -> bool {
    one.frame_id != other.frame_id && !one.frame_id.is_empty() && !other.frame_id.is_empty()
}

/// How many parts of their namespaces, from the first on, two topics share.
fn shared_namespace(one: &Seen, other: &Seen) -> usize {
    parts(split(&one.topic).0).zip(parts(split(&other.topic).0)).take_while(|(a, b)| a == b).count()
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
            let of_part = picture_size(&info);
            calibrated.then(|| of(info.header, Kind::Info { of_part }, (info.width, info.height)))
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
    use repose_ros_messages::encode;

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
        // Another frame is another place: what is of one size is not yet registered.
        assert_eq!(of(Topics::default()), topics("/front/depth/image", "/front/depth/camera_info", ""));
        let named = Topics { info: Some("/wrist/camera_info".to_owned()), color: Some("/wrist/color".to_owned()), ..Topics::default() };
        assert_eq!(of(named.clone()), topics("/front/depth/image", "/wrist/camera_info", "/wrist/color"));
        let infra = Topics { depth: Some("/front/infra/image".to_owned()), ..named };
        assert_eq!(of(infra), topics("/front/infra/image", "/wrist/camera_info", "/wrist/color"));
        assert_eq!(of(Topics { depth: Some("/nothing".to_owned()), ..Topics::default() }), None);
        assert_eq!(of(Topics { clouds: true, ..Topics::default() }), None);
    }

    #[test]
    fn depth_that_is_registered_to_color_is_chosen_before_depth_that_is_not() {
        let (image, info) = (synthetic::image, synthetic::info);
        let raw =
            [image("/camera/depth/image_rect_raw", "depth_optical", "16UC1", 4), info("/camera/depth/camera_info", "depth_optical", 4)];
        let color = [image("/camera/color/image_raw", "color_optical", "rgb8", 4), info("/camera/color/camera_info", "color_optical", 4)];
        let aligned = [
            image("/camera/aligned_depth_to_color/image_raw", "color_optical", "16UC1", 4),
            info("/camera/aligned_depth_to_color/camera_info", "color_optical", 4),
        ];
        let alone: Vec<SyntheticMessage> = raw.into_iter().chain(color).collect();
        let raw_depth = ["/camera/depth/image_rect_raw", "/camera/depth/camera_info"];
        assert_eq!(chosen(&alone, &Topics::default()), topics(raw_depth[0], raw_depth[1], ""));
        let mut survey = Survey::default();
        alone.iter().for_each(|message| survey.take(&message.channel(), &message.bytes));
        let unregistered = survey.choose(&Topics::default()).and_then(|chosen| chosen.unregistered);
        assert_eq!(unregistered.as_deref(), Some("/camera/color/image_raw"));
        let all: Vec<SyntheticMessage> = alone.into_iter().chain(aligned).collect();
        let of_aligned = ["image_raw", "camera_info"].map(|name| format!("/camera/aligned_depth_to_color/{name}"));
        assert_eq!(chosen(&all, &Topics::default()), topics(&of_aligned[0], &of_aligned[1], "/camera/color/image_raw"));
        // Where a frame is not told, size and namespace must do.
        let untold =
            [image("/b/depth/image", "", "16UC1", 4), info("/b/depth/camera_info", "", 4), image("/b/color/image", "b", "rgb8", 4)];
        assert_eq!(chosen(&untold, &Topics::default()), topics("/b/depth/image", "/b/depth/camera_info", "/b/color/image"));
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
        // A camera that bins tells the whole picture's.
        let whole = info("/a/camera_info", "a", 8);
        let halved = CameraInfo { binning_x: 2, binning_y: 2, ..CameraInfo::read(&whole.bytes).unwrap() };
        let binned = SyntheticMessage { bytes: encode(&halved, "sensor_msgs/msg/CameraInfo").unwrap(), ..whole };
        assert_eq!(chosen(&[binned, depth()], &Topics::default()), topics("/a/depth", "/a/camera_info", ""));
        // Of two depth topics the one that can be used.
        let usable = [image("/b/depth", "b", "16UC1", 4), depth(), info("/a/camera_info", "a", 4)];
        assert_eq!(chosen(&usable, &Topics::default()), topics("/a/depth", "/a/camera_info", ""));
    }
}
