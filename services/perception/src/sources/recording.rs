//! Frames from a recording of ROS 2: depth images or organized point clouds, with the camera's intrinsics and color.
//!
//! A recording is an MCAP file, or several that go on where the one before ended. Its beginning is read twice: once to choose the topics,
//! then for the frames. A frame is made of each depth image (or cloud) and the color image with its stamp, which may come before or after
//! it; the newest `CameraInfo` of the same size gives the intrinsics. Depth is taken as registered to color where both have one size, and
//! frames that do not differ.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use repose_proto::Frame;

use super::SourceError;
use super::assembly::Assembly;
use super::messages::Messages;
use super::survey::{Chosen, Survey, Topics};

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
    /// Why it ends early, which is told after the frames that were waiting then.
    damage: Option<SourceError>,
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
        Ok(Self { path: path.to_owned(), topics, files, messages, assembly: None, damage: None, ended: false })
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
        let lacks_color = survey.lacks_color(&self.topics);
        let lacks = self.lacks(&survey.listing());
        Err(match (failed, survey.unreadable()) {
            (Some(error), _) => error,
            // Where color is missing, what cannot be read is at fault only if it is that.
            (None, Some((topic, error))) if lacks_color.is_none() || self.topics.color.as_ref() == Some(&topic) => {
                SourceError::Message { path: self.path.clone(), topic, error }
            }
            (None, _) => SourceError::Empty { path: self.path.clone(), lacks: lacks_color.unwrap_or(lacks) },
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
            if let Some(color) = &chosen.unregistered {
                let depth = &chosen.depth;
                tracing::warn!(%color, %depth, "color is of another frame than depth and left out; name its topic where it is registered");
            }
            self.assembly = Some(Assembly::new(chosen, &self.topics));
        }
        let Some(assembly) = &mut self.assembly else { return Ok(None) };
        while let Some(messages) = &mut self.messages {
            let at = |path: &Path, topic: String, error| SourceError::Message { path: path.to_owned(), topic, error };
            if let Some(frame) = assembly.ready().map_err(|error| at(messages.path(), assembly.chosen().depth.clone(), error))? {
                return Ok(Some(frame));
            }
            match messages.next(|channel, _, bytes| assembly.take(channel, bytes).map_err(|error| (channel.topic.clone(), error))) {
                Ok(Some(taken)) => taken.map_err(|(topic, error)| at(messages.path(), topic, error))?,
                Ok(None) => self.messages = self.files.pop_front().map(|file| Messages::open(&file)).transpose()?,
                Err(damage) => {
                    (self.damage, self.messages) = (Some(damage), None);
                    self.files.clear();
                }
            }
        }
        let topic = assembly.chosen().depth.clone();
        let waiting = assembly.finish().map_err(|error| SourceError::Message { path: self.path.clone(), topic, error })?;
        match (waiting, self.damage.take()) {
            (None, Some(damage)) => Err(damage),
            (waiting, damage) => {
                self.damage = damage;
                Ok(waiting)
            }
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sources::{self, synthetic};
    use repose_ros_messages::MessageError;

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

    #[test]
    fn what_waits_when_a_recording_is_cut_off_are_frames_and_then_that_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("recording.mcap");
        let (image, info) = (synthetic::image, synthetic::info);
        let mut later = image("/a/depth", "a", "16UC1", 4);
        later.bytes[4..8].copy_from_slice(&8u32.to_le_bytes());
        // The color of the second depth image, for which that waits, is behind the cut.
        let seen = [info("/a/camera_info", "a", 4), image("/a/color", "a", "rgb8", 4), image("/a/depth", "a", "16UC1", 4), later];
        synthetic::record(&file, &seen);
        let whole = std::fs::read(&file).unwrap();
        std::fs::write(&file, &whole[..whole.len() - 20]).unwrap();
        let frames: Vec<_> = sources::open(&file, &Topics::default()).unwrap().collect();
        let stamps: Vec<u64> = frames.iter().flatten().map(|frame| frame.stamp_ns / 1_000_000_000).collect();
        assert_eq!((stamps, frames.len()), (vec![7, 8], 3));
        assert!(matches!(frames.last(), Some(Err(SourceError::Recording { .. }))));
    }

    #[test]
    fn color_that_is_named_and_does_not_fit_is_an_error_that_names_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("recording.mcap");
        let (image, info) = (synthetic::image, synthetic::info);
        let messages = [
            info("/a/camera_info", "a", 4),
            image("/a/depth", "a", "16UC1", 4),
            image("/a/yuv", "a", "yuv422", 4),
            image("/a/large", "a", "rgb8", 8),
            image("/a/color", "other", "rgb8", 4),
        ];
        synthetic::record(&file, &messages);
        let of = |color: Option<&str>| {
            let topics = Topics { color: color.map(str::to_owned), ..Topics::default() };
            sources::open(&file, &topics).unwrap().next().unwrap()
        };
        for (topic, why) in [("/nothing", "/a/depth (sensor_msgs/msg/Image)"), ("/a/yuv", "yuv422"), ("/a/large", "8 x 8")] {
            let error = of(Some(topic)).unwrap_err().to_string();
            assert!(error.contains(topic) && error.contains(why), "{error}");
        }
        assert!(of(Some("/a/color")).unwrap().color.is_some(), "who names it knows that it is registered");
        assert!(of(None).unwrap().color.is_none(), "which nobody else does");
    }
}
