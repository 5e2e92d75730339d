//! What is recorded, and how much of it is kept.

use std::path::PathBuf;
use std::time::Duration;

use crate::RecordingError;

/// Settings of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordSettings {
    /// The first file, `run.mcap`; the next ones are `run.2.mcap`, `run.3.mcap`, ….
    pub out: PathBuf,
    /// A file that is larger is closed and the next one begun, bytes (512 MiB).
    pub max_file_bytes: u64,
    /// The oldest files go when all of them together are larger, bytes (8 GiB).
    pub max_total_bytes: u64,
    /// How much time may be lost when the process is killed: so often what was heard is written out (1 s).
    pub chunk_period: Duration,
    /// Least time between two pictures of a camera (200 ms); those between are left out.
    pub frame_period: Duration,
    /// Least time between two whole scenes of a camera (2 s). Scenes that somebody asks about are recorded whatever it is.
    pub scene_period: Duration,
    /// Whether Foxglove's messages are written beside those of the wire.
    pub looks: bool,
    /// Least time between two of Foxglove's pictures of a camera (500 ms): each is taken out of a frame and encoded once more. The frames are there all the
    /// same.
    pub picture_period: Duration,
}

impl RecordSettings {
    /// The defaults, into a file.
    pub fn new(out: PathBuf) -> Self {
        Self {
            out,
            max_file_bytes: 512 << 20,
            max_total_bytes: 8 << 30,
            chunk_period: Duration::from_secs(1),
            frame_period: Duration::from_millis(200),
            scene_period: Duration::from_secs(2),
            looks: true,
            picture_period: Duration::from_millis(500),
        }
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`RecordingError::Setting`] that names the field.
    pub fn validate(&self) -> Result<(), RecordingError> {
        let wrong = |field, message: String| Err(RecordingError::Setting { field, message });
        if self.out.extension().is_none_or(|e| e != "mcap") {
            return wrong("out", format!("expected a name that ends in .mcap, got {}", self.out.display()));
        }
        if self.max_file_bytes < 1 << 20 {
            return wrong("max_file_bytes", format!("expected at least 1 MiB, got {}", self.max_file_bytes));
        }
        if self.max_total_bytes < 2 * self.max_file_bytes {
            return wrong("max_total_bytes", format!("expected at least twice a file's size, got {}", self.max_total_bytes));
        }
        if self.chunk_period.is_zero() {
            return wrong("chunk_period", "expected above 0".to_owned());
        }
        Ok(())
    }
}
