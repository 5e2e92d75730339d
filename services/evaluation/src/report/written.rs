//! Reports on disk, with errors that name the file.

use std::fmt::Display;
use std::path::{Path, PathBuf};

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

/// Writes `NAME.json` and pictures (name, SVG) into a folder, which is made where it is missing.
///
/// # Errors
/// When a file cannot be written.
pub fn write_report(folder: &Path, name: &str, document: &serde_json::Value, pictures: &[(String, String)]) -> Result<(), FileError> {
    std::fs::create_dir_all(folder).map_err(|e| FileError::new(folder, e))?;
    let json = serde_json::to_string_pretty(document).map_err(|e| FileError::new(folder, e))?;
    let files = std::iter::once((format!("{name}.json"), json.as_str()));
    for (file, text) in files.chain(pictures.iter().map(|(name, svg)| (format!("{name}.svg"), svg.as_str()))) {
        let path = folder.join(file);
        std::fs::write(&path, text).map_err(|e| FileError::new(&path, e))?;
    }
    Ok(())
}
