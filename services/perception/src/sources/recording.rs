//! Frames from an MCAP recording of ROS 2: depth images or organised point clouds, with the camera's intrinsics and color.
//!
//! The file is read from front to back, chunk by chunk, so that its size does not matter. A frame is made of each depth image (or cloud)
//! and the color image with its stamp, which may come before or after it; the newest `CameraInfo` of the same size gives the intrinsics.
//! Pictures are taken as rectified, and depth as registered to color where both have one size.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use repose_proto::{CameraModel, Frame};

use super::SourceError;
use super::ros_frames::{CloudPicture, DEPTH_UNIT_M, color_of, depth_of_cloud, depth_of_image, model_of};
use super::ros_messages::{CameraInfo, MessageError, PointCloud2, RosImage};

/// Largest record that is read, bytes; what claims to be larger is refused before memory is taken.
const MAX_RECORD_BYTES: usize = 256 << 20;
/// A color image belongs to a depth image when their stamps are at most this far apart.
const SAME_INSTANT_NS: u64 = 17_000_000;

/// Which topics of a recording make the frames. A topic that is not named is the first of its kind.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Topics {
    /// Depth images (`16UC1`, `mono16` or `32FC1`).
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

/// A recording that is being read.
pub struct Recording {
    path: PathBuf,
    file: File,
    reader: LinearReader,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Channel>,
    assembly: Assembly,
    ended: bool,
}

/// Where messages of one topic go.
#[derive(Debug, Clone)]
struct Channel {
    topic: String,
    schema: String,
}

impl Recording {
    /// Opens a file.
    ///
    /// # Errors
    /// [`SourceError::File`] when there is none.
    pub fn open(path: &Path, topics: Topics) -> Result<Self, SourceError> {
        let file = File::open(path).map_err(|source| SourceError::File { path: path.to_owned(), source })?;
        let options = LinearReaderOptions::default().with_validate_chunk_crcs(true).with_record_length_limit(MAX_RECORD_BYTES);
        Ok(Self {
            path: path.to_owned(),
            file,
            reader: LinearReader::new_with_options(options),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            assembly: Assembly::new(topics),
            ended: false,
        })
    }

    /// Reads on to the next message that matters; false at the end.
    fn advance(&mut self) -> Result<bool, SourceError> {
        let broken = |e: &dyn std::fmt::Display| SourceError::Recording { path: self.path.clone(), reason: e.to_string() };
        while let Some(event) = self.reader.next_event() {
            match event.map_err(|e| broken(&e))? {
                LinearReadEvent::ReadRequest(bytes) => {
                    let read = self.file.read(self.reader.insert(bytes));
                    let read = read.map_err(|source| SourceError::File { path: self.path.clone(), source })?;
                    self.reader.notify_read(read);
                }
                LinearReadEvent::Record { data, opcode } => match mcap::parse_record(opcode, data).map_err(|e| broken(&e))? {
                    Record::Schema { header, .. } => {
                        self.schemas.insert(header.id, header.name);
                    }
                    Record::Channel(channel) => {
                        let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                        self.channels.insert(channel.id, Channel { topic: channel.topic, schema });
                    }
                    Record::Message { header, data } => {
                        let Some(channel) = self.channels.get(&header.channel_id) else { continue };
                        let taken = self.assembly.take(channel, &data);
                        taken.map_err(|error| SourceError::Message { path: self.path.clone(), topic: channel.topic.clone(), error })?;
                        return Ok(true);
                    }
                    _ => {}
                },
            }
        }
        Ok(false)
    }
}

impl Iterator for Recording {
    type Item = Result<Frame, SourceError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.ended {
            if let Some(frame) = self.assembly.ready() {
                return Some(Ok(frame));
            }
            match self.advance() {
                Ok(true) => {}
                Ok(false) => {
                    self.ended = true;
                    let last = self.assembly.finish();
                    let lacks = || SourceError::Empty { path: self.path.clone(), lacks: self.assembly.lacks() };
                    return last.map(Ok).or_else(|| (self.assembly.made == 0).then(|| Err(lacks())));
                }
                Err(error) => {
                    self.ended = true;
                    return Some(Err(error));
                }
            }
        }
        None
    }
}

/// Puts frames together from messages in the order of the file.
#[derive(Debug)]
struct Assembly {
    topics: Topics,
    info: Option<CameraInfo>,
    color: Option<Color>,
    /// The depth that waits for its color and intrinsics.
    waiting: Option<Depth>,
    /// A depth whose wait is over because the next one came.
    overtaken: Option<Depth>,
    seen: BTreeMap<String, String>,
    made: usize,
}

#[derive(Debug)]
struct Color {
    stamp_ns: u64,
    size: (usize, usize),
    pixels: Vec<[u8; 3]>,
}

#[derive(Debug)]
struct Depth {
    stamp_ns: u64,
    size: (usize, usize),
    counts: Vec<u16>,
    unit_m: f64,
    /// A cloud's own colors.
    colors: Option<Vec<[u8; 3]>>,
}

impl Assembly {
    fn new(topics: Topics) -> Self {
        let clouds = topics.clouds || topics.points.is_some();
        Self {
            topics: Topics { clouds, ..topics },
            info: None,
            color: None,
            waiting: None,
            overtaken: None,
            seen: BTreeMap::new(),
            made: 0,
        }
    }

    fn take(&mut self, channel: &Channel, bytes: &[u8]) -> Result<(), MessageError> {
        self.seen.entry(channel.topic.clone()).or_insert_with(|| channel.schema.clone());
        match channel.schema.as_str() {
            "sensor_msgs/msg/CameraInfo" if chosen(&mut self.topics.info, &channel.topic) => self.info = Some(CameraInfo::read(bytes)?),
            "sensor_msgs/msg/PointCloud2" if self.topics.clouds && chosen(&mut self.topics.points, &channel.topic) => {
                let cloud = PointCloud2::read(bytes)?;
                let CloudPicture { counts, colors } = depth_of_cloud(&cloud)?;
                let size = (cloud.width as usize, cloud.height as usize);
                self.put_depth(Depth { stamp_ns: cloud.header.stamp.as_ns(), size, counts, unit_m: DEPTH_UNIT_M, colors });
            }
            "sensor_msgs/msg/Image" => self.take_image(&RosImage::read(bytes)?, &channel.topic)?,
            _ => {}
        }
        Ok(())
    }

    fn take_image(&mut self, image: &RosImage, topic: &str) -> Result<(), MessageError> {
        let (stamp_ns, size) = (image.header.stamp.as_ns(), (image.width as usize, image.height as usize));
        match image.encoding.as_str() {
            "16UC1" | "mono16" | "32FC1" if !self.topics.clouds && chosen(&mut self.topics.depth, topic) => {
                let (counts, unit_m) = depth_of_image(image)?;
                self.put_depth(Depth { stamp_ns, size, counts, unit_m, colors: None });
            }
            "rgb8" | "bgr8" | "rgba8" | "bgra8" if chosen(&mut self.topics.color, topic) => {
                self.color = Some(Color { stamp_ns, size, pixels: color_of(image)? });
            }
            // Infrared and the like travel as images too.
            _ => {}
        }
        Ok(())
    }

    fn put_depth(&mut self, depth: Depth) {
        self.overtaken = self.waiting.replace(depth);
    }

    /// A frame that needs to wait no longer.
    fn ready(&mut self) -> Option<Frame> {
        if let Some(depth) = self.overtaken.take() {
            return self.frame(depth);
        }
        let waiting = self.waiting.as_ref()?;
        let color_is_there = waiting.colors.is_some() || self.color.as_ref().is_some_and(|c| belongs(c, waiting));
        if !color_is_there || self.model(waiting).is_none() {
            return None;
        }
        let depth = self.waiting.take()?;
        self.frame(depth)
    }

    /// The last frame, with what there is.
    fn finish(&mut self) -> Option<Frame> {
        let depth = self.waiting.take()?;
        self.frame(depth)
    }

    fn model(&self, depth: &Depth) -> Option<CameraModel> {
        self.info.as_ref().and_then(|info| model_of(info, depth.size, depth.unit_m))
    }

    fn frame(&mut self, depth: Depth) -> Option<Frame> {
        let camera = self.model(&depth)?;
        let of_image = self.color.as_ref().filter(|c| belongs(c, &depth)).map(|c| c.pixels.clone());
        self.made += 1;
        Some(Frame {
            camera_name: "recording".to_owned(),
            stamp_ns: depth.stamp_ns,
            camera,
            color: depth.colors.or(of_image),
            depth: depth.counts,
            labels: None,
        })
    }

    /// Why there was no frame.
    fn lacks(&self) -> String {
        let wanted = if self.topics.clouds { "organised sensor_msgs/msg/PointCloud2" } else { "sensor_msgs/msg/Image of depth" };
        let topics: Vec<String> = self.seen.iter().map(|(topic, schema)| format!("{topic} ({schema})")).collect();
        format!("{wanted} and sensor_msgs/msg/CameraInfo of its size; it has {}", topics.join(", "))
    }
}

/// Whether a topic is the one to use; the first of its kind becomes it.
fn chosen(wanted: &mut Option<String>, topic: &str) -> bool {
    wanted.get_or_insert_with(|| topic.to_owned()) == topic
}

fn belongs(color: &Color, depth: &Depth) -> bool {
    color.size == depth.size && color.stamp_ns.abs_diff(depth.stamp_ns) <= SAME_INSTANT_NS
}
