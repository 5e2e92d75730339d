//! One MCAP file: chunks that are compressed, indexed, and written at once when they are complete.
//!
//! The writer never goes back in the file, so that what is there when the process is killed is whole up to the last chunk.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions, Writer};
use repose_proto::Payload;

use super::{ENCODING, PROFILE};
use crate::RecordingError;
use crate::look::VisualMessage;

/// Uncompressed size at which a chunk is closed, bytes.
const CHUNK_BYTES: u64 = 4 << 20;
/// The fastest of zstd's usual levels: depth pictures shrink to a third by it, at some 300 MB/s.
const COMPRESSION: u32 = 1;

/// Channels of a file at most. MCAP numbers them with sixteen bits, and writes nothing more when it has no more numbers. A cell has some dozens, and
/// whoever may put to keys of any name, as everybody may who stops robots, makes as many as they like.
const MAX_CHANNELS: usize = 4096;
/// The encoding on the wire of what is to be looked at: it was on none.
const LOOKED_AT: &str = "";

type McapWriter = Writer<NoSeek<Counted>>;

/// A file that is being written.
pub struct PartWriter {
    path: PathBuf,
    writer: McapWriter,
    written: Arc<AtomicU64>,
    /// The channels by topic and encoding on the wire.
    channels: BTreeMap<String, BTreeMap<String, u16>>,
    /// Messages of each channel.
    sequences: BTreeMap<u16, u32>,
}

/// Counts what goes into a file.
struct Counted {
    file: File,
    written: Arc<AtomicU64>,
}

impl Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.written.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl PartWriter {
    /// Begins a file; `about` goes into its metadata record `repose`.
    ///
    /// # Errors
    /// [`RecordingError::File`] when there is one already, or it cannot be written.
    pub fn create(path: &Path, about: BTreeMap<String, String>) -> Result<Self, RecordingError> {
        let failed = |source| RecordingError::File { path: path.to_owned(), source };
        let file = File::options().write(true).create_new(true).open(path).map_err(failed)?;
        let written = Arc::<AtomicU64>::default();
        let options = WriteOptions::new()
            .profile(PROFILE)
            .library(concat!("repose ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_level(COMPRESSION)
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true);
        let counted = NoSeek::new(Counted { file, written: written.clone() });
        let mut writer = options.create(counted).map_err(|e| failed(io_error(e)))?;
        writer.write_metadata(&Metadata { name: PROFILE.to_owned(), metadata: about }).map_err(|e| failed(io_error(e)))?;
        Ok(Self { path: path.to_owned(), writer, written, channels: BTreeMap::new(), sequences: BTreeMap::new() })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes written so far; what waits in the open chunk is not among them.
    pub fn bytes(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// Adds a message of the wire; false where it is of a further channel than the file has room for.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn wire(&mut self, topic: &str, payload: &Payload, at_ns: u64) -> Result<bool, RecordingError> {
        let make = |writer: &mut McapWriter| {
            let form = if payload.is_bulk() { "safetensors" } else { "json" };
            let metadata = BTreeMap::from([(ENCODING.to_owned(), payload.encoding.clone())]);
            writer.add_channel(0, topic, form, &metadata)
        };
        let channel = self.channel(topic, &payload.encoding, make)?;
        self.add(channel, &payload.bytes, at_ns)
    }

    /// Adds something to look at; false where it is of a further channel than the file has room for.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn look(&mut self, look: &VisualMessage) -> Result<bool, RecordingError> {
        let make = |writer: &mut McapWriter| {
            let schema = writer.add_schema(&look.schema.name, &look.schema.encoding, &look.schema.data)?;
            writer.add_channel(schema, &look.topic, "protobuf", &BTreeMap::new())
        };
        let channel = self.channel(&look.topic, LOOKED_AT, make)?;
        self.add(channel, &look.message, look.at_ns)
    }

    /// The channel of a topic and an encoding, made where it is new; none where there is no room for another.
    fn channel(
        &mut self,
        topic: &str,
        encoding: &str,
        make: impl FnOnce(&mut McapWriter) -> Result<u16, McapError>,
    ) -> Result<Option<u16>, RecordingError> {
        if let Some(known) = self.channels.get(topic).and_then(|of_topic| of_topic.get(encoding)) {
            return Ok(Some(*known));
        }
        if self.sequences.len() >= MAX_CHANNELS {
            return Ok(None);
        }
        let channel = make(&mut self.writer).map_err(|e| self.failed(e))?;
        self.channels.entry(topic.to_owned()).or_default().insert(encoding.to_owned(), channel);
        self.sequences.entry(channel).or_default();
        Ok(Some(channel))
    }

    fn add(&mut self, channel: Option<u16>, bytes: &[u8], at_ns: u64) -> Result<bool, RecordingError> {
        let Some(channel_id) = channel else { return Ok(false) };
        let sequence = self.sequences.entry(channel_id).or_default();
        let header = MessageHeader { channel_id, sequence: *sequence, log_time: at_ns, publish_time: at_ns };
        *sequence = sequence.wrapping_add(1);
        self.writer.write_to_known_channel(&header, bytes).map_err(|e| self.failed(e))?;
        Ok(true)
    }

    /// Writes out what waits: from now on it survives the process.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.writer.flush().map_err(|e| self.failed(e))
    }

    /// Ends the file with its index. `about` goes into its metadata record `repose.end`. Returns its size, bytes.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(mut self, about: BTreeMap<String, String>) -> Result<u64, RecordingError> {
        let metadata = Metadata { name: format!("{PROFILE}.end"), metadata: about };
        let ended = self.writer.write_metadata(&metadata).and_then(|()| self.writer.finish().map(drop));
        ended.map_err(|e| self.failed(e))?;
        Ok(self.bytes())
    }

    fn failed(&self, error: McapError) -> RecordingError {
        RecordingError::File { path: self.path.clone(), source: io_error(error) }
    }
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(source) => source,
        other => io::Error::other(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file::reading::RecordingReader;

    #[test]
    fn keys_of_ever_new_names_end_no_recording() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("run.mcap");
        let mut writer = PartWriter::create(&path, BTreeMap::new()).expect("a file");
        let stop = |encoding: &str| Payload { encoding: encoding.to_owned(), bytes: b"{}".to_vec().into() };
        let topic = |robot: usize| format!("repose/v1/lab/robot/r{robot}/@estop");
        for robot in 0..MAX_CHANNELS {
            assert!(writer.wire(&topic(robot), &stop("a"), 1).expect("written"), "{robot}");
        }
        for (robot, encoding) in [(MAX_CHANNELS, "a"), (0, "b")] {
            assert!(!writer.wire(&topic(robot), &stop(encoding), 2).expect("no fault of the file"), "a further channel");
        }
        assert!(writer.wire(&topic(0), &stop("a"), 3).expect("written"), "what it had goes on");
        writer.finish(BTreeMap::new()).expect("written");
        let mut reading = RecordingReader::open(&path).expect("a recording");
        let read = std::iter::from_fn(|| reading.next_message().expect("readable")).count();
        assert_eq!(read, MAX_CHANNELS + 1);
    }
}
