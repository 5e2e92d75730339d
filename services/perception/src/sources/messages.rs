//! The messages of an MCAP file from front to back, chunk by chunk, so that its size does not matter.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::SourceError;

/// Largest record that is read, bytes; what claims to be larger is refused before memory is taken.
const MAX_RECORD_BYTES: usize = 256 << 20;

/// What a message is of.
#[derive(Debug, Clone)]
pub struct Channel {
    /// The topic.
    pub topic: String,
    /// The message's type.
    pub schema: String,
}

/// A file that is being read.
pub struct Messages {
    path: PathBuf,
    file: File,
    reader: LinearReader,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Channel>,
}

impl Messages {
    /// Opens a file.
    ///
    /// # Errors
    /// [`SourceError::File`] when there is none.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let file = File::open(path).map_err(|source| SourceError::File { path: path.to_owned(), source })?;
        let options = LinearReaderOptions::default().with_validate_chunk_crcs(true).with_record_length_limit(MAX_RECORD_BYTES);
        Ok(Self {
            path: path.to_owned(),
            file,
            reader: LinearReader::new_with_options(options),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
        })
    }

    /// Which file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads on to the next message, and hands it over with the nanosecond it was recorded at; `None` at the end.
    ///
    /// # Errors
    /// [`SourceError`] when the file cannot be read or is damaged.
    pub fn next<R>(&mut self, take: impl FnOnce(&Channel, u64, &[u8]) -> R) -> Result<Option<R>, SourceError> {
        let broken = |e: &dyn std::fmt::Display| SourceError::Recording { path: self.path.clone(), reason: e.to_string() };
        while let Some(event) = self.reader.next_event() {
            match event.map_err(|e| broken(&e))? {
                LinearReadEvent::ReadRequest(bytes) => {
                    let read = self.file.read(self.reader.insert(bytes));
                    let read = read.map_err(|source| SourceError::File { path: self.path.clone(), source })?;
                    self.reader.notify_read(read);
                }
                LinearReadEvent::Record { data, opcode } => match mcap::parse_record(opcode, data).map_err(|e| broken(&e))? {
                    Record::Schema { header, .. } => {
                        self.schemas.insert(header.id, header.name);
                    }
                    Record::Channel(channel) => {
                        let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                        self.channels.insert(channel.id, Channel { topic: channel.topic, schema });
                    }
                    Record::Message { header, data } => {
                        if let Some(channel) = self.channels.get(&header.channel_id) {
                            return Ok(Some(take(channel, header.log_time, &data)));
                        }
                    }
                    _ => {}
                },
            }
        }
        Ok(None)
    }
}
