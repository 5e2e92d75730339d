//! Files of a deployment on disk: what is a secret is its owner's to read, and its group's where it was given to one; what was there before may
//! stay.

use std::path::{Path, PathBuf};

/// A file that could not be read or written.
#[derive(Debug, thiserror::Error)]
#[error("{}: {message}", path.display())]
pub struct Failed {
    /// The file.
    pub path: PathBuf,
    /// Why.
    pub message: String,
}

impl Failed {
    pub(super) fn new(path: &Path, message: impl std::fmt::Display) -> Self {
        Self { path: path.to_owned(), message: message.to_string() }
    }
}

/// The files of a deployment: those just written, and those kept.
#[derive(Debug, Default, serde::Serialize)]
pub struct WrittenFiles {
    /// The files written now.
    pub files: Vec<PathBuf>,
    /// Secrets and certificates that were there and stay.
    pub kept: Vec<PathBuf>,
}

/// Writes, and remembers what.
#[derive(Default)]
pub(super) struct Files {
    written: WrittenFiles,
}

impl Files {
    /// A file's text, if it is there; it stays then.
    pub(super) fn existing(&mut self, path: &Path) -> Result<Option<String>, Failed> {
        match std::fs::read_to_string(path) {
            Ok(text) => {
                if !self.written.kept.iter().any(|kept| kept == path) {
                    self.written.kept.push(path.to_owned());
                }
                Ok(Some(text))
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(Failed::new(path, error)),
        }
    }

    pub(super) fn write(&mut self, path: &Path, text: &str) -> Result<(), Failed> {
        self.put(path, text, 0o644)
    }

    /// An operator's own stays.
    pub(super) fn write_unless_there(&mut self, path: &Path, text: &str) -> Result<(), Failed> {
        match self.existing(path)? {
            Some(_) => Ok(()),
            None => self.write(path, text),
        }
    }

    /// What was written, and what was there and stays.
    pub(super) fn written(mut self) -> WrittenFiles {
        let files = &self.written.files;
        self.written.kept.retain(|kept| !files.contains(kept));
        self.written
    }

    /// For its owner's eyes only, and its group's where one that is there is: whoever runs with it goes on to.
    pub(super) fn write_secret(&mut self, path: &Path, text: &str) -> Result<(), Failed> {
        self.put(path, text, 0o600 | shared_with_group(path))
    }

    fn put(&mut self, path: &Path, text: &str, mode: u32) -> Result<(), Failed> {
        use std::io::Write as _;
        let fail = |e: std::io::Error| Failed::new(path, e);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(fail)?;
        }
        let mut options = std::fs::OpenOptions::new();
        options.write(true).create(true).truncate(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, mode);
        let mut file = options.open(path).map_err(fail)?;
        #[cfg(unix)]
        file.set_permissions(std::os::unix::fs::PermissionsExt::from_mode(mode)).map_err(fail)?;
        #[cfg(not(unix))]
        let _unused = mode;
        file.write_all(text.as_bytes()).map_err(fail)?;
        self.written.files.push(path.to_owned());
        Ok(())
    }
}

#[cfg(unix)]
fn shared_with_group(path: &Path) -> u32 {
    use std::os::unix::fs::PermissionsExt as _;
    std::fs::metadata(path).map_or(0, |found| found.permissions().mode() & 0o040)
}

#[cfg(not(unix))]
fn shared_with_group(_: &Path) -> u32 {
    0
}
