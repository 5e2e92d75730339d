//! From a frame folder to a scene, with errors that name the file.

use std::path::Path;

use repose_perception::frame_folder::{self, FrameFolderError};
use repose_perception::sources::{self, SourceError, Topics};
use repose_perception::{Settings, segment};
use repose_proto::{CallError, Frame, Scene};

use crate::failure::Failure;

/// Reads a frame folder.
pub fn read(folder: &Path) -> Result<Frame, Failure> {
    frame_folder::read(folder).map_err(|error| match &error {
        FrameFolderError::Camera { path, error } => {
            let field = format!("{}: {}", path.display(), error.field.as_deref().unwrap_or("payload"));
            Failure::bad_input(&field, &error.message)
        }
        other => Failure::bad_input(&other.path().display().to_string(), other),
    })
}

/// The frame of a source at a place in its order.
pub fn read_nth(source: &Path, nth: usize) -> Result<Frame, Failure> {
    let bad = |e: SourceError| Failure::bad_input(&e.path().display().to_string(), &e);
    if source.join("depth.png").is_file() || !source.exists() {
        // A plain frame folder, whose faults are told by field.
        return read(source);
    }
    let mut frames = sources::open(source, &Topics::default()).map_err(bad)?;
    let frame = frames.nth(nth).ok_or_else(|| Failure::bad_input("nth", format!("{} has no frame {nth}", source.display())))?;
    frame.map_err(bad)
}

/// Segments a frame with perception's defaults.
pub fn scene_of(frame: &Frame) -> Result<Scene, Failure> {
    segment(frame, &Settings::default()).map_err(|error| Failure::from(CallError::from(error)))
}

/// Writes a picture, making its folder.
pub fn write_picture(path: &Path, picture: &image::DynamicImage) -> Result<(), Failure> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|e| Failure::bad_input(&folder.display().to_string(), e))?;
    }
    picture.save_with_format(path, image::ImageFormat::Png).map_err(|e| Failure::bad_input(&path.display().to_string(), e))
}
