//! Frames of a recording from its messages, in the order of the file: depth, the color of its instant, and the newest intrinsics.
//!
//! A depth image takes the color that is nearest to its stamp. Drivers may write that a few images later: depth waits until it has come, or a
//! later one, or a few more depth images. Pictures that the lens bends, by the intrinsics and by the name of the topic, are straightened as the
//! bridge of ROS 2 does it.

use std::collections::VecDeque;

use repose_proto::Frame;
use repose_ros_messages::cloud::{self, Sight};
use repose_ros_messages::frames::model_of;
use repose_ros_messages::pictures::{self, Color};
use repose_ros_messages::view::{View, is_rectified_topic};
use repose_ros_messages::{CameraInfo, MessageError, PointCloud2, RosImage};

use super::messages::Channel;
use super::survey::{Chosen, Topics};

/// A color image belongs to a depth image when their stamps are at most this far apart, nanoseconds.
const SAME_INSTANT_NS: u64 = 17_000_000;
/// Stamps further apart than this are those of a clock that began anew, nanoseconds.
const OTHER_CLOCK_NS: u64 = 10_000_000_000;
/// Color images that are kept.
const MOST_COLORS: usize = 8;
/// A depth image waits for its color until so many more have come.
const MOST_BEHIND: usize = 4;

/// Puts frames together from messages in the order of the file.
#[derive(Debug)]
pub struct Assembly {
    chosen: Chosen,
    /// Whether the pictures are straight whatever the intrinsics say of the lens.
    is_rectified: bool,
    info: Option<CameraInfo>,
    /// The camera by these intrinsics.
    view: Option<View>,
    /// In the order of the file, the newest last.
    colors: VecDeque<Stamped<Color>>,
    /// Depth that waits for its color and intrinsics.
    depths: VecDeque<Stamped<Sight>>,
}

/// What was seen at an instant.
#[derive(Debug)]
struct Stamped<T> {
    stamp_ns: u64,
    seen: T,
}

impl Assembly {
    /// Nothing so far, of the topics that were `chosen` by what was `wanted`.
    pub fn new(chosen: Chosen, wanted: &Topics) -> Self {
        let is_rectified = wanted.of_clouds() || is_rectified_topic(&chosen.depth);
        Self { chosen, is_rectified, info: None, view: None, colors: VecDeque::new(), depths: VecDeque::new() }
    }

    /// The topics that the frames are made of.
    pub fn chosen(&self) -> &Chosen {
        &self.chosen
    }

    /// Takes a message of any topic.
    ///
    /// # Errors
    /// [`MessageError`] for one that frames are made of and that cannot be read.
    pub fn take(&mut self, channel: &Channel, bytes: &[u8]) -> Result<(), MessageError> {
        let Chosen { depth, info, color, .. } = &self.chosen;
        match channel.schema.as_str() {
            "sensor_msgs/msg/CameraInfo" if channel.topic == *info => self.put_info(CameraInfo::read(bytes)?),
            "sensor_msgs/msg/PointCloud2" if channel.topic == *depth => {
                let points = PointCloud2::read(bytes)?;
                self.depths.push_back(Stamped { stamp_ns: points.header.stamp.as_ns(), seen: cloud::sight(&points)? });
            }
            "sensor_msgs/msg/Image" if channel.topic == *depth => {
                let image = RosImage::read(bytes)?;
                self.depths.push_back(Stamped { stamp_ns: image.header.stamp.as_ns(), seen: pictures::depth(&image)?.into() });
            }
            "sensor_msgs/msg/Image" if color.as_ref() == Some(&channel.topic) => {
                let image = RosImage::read(bytes)?;
                self.colors.push_back(Stamped { stamp_ns: image.header.stamp.as_ns(), seen: pictures::color(&image)? });
                if self.colors.len() > MOST_COLORS {
                    self.colors.pop_front();
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn put_info(&mut self, info: CameraInfo) {
        let is_same = self.info.as_ref().is_some_and(|held| CameraInfo { header: info.header.clone(), ..held.clone() } == info);
        if !is_same {
            self.view = None;
        }
        self.info = Some(info);
    }

    /// A frame that needs to wait no longer.
    ///
    /// # Errors
    /// [`MessageError`] for intrinsics that are not its camera's, and for a lens that cannot be taken out.
    pub fn ready(&mut self) -> Result<Option<Frame>, MessageError> {
        while self.depths.front().is_some_and(|first| !self.waits(first)) {
            if let Some(frame) = self.first()? {
                return Ok(Some(frame));
            }
        }
        Ok(None)
    }

    /// One of the last frames, with what there is.
    ///
    /// # Errors
    /// As [`Self::ready`].
    pub fn finish(&mut self) -> Result<Option<Frame>, MessageError> {
        while !self.depths.is_empty() {
            if let Some(frame) = self.first()? {
                return Ok(Some(frame));
            }
        }
        Ok(None)
    }

    /// Whether the first depth image waits for what may come.
    fn waits(&self, first: &Stamped<Sight>) -> bool {
        let behind = self.depths.len().saturating_sub(1);
        let depth = &first.seen.depth;
        let has_camera = self.info.as_ref().is_some_and(|info| model_of(info, (depth.width, depth.height), depth.unit_m).is_some());
        if !has_camera {
            return behind == 0;
        }
        let needs_none = self.chosen.color.is_none() || first.seen.color.is_some();
        // Of a fast camera the color before is within the limits, too: only one that is not before says that no nearer one can come.
        let is_not_before = |color: &Stamped<Color>| {
            let ahead_ns = color.stamp_ns.checked_sub(first.stamp_ns);
            ahead_ns.is_some_and(|ahead_ns| ahead_ns < OTHER_CLOCK_NS)
        };
        !needs_none && behind < MOST_BEHIND && !self.colors.iter().any(is_not_before)
    }

    /// The color image of a depth image's size and instant, the nearest one.
    fn color_of(&self, of: &Stamped<Sight>) -> Option<&Color> {
        let size = (of.seen.depth.width, of.seen.depth.height);
        let off_ns = |color: &Stamped<Color>| color.stamp_ns.abs_diff(of.stamp_ns);
        let theirs = self.colors.iter().filter(|color| (color.seen.width, color.seen.height) == size && off_ns(color) <= SAME_INSTANT_NS);
        theirs.min_by_key(|color| off_ns(color)).map(|color| &color.seen)
    }

    /// The frame of the first depth image that waits; none without its camera's intrinsics.
    fn first(&mut self) -> Result<Option<Frame>, MessageError> {
        let Some(first) = self.depths.pop_front() else { return Ok(None) };
        let of_image = self.color_of(&first).cloned();
        let Stamped { stamp_ns, seen: Sight { depth, color, sample } } = first;
        if !self.view.as_ref().is_some_and(|view| view.has_size((depth.width, depth.height))) {
            let Some(info) = &self.info else { return Ok(None) };
            self.view = View::of(info, &depth, self.is_rectified)?;
        }
        let Some(view) = &self.view else { return Ok(None) };
        view.check(&sample)?;
        let (camera, depth, color) = view.straight(depth, color.or(of_image));
        Ok(Some(Frame { color: color.map(|color| color.pixels), ..Frame::new("recording".to_owned(), stamp_ns, camera, depth.counts) }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sources::synthetic::{self, SyntheticMessage};
    use repose_ros_messages::encode;

    /// A message with another stamp, milliseconds, and another last byte, which is a picture's.
    fn at(mut message: SyntheticMessage, ms: u32, last: u8) -> SyntheticMessage {
        message.bytes[4..8].copy_from_slice(&(ms / 1000).to_le_bytes());
        message.bytes[8..12].copy_from_slice(&(ms % 1000 * 1_000_000).to_le_bytes());
        *message.bytes.last_mut().unwrap() = last;
        message
    }

    /// The frames of messages, as they become ready.
    fn frames(messages: &[SyntheticMessage]) -> Vec<Frame> {
        let chosen = Chosen {
            depth: "/a/depth".to_owned(),
            info: "/a/camera_info".to_owned(),
            color: Some("/a/color".to_owned()),
            unregistered: None,
        };
        let mut assembly = Assembly::new(chosen, &Topics::default());
        let mut frames = Vec::new();
        for message in messages {
            assembly.take(&message.channel(), &message.bytes).unwrap();
            frames.extend(std::iter::from_fn(|| assembly.ready().unwrap()));
            assert!(assembly.depths.len() <= MOST_BEHIND && assembly.colors.len() <= MOST_COLORS);
        }
        frames.extend(std::iter::from_fn(|| assembly.finish().unwrap()));
        frames
    }

    fn depth(ms: u32) -> SyntheticMessage {
        at(synthetic::image("/a/depth", "a", "16UC1", 4), ms, 3)
    }

    fn color(ms: u32, last: u8) -> SyntheticMessage {
        at(synthetic::image("/a/color", "a", "rgb8", 4), ms, last)
    }

    /// Of each frame its stamp, milliseconds, and the last byte of its color.
    fn paired(messages: &[SyntheticMessage]) -> Vec<(u64, Option<u8>)> {
        let of = |frame: &Frame| (frame.stamp_ns / 1_000_000, frame.color.as_ref().map(|color| color[15][2]));
        frames(messages).iter().map(of).collect()
    }

    #[test]
    fn color_that_is_written_a_few_images_later_or_earlier_is_its_depths() {
        let info = || synthetic::info("/a/camera_info", "a", 4);
        let all = [(1000, Some(0)), (1033, Some(1)), (1066, Some(2)), (1100, Some(3))];
        let (d, c) = ([1000, 1033, 1066, 1100].map(depth), [(1000, 0), (1035, 1), (1064, 2), (1100, 3)].map(|(ms, last)| color(ms, last)));
        let ([d0, d1, d2, d3], [c0, c1, c2, c3]) = (d.clone(), c.clone());
        assert_eq!(paired(&[info(), d0, d1, d2, c0, d3, c1, c2, c3]), all);
        let ([d0, d1, d2, d3], [c0, c1, c2, c3]) = (d, c);
        assert_eq!(paired(&[info(), c0, c1, c2, d0, d1, c3, d2, d3]), all);
    }

    #[test]
    fn depth_of_a_fast_camera_waits_for_its_own_color_though_the_one_before_is_near() {
        let pictures: Vec<SyntheticMessage> =
            [(1000, 0), (1016, 1), (1033, 2)].into_iter().flat_map(|(ms, last)| [depth(ms), color(ms, last)]).collect();
        let messages: Vec<SyntheticMessage> = [synthetic::info("/a/camera_info", "a", 4)].into_iter().chain(pictures).collect();
        assert_eq!(paired(&messages), [(1000, Some(0)), (1016, Some(1)), (1033, Some(2))]);
        // Where no other comes the one before is the nearest.
        assert_eq!(paired(&messages[..4]), [(1000, Some(0)), (1016, Some(0))]);
    }

    #[test]
    fn depth_without_a_color_waits_for_a_later_one_or_some_more_depth() {
        let info = || synthetic::info("/a/camera_info", "a", 4);
        assert_eq!(paired(&[info(), depth(1000), color(1033, 1), depth(1033)]), [(1000, None), (1033, Some(1))]);
        let alone: Vec<SyntheticMessage> = [info()].into_iter().chain((0..7).map(|k| depth(1000 + 33 * k))).collect();
        assert_eq!(paired(&alone), (0..7).map(|k| (1000 + 33 * k, None)).collect::<Vec<(u64, Option<u8>)>>());
        // A clock that begins anew.
        assert_eq!(paired(&[info(), color(90_000, 1), depth(1000), color(1000, 2)]), [(1000, Some(2))]);
    }

    #[test]
    fn a_lens_that_bends_is_taken_out_unless_the_topic_says_that_it_was() {
        let plain = synthetic::info("/a/camera_info", "a", 4);
        let info = CameraInfo::read(&plain.bytes).unwrap();
        let p = [4.0, 0.0, 1.5, 0.0, 0.0, 4.0, 1.5, 0.0, 0.0, 0.0, 1.0, 0.0];
        let bends = CameraInfo { d: vec![3.0, 0.0, 0.0, 0.0, 0.0], p, ..info };
        let bytes = encode(&bends, "sensor_msgs/msg/CameraInfo").unwrap();
        let first = |topic: &str| {
            let messages = [SyntheticMessage { bytes: bytes.clone(), ..plain.clone() }, synthetic::image(topic, "a", "16UC1", 4)];
            let chosen = Chosen { depth: topic.to_owned(), info: "/a/camera_info".to_owned(), color: None, unregistered: None };
            let mut assembly = Assembly::new(chosen, &Topics::default());
            messages.iter().for_each(|message| assembly.take(&message.channel(), &message.bytes).unwrap());
            assembly.ready().unwrap().unwrap()
        };
        let bent = first("/a/depth");
        assert_eq!((bent.camera.fx, bent.depth[0], bent.depth[5]), (5.0, 0, 1000), "the corners of the straight picture lie outside");
        let straight = first("/a/depth_rect");
        assert_eq!((straight.camera.fx, straight.depth), (4.0, vec![1000; 16]));
    }
}
