//! Reports on disk, with errors that name the file.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use image::{DynamicImage, ImageFormat};
use repose_dataset::write_whole;

/// A file of a report that could not be read or written.
#[derive(Debug, thiserror::Error)]
#[error("{}: {why}", path.display())]
pub struct FileError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub why: String,
}

impl FileError {
    /// With what the system or a library says.
    pub fn new(path: &Path, why: impl Display) -> Self {
        Self { path: path.to_owned(), why: why.to_string() }
    }
}

/// Writes `NAME.json` and pictures (name, SVG) into a folder, which is made where it is missing. Each is written whole: a report of hours of work is
/// not lost to the one that was to take its place.
///
/// # Errors
/// When a file cannot be written; the one that was there stays.
pub fn write_report(folder: &Path, name: &str, document: &serde_json::Value, pictures: &[(String, String)]) -> Result<(), FileError> {
    std::fs::create_dir_all(folder).map_err(|e| FileError::new(folder, e))?;
    let json = serde_json::to_string_pretty(document).map_err(|e| FileError::new(folder, e))?;
    let files = std::iter::once((format!("{name}.json"), json.as_str()));
    for (file, text) in files.chain(pictures.iter().map(|(name, svg)| (format!("{name}.svg"), svg.as_str()))) {
        let path = folder.join(file);
        write_whole(&path, text.as_bytes()).map_err(|e| FileError::new(&path, e))?;
    }
    Ok(())
}

/// Makes sure that a file can be written, before the work is done that it is to hold: makes its folder, and leaves a file that is there as it is.
///
/// # Errors
/// When folder or file cannot be written.
pub fn can_write(path: &Path) -> Result<(), FileError> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|e| FileError::new(folder, e))?;
    }
    let is_new = !path.exists();
    std::fs::File::options().append(true).create(true).open(path).map_err(|e| FileError::new(path, e))?;
    if is_new { std::fs::remove_file(path).map_err(|e| FileError::new(path, e)) } else { Ok(()) }
}

/// Writes a picture as PNG, making its folder.
///
/// # Errors
/// When folder or file cannot be written.
pub fn write_picture(path: &Path, picture: &DynamicImage) -> Result<(), FileError> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|e| FileError::new(folder, e))?;
    }
    picture.save_with_format(path, ImageFormat::Png).map_err(|e| FileError::new(path, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_cannot_be_written_is_named_and_one_that_is_there_stays() {
        let folder = tempfile::tempdir().expect("a folder");
        let there = folder.path().join("there.png");
        std::fs::write(&there, "kept").expect("written");
        can_write(&there).expect("it can");
        assert_eq!(std::fs::read_to_string(&there).expect("it is there"), "kept");
        let new = folder.path().join("below/new.png");
        can_write(&new).expect("it can");
        assert!(!new.exists());
        let below_a_file = there.join("picture.png");
        assert!(can_write(&below_a_file).expect_err("a file is no folder").to_string().contains("there.png"));
    }

    #[test]
    fn a_report_has_its_json_and_its_pictures() {
        let folder = tempfile::tempdir().expect("a folder");
        write_report(folder.path(), "table", &serde_json::json!({"scenes": 2}), &[("bars".to_owned(), "<svg/>".to_owned())])
            .expect("written");
        let text = |name: &str| std::fs::read_to_string(folder.path().join(name)).expect(name);
        assert!(text("table.json").contains("\"scenes\": 2") && text("bars.svg") == "<svg/>");
    }

    #[test]
    fn a_report_that_cannot_be_written_leaves_the_earlier_one() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |scenes: u32| write_report(folder.path(), "table", &serde_json::json!({"scenes": scenes}), &[]);
        write(1).expect("written");
        // Nothing can be written where a folder stands in the way, as on a disk that is full.
        std::fs::create_dir(folder.path().join(format!("table.json.{}.tmp", std::process::id()))).expect("a folder");
        assert!(write(2).expect_err("no room").to_string().contains("table.json"));
        assert!(std::fs::read_to_string(folder.path().join("table.json")).expect("it is there").contains("\"scenes\": 1"));
    }
}
