//! Frames of a folder or a recording, with errors that name the file.

use std::path::Path;

use clap::Args;
use repose_perception::frame_folder::{self, FrameFolderError};
use repose_perception::sources::{self, SourceError, Topics};
use repose_proto::Frame;

use crate::failure::Failure;

/// Which topics of a recording make the frames.
#[derive(Debug, Clone, Args)]
pub struct TopicArgs {
    /// Topic of a recording's depth images. Default: the one with "depth" in its name.
    #[arg(long, value_name = "TOPIC")]
    pub depth_topic: Option<String>,
    /// Topic of a recording's color images. Default: the one with the depth images' size, and their frame or namespace.
    #[arg(long, value_name = "TOPIC")]
    pub color_topic: Option<String>,
    /// Topic of a recording's intrinsics. Default: the one with the depth images' size, and their namespace or frame.
    #[arg(long, value_name = "TOPIC")]
    pub info_topic: Option<String>,
    /// Topic of a recording's organised point clouds, used instead of depth images.
    #[arg(long, value_name = "TOPIC", conflicts_with = "depth_topic")]
    pub points_topic: Option<String>,
    /// Use the recording's first topic of organized point clouds instead of depth images.
    #[arg(long, conflicts_with = "depth_topic")]
    pub clouds: bool,
}

impl TopicArgs {
    /// The first of these options that is given.
    pub fn given(&self) -> Option<&'static str> {
        let given = [
            ("depth-topic", self.depth_topic.is_some()),
            ("color-topic", self.color_topic.is_some()),
            ("info-topic", self.info_topic.is_some()),
            ("points-topic", self.points_topic.is_some()),
            ("clouds", self.clouds),
        ];
        given.into_iter().find(|(_, is_given)| *is_given).map(|(option, _)| option)
    }

    /// Refuses topics of a source that has none.
    pub fn check(&self, source: &Path) -> Result<(), Failure> {
        match self.given() {
            Some(option) if source.exists() && !sources::has_topics(source) => {
                Err(Failure::bad_input(option, format!("{} is no recording, and has no topics", source.display())))
            }
            _ => Ok(()),
        }
    }

    /// As perception takes them.
    pub fn topics(&self) -> Topics {
        Topics {
            depth: self.depth_topic.clone(),
            color: self.color_topic.clone(),
            info: self.info_topic.clone(),
            points: self.points_topic.clone(),
            clouds: self.clouds,
        }
    }
}

/// Reads a frame folder, or the first frame of any other source.
pub fn read(source: &Path) -> Result<Frame, Failure> {
    read_nth(source, 0, &Topics::default())
}

fn read_folder(folder: &Path) -> Result<Frame, Failure> {
    frame_folder::read(folder).map_err(|error| match &error {
        FrameFolderError::Json { path, error } => {
            let field = error.field.as_ref().map_or_else(String::new, |field| format!(": {field}"));
            Failure::bad_input(&format!("{}{field}", path.display()), &error.message)
        }
        other => Failure::bad_input(&other.path().display().to_string(), other),
    })
}

/// The frame of a source at a place in its order; `topics` matter for recordings only.
pub fn read_nth(source: &Path, nth: usize, topics: &Topics) -> Result<Frame, Failure> {
    let bad = |e: SourceError| Failure::bad_input(&e.path().display().to_string(), &e);
    let no_frame = |count: usize| Failure::bad_input("nth", format!("{} has {count} frames, counted from 0", source.display()));
    if !source.exists() {
        return Err(Failure::bad_input(&source.display().to_string(), "no such file or folder"));
    }
    let holds = |name: &str| source.join(name).exists();
    if holds("depth.png") || holds("camera.json") && !holds("depth") {
        // A plain frame folder, whose faults are told by field.
        return if nth == 0 { read_folder(source) } else { Err(no_frame(1)) };
    }
    let mut count = 0;
    for frame in sources::open(source, topics).map_err(bad)? {
        // A fault before it matters: what comes after is not what would have come.
        let frame = frame.map_err(bad)?;
        if count == nth {
            return Ok(frame);
        }
        count += 1;
    }
    Err(no_frame(count))
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_proto::CameraModel;

    #[test]
    fn what_is_wrong_with_the_source_is_said_before_what_is_wrong_with_the_number() {
        let root = tempfile::tempdir().unwrap();
        let camera = CameraModel { width: 2, height: 1, fx: 1.0, fy: 1.0, cx: 0.5, cy: 0.0, depth_unit_m: 0.001, world_from_camera: None };
        for count in 0..3 {
            let frame = Frame::new("folder".to_owned(), 0, camera.clone(), vec![count; 2]);
            frame_folder::write(&root.path().join(format!("frame{count}")), &frame).unwrap();
        }
        let read = |path: &Path, nth| read_nth(path, nth, &Topics::default());
        let error = |path: &Path, nth| {
            let failure = read(path, nth).unwrap_err();
            let error = failure.error().unwrap();
            format!("{}: {}", error.field.as_deref().unwrap_or_default(), error.message)
        };
        assert_eq!(read(root.path(), 2).unwrap().depth, [2; 2]);
        assert!(error(root.path(), 3).contains("has 3 frames"));
        let named =
            TopicArgs { depth_topic: None, color_topic: None, info_topic: Some("/info".to_owned()), points_topic: None, clouds: false };
        let refused = named.check(root.path()).unwrap_err();
        assert_eq!(refused.error().and_then(|e| e.field.as_deref()), Some("info-topic"));
        assert_eq!(read(&root.path().join("frame1"), 0).unwrap().depth, [1; 2]);
        assert!(error(&root.path().join("frame1"), 1).contains("has 1 frames"));
        assert!(error(&root.path().join("absent"), 1).contains("absent: no such file or folder"));
        std::fs::write(root.path().join("frame1/depth.png"), "no picture").unwrap();
        assert!(error(root.path(), 2).contains("frame1"));
        let recording = root.path().join("damaged.mcap");
        std::fs::write(&recording, "no recording").unwrap();
        assert!(error(&recording, 3).contains("damaged.mcap: not a whole MCAP recording"));
    }
}
