//! A recording of bounded size: a file that grows too large is closed and the next one begun, and the oldest go when all are too large together.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};

use super::writing::PartWriter;
use crate::{RecordSettings, RecordingError};

/// The files of a recording in progress.
pub struct RecordingFiles {
    settings: RecordSettings,
    about: BTreeMap<String, String>,
    open: PartWriter,
    number: usize,
    /// Closed files that are still there, oldest first, and their bytes.
    closed: VecDeque<(PathBuf, u64)>,
    /// Files that had to go.
    removed: usize,
}

/// What a recording wrote: its files, their size, and how many were removed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordingReport {
    /// Its files that are there, oldest first.
    pub files: Vec<PathBuf>,
    /// Their bytes.
    pub bytes: u64,
    /// Older files that had to go.
    pub removed: usize,
}

impl RecordingFiles {
    /// Begins a recording; `about` goes into every file.
    ///
    /// # Errors
    /// When the settings are out of range, the first file is there already or later ones of an earlier recording are, or it cannot be written.
    pub fn begin(settings: RecordSettings, about: BTreeMap<String, String>) -> Result<Self, RecordingError> {
        settings.validate()?;
        if let Some(path) = later_part(&settings.out) {
            let source = std::io::Error::new(std::io::ErrorKind::AlreadyExists, "it is a part of an earlier recording of this name");
            return Err(RecordingError::File { path, source });
        }
        let open = PartWriter::create(&settings.out, about.clone())?;
        Ok(Self { settings, about, open, number: 1, closed: VecDeque::new(), removed: 0 })
    }

    /// The file that is being written.
    pub fn open(&mut self) -> &mut PartWriter {
        &mut self.open
    }

    /// Goes on to the next file where this one has become too large; whether it did.
    ///
    /// # Errors
    /// When a file cannot be written or removed.
    pub fn turn(&mut self) -> Result<bool, RecordingError> {
        if self.open.bytes() < self.settings.max_file_bytes {
            return Ok(false);
        }
        let next = part(&self.settings.out, self.number + 1);
        let full = std::mem::replace(&mut self.open, PartWriter::create(&next, self.about.clone())?);
        self.number += 1;
        let path = full.path().to_owned();
        let bytes = full.finish(BTreeMap::new())?;
        self.closed.push_back((path, bytes));
        // Room for the one that is open, too.
        while self.closed.iter().map(|(_, bytes)| bytes).sum::<u64>() + self.settings.max_file_bytes > self.settings.max_total_bytes {
            let Some((oldest, _)) = self.closed.pop_front() else { break };
            if remove(&oldest)? {
                tracing::info!(file = %oldest.display(), "the oldest part of the recording had to go");
                self.removed += 1;
            }
        }
        Ok(true)
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(self, about: BTreeMap<String, String>) -> Result<RecordingReport, RecordingError> {
        let last = self.open.path().to_owned();
        let mut closed = self.closed;
        closed.retain(|(path, _)| path.exists());
        closed.push_back((last, self.open.finish(about)?));
        let bytes = closed.iter().map(|(_, bytes)| bytes).sum();
        Ok(RecordingReport { files: closed.into_iter().map(|(path, _)| path).collect(), bytes, removed: self.removed })
    }
}

/// Removes a closed file; whether it was there. Who has moved it away has made the same room, and the recording goes on.
fn remove(closed: &Path) -> Result<bool, RecordingError> {
    match std::fs::remove_file(closed) {
        Ok(()) => Ok(true),
        Err(gone) if gone.kind() == std::io::ErrorKind::NotFound => Ok(false),
        Err(source) => Err(RecordingError::File { path: closed.to_owned(), source }),
    }
}

/// A later file of a recording of this name that is there already: this one would come upon it after hours.
fn later_part(first: &Path) -> Option<PathBuf> {
    let stem = first.file_stem()?.to_str()?;
    let folder = first.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // A folder that cannot be read is told when the file is written.
    let entries = std::fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    let is_part = |path: &PathBuf| {
        let number = path.file_name()?.to_str()?.strip_prefix(stem)?.strip_prefix('.')?.strip_suffix(".mcap")?;
        (!number.is_empty() && number.bytes().all(|digit| digit.is_ascii_digit())).then_some(())
    };
    entries.into_iter().filter(|path| is_part(path).is_some()).min()
}

/// The name of a recording's `number`-th file, from 1.
fn part(first: &Path, number: usize) -> PathBuf {
    first.with_extension(format!("{number}.mcap"))
}

#[cfg(test)]
mod tests {
    use repose_proto::Payload;

    use super::*;
    use crate::file::reading::RecordingReader;

    /// Bytes that do not shrink.
    fn noise(seed: u64, count: usize) -> Vec<u8> {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state as u8
        };
        (0..count).map(|_| next()).collect()
    }

    #[test]
    fn a_recording_does_not_begin_where_later_parts_of_another_are() {
        let folder = tempfile::tempdir().expect("a folder");
        let settings = RecordSettings::new(folder.path().join("run.mcap"));
        for other in ["run.old.mcap", "run.2.mcap.bak", "runs.5.mcap", "run..mcap"] {
            std::fs::write(folder.path().join(other), "another's").expect("written");
        }
        drop(RecordingFiles::begin(settings.clone(), BTreeMap::new()).expect("none of these is a part of it"));
        std::fs::remove_file(&settings.out).expect("removed");
        std::fs::write(folder.path().join("run.5.mcap"), "a part").expect("written");
        let refused = RecordingFiles::begin(settings.clone(), BTreeMap::new()).err().map(|e| e.to_string());
        assert!(refused.as_deref().is_some_and(|e| e.contains("run.5.mcap")), "{refused:?}");
        assert!(!settings.out.exists(), "nothing was begun");
    }

    #[test]
    fn files_turn_when_they_are_full_and_the_oldest_go() {
        let folder = tempfile::tempdir().expect("a folder");
        let settings =
            RecordSettings { max_file_bytes: 1 << 20, max_total_bytes: 3 << 20, ..RecordSettings::new(folder.path().join("run.mcap")) };
        let mut parts = RecordingFiles::begin(settings.clone(), BTreeMap::new()).expect("a file");
        assert!(RecordingFiles::begin(settings, BTreeMap::new()).is_err(), "nothing is written over");
        for k in 0..12u64 {
            let payload = Payload { encoding: "application/octet-stream;repose.Frame.v1".to_owned(), bytes: noise(k, 500_000).into() };
            parts.open().wire("repose/v1/cell/camera/front/frame", &payload, k).expect("written");
            parts.open().flush().expect("written");
            parts.turn().expect("written");
        }
        let written = parts.finish(BTreeMap::new()).expect("written");
        assert!(written.removed > 0 && written.bytes <= 3 << 20, "{written:?}");
        let mut there: Vec<_> = std::fs::read_dir(folder.path()).expect("the folder").map(|e| e.expect("an entry").path()).collect();
        there.sort();
        let mut named = written.files.clone();
        named.sort();
        assert_eq!(there, named);
        let mut seen = Vec::new();
        for file in &written.files {
            let mut reading = RecordingReader::open(file).expect("a recording");
            while let Some(recorded) = reading.next_message().expect("readable") {
                assert_eq!(recorded.payload.bytes, noise(recorded.at_ns, 500_000));
                seen.push(recorded.at_ns);
            }
        }
        let newest: Vec<u64> = (12 - seen.len() as u64..12).collect();
        assert_eq!(seen, newest, "the newest are there, in order");
    }

    #[test]
    fn a_recording_goes_on_where_somebody_has_moved_its_older_files_away() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("run.mcap");
        let settings = RecordSettings { max_file_bytes: 1 << 20, max_total_bytes: 3 << 20, ..RecordSettings::new(out.clone()) };
        let mut parts = RecordingFiles::begin(settings, BTreeMap::new()).expect("a file");
        for k in 0..12u64 {
            let payload = Payload { encoding: "application/octet-stream;repose.Frame.v1".to_owned(), bytes: noise(k, 500_000).into() };
            parts.open().wire("repose/v1/cell/camera/front/frame", &payload, k).expect("written");
            parts.open().flush().expect("written");
            if parts.turn().expect("nobody is in the way") && out.exists() {
                std::fs::rename(&out, folder.path().join("kept elsewhere")).expect("moved");
            }
        }
        let written = parts.finish(BTreeMap::new()).expect("written");
        assert!(written.removed > 0 && written.files.iter().all(|file| file.exists()), "{written:?}");
    }
}
