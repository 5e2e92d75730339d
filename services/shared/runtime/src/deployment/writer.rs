//! Files of a deployment on disk: what is a secret is its owner's to read, and its group's where it was given to one; what was there before may
//! stay.

use std::fs::File;
use std::path::{Path, PathBuf};

use super::settings;

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

    /// A configuration: what an operator has set in it besides stays. `endpoint_before` is the one that was ours, where that is known.
    pub(super) fn write_settings(&mut self, path: &Path, ours: &str, endpoint_before: Option<&str>) -> Result<(), Failed> {
        let text = match std::fs::read_to_string(path) {
            Ok(earlier) => {
                let again = settings::written_again(&earlier, ours, endpoint_before).map_err(|e| Failed::new(path, e))?;
                for unsure in &again.unsure {
                    tracing::warn!(file = %path.display(), "{unsure}");
                }
                again.text
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => ours.to_owned(),
            Err(error) => return Err(Failed::new(path, error)),
        };
        self.write(path, &text)
    }

    /// An operator's own stays.
    pub(super) fn write_unless_there(&mut self, path: &Path, text: &str) -> Result<(), Failed> {
        match self.existing(path)? {
            Some(_) => Ok(()),
            None => self.write(path, text),
        }
    }

    /// Takes a file away, where there is one.
    pub(super) fn remove(&mut self, path: &Path) -> Result<(), Failed> {
        self.written.kept.retain(|kept| kept != path);
        match std::fs::remove_file(path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(Failed::new(path, error)),
            _ => Ok(()),
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

    /// The whole text is written beside the file before it takes its place: where the disk is full, or this process dies, what was there stays. The
    /// router's file of users holds passwords that programs in the field have.
    fn put(&mut self, path: &Path, text: &str, mode: u32) -> Result<(), Failed> {
        let fail = |e: std::io::Error| Failed::new(path, e);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(fail)?;
        }
        // What a link leads to is replaced, and not the link.
        let place = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let mut beside = place.clone().into_os_string();
        beside.push(".new");
        let beside = PathBuf::from(beside);
        let written = write_as(&beside, &place, text, mode).and_then(|()| std::fs::rename(&beside, &place));
        if let Err(error) = written {
            // It may not be there.
            let _gone = std::fs::remove_file(&beside);
            return Err(fail(error));
        }
        self.written.files.push(path.to_owned());
        Ok(())
    }
}

/// Writes a file that is to take another's place: with that one's owner and group, where there is one.
fn write_as(file: &Path, place: &Path, text: &str, mode: u32) -> std::io::Result<()> {
    use std::io::Write as _;
    let mut options = File::options();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, mode);
    let mut file = options.open(file)?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
        if let Ok(there) = std::fs::metadata(place) {
            std::os::unix::fs::fchown(&file, Some(there.uid()), Some(there.gid()))?;
        }
        file.set_permissions(std::fs::Permissions::from_mode(mode))?;
    }
    #[cfg(not(unix))]
    let _unused = (place, mode);
    file.write_all(text.as_bytes())?;
    file.sync_all()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_there_stays_where_it_cannot_be_written_anew() {
        let folder = tempfile::tempdir().expect("a folder");
        let users = folder.path().join("users.txt");
        let mut files = Files::default();
        files.write_secret(&users, "arm:its password\n").expect("written");
        let read = || std::fs::read_to_string(&users).expect("it is there");
        // As a full disk: there is no place for the new one.
        std::fs::create_dir(folder.path().join("users.txt.new")).expect("a folder");
        files.write_secret(&users, "arm:another\n").expect_err("no place");
        assert_eq!(read(), "arm:its password\n");
        std::fs::remove_dir(folder.path().join("users.txt.new")).expect("removed");
        files.write_secret(&users, "arm:another\n").expect("written");
        assert_eq!((read().as_str(), std::fs::read_dir(folder.path()).expect("the folder").count()), ("arm:another\n", 1));
    }
}
