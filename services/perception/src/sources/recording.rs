//! Frames from a recording of ROS 2: depth images or organized point clouds, with the camera's intrinsics and color.
//!
//! A recording is an MCAP file, or several that go on where the one before ended. Its beginning is read twice: once to choose the topics,
//! then for the frames. A frame is made of each depth image (or cloud) and the color image with its stamp, which may come before or after
//! it; the newest `CameraInfo` of the same size gives the intrinsics. Pictures are taken as rectified, and depth as registered to color
//! where both have one size.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use repose_proto::{CameraModel, Frame};
use repose_ros_messages::frames::{
    CloudPicture, DEPTH_UNIT_M, SampledPoint, check_rays, color_of, depth_of_cloud, depth_of_image, model_of,
};
use repose_ros_messages::{CameraInfo, MessageError, PointCloud2, RosImage};

use super::SourceError;
use super::messages::{Channel, Messages};
use super::survey::{Chosen, Survey, Topics};

/// A color image belongs to a depth image when their stamps are at most this far apart.
const SAME_INSTANT_NS: u64 = 17_000_000;
/// How much of a recording topics are chosen from: this much where depth, intrinsics and color are found in it …
const SURVEY_LEAST_NS: u64 = 1_000_000_000;
/// … this much where there seems to be no color, and as much as it takes to find depth and its intrinsics.
const SURVEY_MOST_NS: u64 = 5_000_000_000;

/// A recording that is being read.
pub struct Recording {
    /// What was asked for: a file, or the folder of the files.
    path: PathBuf,
    topics: Topics,
    /// The files that are not read yet.
    files: VecDeque<PathBuf>,
    /// The one that is.
    messages: Option<Messages>,
    /// None until topics were chosen.
    assembly: Option<Assembly>,
    ended: bool,
}

impl Recording {
    /// Opens the files of a recording, in order; `path` is what the user calls it.
    ///
    /// # Errors
    /// [`SourceError::File`] when the first is not there.
    pub fn open(path: &Path, files: Vec<PathBuf>, topics: Topics) -> Result<Self, SourceError> {
        let mut files = VecDeque::from(files);
        let messages = files.pop_front().map(|first| Messages::open(&first)).transpose()?;
        Ok(Self { path: path.to_owned(), topics, files, messages, assembly: None, ended: false })
    }

    /// The topics that the frames are made of.
    fn choose(&self) -> Result<Chosen, SourceError> {
        let mut survey = Survey::default();
        let mut began_ns = None;
        let mut failed = None;
        for file in self.messages.iter().map(Messages::path).chain(self.files.iter().map(PathBuf::as_path)) {
            // What a damaged file holds up to there counts; its fault is told when its frames are read, or where nothing was found.
            match self.survey(file, &mut survey, &mut began_ns) {
                Ok(true) => break,
                Ok(false) => {}
                Err(error) => {
                    failed.get_or_insert(error);
                }
            }
        }
        if let Some(chosen) = survey.choose(&self.topics) {
            return Ok(chosen);
        }
        let lacks = self.lacks(&survey.listing());
        Err(match (failed, survey.unreadable()) {
            (Some(error), _) => error,
            (None, Some((topic, error))) => SourceError::Message { path: self.path.clone(), topic, error },
            (None, None) => SourceError::Empty { path: self.path.clone(), lacks },
        })
    }

    /// Takes note of a file's messages; whether that is enough.
    fn survey(&self, file: &Path, survey: &mut Survey, began_ns: &mut Option<u64>) -> Result<bool, SourceError> {
        let mut messages = Messages::open(file)?;
        while let Some(log_ns) = messages.next(|channel, log_ns, bytes| {
            survey.take(channel, bytes);
            log_ns
        })? {
            let seen_ns = log_ns.saturating_sub(*began_ns.get_or_insert(log_ns));
            if seen_ns >= SURVEY_LEAST_NS
                && let Some(chosen) = survey.choose(&self.topics)
                && (chosen.color.is_some() || seen_ns >= SURVEY_MOST_NS)
            {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// What to say where nothing fits.
    fn lacks(&self, listing: &str) -> String {
        let wanted = if self.topics.of_clouds() { "organized sensor_msgs/msg/PointCloud2" } else { "sensor_msgs/msg/Image of depth" };
        format!("{wanted} and sensor_msgs/msg/CameraInfo of its size, in its namespace or frame unless topics are named; it has {listing}")
    }

    /// The next frame; `None` at the end.
    fn frame(&mut self) -> Result<Option<Frame>, SourceError> {
        if self.assembly.is_none() {
            let chosen = self.choose()?;
            tracing::debug!(?chosen, "topics of the recording");
            self.assembly = Some(Assembly::new(chosen));
        }
        let Some(assembly) = &mut self.assembly else { return Ok(None) };
        while let Some(messages) = &mut self.messages {
            let at = |path: &Path, topic: String, error| SourceError::Message { path: path.to_owned(), topic, error };
            if let Some(frame) = assembly.ready().map_err(|error| at(messages.path(), assembly.chosen.depth.clone(), error))? {
                return Ok(Some(frame));
            }
            match messages.next(|channel, _, bytes| assembly.take(channel, bytes).map_err(|error| (channel.topic.clone(), error)))? {
                Some(taken) => taken.map_err(|(topic, error)| at(messages.path(), topic, error))?,
                None => self.messages = self.files.pop_front().map(|file| Messages::open(&file)).transpose()?,
            }
        }
        let topic = assembly.chosen.depth.clone();
        assembly.finish().map_err(|error| SourceError::Message { path: self.path.clone(), topic, error })
    }
}

impl Iterator for Recording {
    type Item = Result<Frame, SourceError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let next = self.frame().transpose();
        // After an error nobody knows what else is wrong.
        self.ended = !matches!(next, Some(Ok(_)));
        next
    }
}

/// Puts frames together from messages in the order of the file.
#[derive(Debug)]
struct Assembly {
    chosen: Chosen,
    info: Option<CameraInfo>,
    color: Option<Color>,
    /// The depth that waits for its color and intrinsics.
    waiting: Option<Depth>,
    /// A depth whose wait is over because the next one came.
    overtaken: Option<Depth>,
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
    /// Points of a cloud, to be held against the camera.
    sample: Vec<SampledPoint>,
}

impl Assembly {
    fn new(chosen: Chosen) -> Self {
        Self { chosen, info: None, color: None, waiting: None, overtaken: None }
    }

    fn take(&mut self, channel: &Channel, bytes: &[u8]) -> Result<(), MessageError> {
        let Chosen { depth, info, color } = &self.chosen;
        match channel.schema.as_str() {
            "sensor_msgs/msg/CameraInfo" if channel.topic == *info => self.info = Some(CameraInfo::read(bytes)?),
            "sensor_msgs/msg/PointCloud2" if channel.topic == *depth => {
                let cloud = PointCloud2::read(bytes)?;
                let CloudPicture { counts, colors, sample } = depth_of_cloud(&cloud)?;
                let size = (cloud.width as usize, cloud.height as usize);
                self.put_depth(Depth { stamp_ns: cloud.header.stamp.as_ns(), size, counts, unit_m: DEPTH_UNIT_M, colors, sample });
            }
            "sensor_msgs/msg/Image" if channel.topic == *depth => {
                let image = RosImage::read(bytes)?;
                let (stamp_ns, size) = (image.header.stamp.as_ns(), (image.width as usize, image.height as usize));
                let (counts, unit_m) = depth_of_image(&image)?;
                self.put_depth(Depth { stamp_ns, size, counts, unit_m, colors: None, sample: Vec::new() });
            }
            "sensor_msgs/msg/Image" if color.as_ref() == Some(&channel.topic) => {
                let image = RosImage::read(bytes)?;
                let (stamp_ns, size) = (image.header.stamp.as_ns(), (image.width as usize, image.height as usize));
                self.color = Some(Color { stamp_ns, size, pixels: color_of(&image)? });
            }
            _ => {}
        }
        Ok(())
    }

    fn put_depth(&mut self, depth: Depth) {
        self.overtaken = self.waiting.replace(depth);
    }

    /// A frame that needs to wait no longer.
    fn ready(&mut self) -> Result<Option<Frame>, MessageError> {
        if let Some(depth) = self.overtaken.take() {
            return self.frame(depth);
        }
        let Some(waiting) = &self.waiting else { return Ok(None) };
        let has_color = waiting.colors.is_some() || self.color.as_ref().is_some_and(|c| belongs(c, waiting));
        if !has_color || self.model(waiting).is_none() {
            return Ok(None);
        }
        self.finish()
    }

    /// The last frame, with what there is.
    fn finish(&mut self) -> Result<Option<Frame>, MessageError> {
        self.waiting.take().map_or(Ok(None), |depth| self.frame(depth))
    }

    fn model(&self, depth: &Depth) -> Option<CameraModel> {
        self.info.as_ref().and_then(|info| model_of(info, depth.size, depth.unit_m))
    }

    fn frame(&mut self, depth: Depth) -> Result<Option<Frame>, MessageError> {
        let Some(camera) = self.model(&depth) else { return Ok(None) };
        check_rays(&depth.sample, &camera)?;
        let of_image = self.color.as_ref().filter(|c| belongs(c, &depth)).map(|c| c.pixels.clone());
        let color = depth.colors.or(of_image);
        Ok(Some(Frame { color, ..Frame::new("recording".to_owned(), depth.stamp_ns, camera, depth.counts) }))
    }
}

fn belongs(color: &Color, depth: &Depth) -> bool {
    color.size == depth.size && color.stamp_ns.abs_diff(depth.stamp_ns) <= SAME_INSTANT_NS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sources::{self, synthetic};

    #[test]
    fn a_recording_goes_on_in_its_next_file_with_what_the_first_one_told() {
        let folder = tempfile::tempdir().unwrap();
        let (image, info) = (synthetic::image, synthetic::info);
        let depth = |side| image("/a/depth", "a", "16UC1", side);
        synthetic::record(
            &folder.path().join("split_0.mcap"),
            &[info("/a/camera_info", "a", 4), depth(4), image("/b/ir", "b", "16UC1", 4)],
        );
        // The other camera's images come first here, and no intrinsics at all.
        synthetic::record(&folder.path().join("split_1.mcap"), &[image("/b/ir", "b", "16UC1", 4), depth(4), depth(4)]);
        let frames: Vec<_> = sources::open(folder.path(), &Topics::default()).unwrap().collect::<Result<_, _>>().unwrap();
        assert_eq!(frames.len(), 3);
        assert!(frames.iter().all(|frame| frame.camera.fx == 5.0 && frame.depth == [1000; 16]));
    }

    #[test]
    fn another_cameras_intrinsics_are_not_used_and_a_cloud_must_be_in_the_cameras_frame() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("recording.mcap");
        let first = |messages: &[synthetic::SyntheticMessage], topics: &Topics| {
            synthetic::record(&file, messages);
            sources::open(&file, topics).unwrap().next().unwrap()
        };
        let messages = [synthetic::info("/b/camera_info", "b", 4), synthetic::image("/a/depth", "a", "16UC1", 4)];
        let error = first(&messages, &Topics::default()).unwrap_err();
        assert!(matches!(&error, SourceError::Empty { lacks, .. } if lacks.contains("/b/camera_info")), "{error}");
        let named = Topics { info: Some("/b/camera_info".to_owned()), ..Topics::default() };
        assert_eq!(first(&messages, &named).unwrap().depth, [1000; 16]);
        let tilted = synthetic::cloud("/b/points", "robot", 40, |row, column| [1.0, column as f32, row as f32]);
        let error =
            first(&[synthetic::info("/b/camera_info", "b", 40), tilted], &Topics { clouds: true, ..Topics::default() }).unwrap_err();
        assert!(matches!(error, SourceError::Message { error: MessageError::NotOptical { .. }, .. }), "{error}");
    }
}
