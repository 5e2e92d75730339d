//! From a frame folder to a scene, with errors that name the file.

use std::path::Path;

use repose_perception::frame_folder::{self, FrameFolderError};
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
