//! Frames that do not come from a live camera: a frame folder, a sequence of pictures, or a recording of ROS 2.
//!
//! | path | frames |
//! |---|---|
//! | a folder with `depth.png` and `camera.json` | that one |
//! | a folder of such folders | each, by name |
//! | a folder with `camera.json`, `depth/*.png`, and `color/`, `labels/` where there are any | one per depth picture |
//! | a file `*.mcap`, or a folder with such files (a rosbag2 folder) | one per depth image or organized cloud |

mod assembly;
pub mod frame_folder;
pub mod messages;
pub mod png_sequence;
pub mod recording;
pub mod survey;
#[cfg(test)]
mod synthetic;

use std::path::{Path, PathBuf};

use repose_proto::Frame;

use frame_folder::FrameFolderError;
use png_sequence::PngSequence;
pub use recording::Recording;
use repose_ros_messages::MessageError;
pub use survey::Topics;

/// Why a source gives no frames, or no more.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// A file or folder is not there or cannot be read.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A frame's pictures are at fault.
    #[error(transparent)]
    Pictures(#[from] FrameFolderError),
    /// The file is no MCAP recording, or is damaged.
    #[error("{}: not a whole MCAP recording: {reason}", path.display())]
    Recording {
        /// The file.
        path: PathBuf,
        /// What the reader says.
        reason: String,
    },
    /// A message in a recording cannot be used.
    #[error("{}: topic {topic}: {error}", path.display())]
    Message {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// What is wrong with the message.
        error: MessageError,
    },
    /// The recording is in the sqlite3 format of ROS 2, which is not read here.
    #[error(
        "{}: a sqlite3 recording, and only MCAP is read here; convert it where ROS 2 is installed: `ros2 bag convert -i {} -o convert.yaml`, with \
         `output_bags: [{{uri: converted, storage_id: mcap, all: true}}]` in convert.yaml",
        path.display(),
        path.display()
    )]
    Sqlite {
        /// The file or folder.
        path: PathBuf,
    },
    /// There is nothing here that a frame can be made of.
    #[error("{}: no frames; expected {lacks}", path.display())]
    Empty {
        /// The file or folder.
        path: PathBuf,
        /// What was looked for.
        lacks: String,
    },
}

impl SourceError {
    /// The file or folder at fault.
    pub fn path(&self) -> &Path {
        match self {
            Self::Pictures(error) => error.path(),
            Self::File { path, .. }
            | Self::Recording { path, .. }
            | Self::Message { path, .. }
            | Self::Sqlite { path }
            | Self::Empty { path, .. } => path,
        }
    }
}

/// Frames in order. Their stamps are the source's: 0 for pictures, the messages' own for recordings.
pub type Frames = Box<dyn Iterator<Item = Result<Frame, SourceError>> + Send>;

/// Opens whatever a path holds; `topics` matter for recordings only. Frames are read as they are asked for.
///
/// # Errors
/// [`SourceError`] when the path holds no frames; what is wrong with a single frame is said when its turn comes.
pub fn open(path: &Path, topics: &Topics) -> Result<Frames, SourceError> {
    if has_extension(path, "db3") {
        return Err(SourceError::Sqlite { path: path.to_owned() });
    }
    if has_extension(path, "mcap") {
        return Ok(Box::new(Recording::open(path, vec![path.to_owned()], topics.clone())?));
    }
    if path.join("depth.png").is_file() {
        let folder = path.to_owned();
        return Ok(Box::new(std::iter::once_with(move || Ok(frame_folder::read(&folder)?))));
    }
    let recordings = recordings_in(path)?;
    if !recordings.is_empty() {
        return Ok(Box::new(Recording::open(path, recordings, topics.clone())?));
    }
    let sequence = PngSequence::open(path)?;
    Ok(Box::new((0..sequence.len()).map(move |index| Ok(sequence.read(index)?))))
}

/// Whether a path is a recording or holds some, whose topics can be chosen.
pub fn has_topics(path: &Path) -> bool {
    has_extension(path, "mcap") || !path.join("depth.png").is_file() && recordings_in(path).is_ok_and(|recordings| !recordings.is_empty())
}

fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|e| e == extension)
}

/// The recordings in a folder, in the order of the numbers in their names.
fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let names = png_sequence::entries(folder)?;
    let with =
        |extension: &str| names.iter().map(|name| folder.join(name)).filter(|path| has_extension(path, extension)).collect::<Vec<_>>();
    let recordings = with("mcap");
    if recordings.is_empty() && !with("db3").is_empty() {
        return Err(SourceError::Sqlite { path: folder.to_owned() });
    }
    Ok(recordings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_splits_of_a_recording_come_in_the_order_of_their_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let names: Vec<PathBuf> = (0..11).map(|split| folder.path().join(format!("rosbag2_{split}.mcap"))).collect();
        for name in names.iter().chain([&folder.path().join("metadata.yaml")]) {
            std::fs::write(name, "").unwrap();
        }
        assert_eq!(recordings_in(folder.path()).unwrap(), names);
    }

    #[test]
    fn a_sqlite3_recording_is_told_how_to_become_one_that_can_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("bag_0.db3");
        std::fs::write(&file, "").unwrap();
        for path in [file.as_path(), folder.path()] {
            let Err(error) = open(path, &Topics::default()) else { panic!("{} gave frames", path.display()) };
            assert!(error.path() == path && error.to_string().contains("ros2 bag convert"), "{error}");
        }
    }
}
