//! Frames from folders of pictures: frame folders below a folder, or `depth/`, `color/` and `labels/` side by side with one `camera.json`.
//!
//! Names decide the order, numbers in them by their value: `frame2` comes before `frame10`. In the second form a color and a labels
//! picture belong to the depth picture of the same name, and may be absent.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use repose_proto::{CameraModel, Frame};

use super::SourceError;
use crate::sources::frame_folder::{self, FrameFolderError};

/// Where each frame is, in order.
#[derive(Debug, Clone)]
pub enum PngSequence {
    /// Frame folders.
    Folders(Vec<PathBuf>),
    /// Depth pictures with the camera that they share, and the folder that holds theirs.
    Pictures {
        /// The folder with `camera.json`.
        root: PathBuf,
        /// Its content.
        camera: Box<CameraModel>,
        /// File names below `depth/`.
        names: Vec<String>,
    },
}

impl PngSequence {
    /// What a folder holds.
    ///
    /// # Errors
    /// [`SourceError`] when it is neither form, or is empty.
    pub fn open(folder: &Path) -> Result<Self, SourceError> {
        if folder.join("depth").is_dir() {
            let camera = Box::new(frame_folder::read_camera(&folder.join("camera.json"))?);
            let names: Vec<String> = entries(&folder.join("depth"))?.into_iter().filter(|name| name.ends_with(".png")).collect();
            return Self::Pictures { root: folder.to_owned(), camera, names }.not_empty(folder);
        }
        let folders = entries(folder)?.into_iter().map(|name| folder.join(name)).filter(|path| path.join("depth.png").is_file());
        Self::Folders(folders.collect()).not_empty(folder)
    }

    /// How many frames there are.
    pub fn len(&self) -> usize {
        match self {
            Self::Folders(folders) => folders.len(),
            Self::Pictures { names, .. } => names.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The frame at a place in the order, below [`PngSequence::len`].
    ///
    /// # Errors
    /// [`FrameFolderError`] that names the file.
    pub fn read(&self, index: usize) -> Result<Frame, FrameFolderError> {
        match self {
            Self::Folders(folders) => frame_folder::read(&folders[index]),
            Self::Pictures { root, camera, names } => {
                let picture = |kind: &str| root.join(kind).join(&names[index]);
                frame_folder::read_pictures((**camera).clone(), &picture("depth"), &picture("color"), &picture("labels"))
            }
        }
    }

    fn not_empty(self, folder: &Path) -> Result<Self, SourceError> {
        if self.is_empty() {
            let lacks = "frame folders, or depth/*.png with a camera.json beside".to_owned();
            return Err(SourceError::Empty { path: folder.to_owned(), lacks });
        }
        Ok(self)
    }
}

/// Names in a folder, in order.
///
/// # Errors
/// [`SourceError::File`] when it cannot be read.
pub fn entries(folder: &Path) -> Result<Vec<String>, SourceError> {
    let failed = |source| SourceError::File { path: folder.to_owned(), source };
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        names.push(entry.map_err(failed)?.file_name().to_string_lossy().into_owned());
    }
    names.sort_by(|a, b| natural(a, b));
    Ok(names)
}

/// Compares names, stretches of digits by their value.
fn natural(a: &str, b: &str) -> Ordering {
    let parts = |name: &str| -> Vec<(bool, String)> {
        let mut parts: Vec<(bool, String)> = Vec::new();
        for c in name.chars() {
            match parts.last_mut() {
                Some((digits, part)) if *digits == c.is_ascii_digit() => part.push(c),
                _ => parts.push((c.is_ascii_digit(), c.to_string())),
            }
        }
        parts
    };
    let compare = |((a_digits, a), (b_digits, b)): (&(bool, String), &(bool, String))| match (a_digits, b_digits) {
        (true, true) => {
            let (a, b) = (a.trim_start_matches('0'), b.trim_start_matches('0'));
            a.len().cmp(&b.len()).then_with(|| a.cmp(b))
        }
        _ => a.cmp(b),
    };
    let (a_parts, b_parts) = (parts(a), parts(b));
    let first = a_parts.iter().zip(&b_parts).map(compare).find(|order| order.is_ne());
    first.unwrap_or_else(|| a_parts.len().cmp(&b_parts.len())).then_with(|| a.cmp(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_by_value() {
        let mut names = ["learn10", "learn2", "a", "learn02", "learn2b", "0001.png", "1000.png", "999.png"];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, ["0001.png", "999.png", "1000.png", "a", "learn02", "learn2", "learn2b", "learn10"]);
    }
}
