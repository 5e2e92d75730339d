//! Reading a recording from front to back, chunk by chunk. One that was cut off is read up to its last whole chunk.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use mcap::records::{Channel, Record};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use repose_proto::Payload;

use super::{ENCODING, PROFILE};
use crate::RecordingError;

/// Largest record that is read, bytes; what claims to be larger is refused before memory is taken.
const MAX_RECORD_BYTES: usize = 256 << 20;

/// A recorded message.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedMessage {
    /// Its key.
    pub topic: String,
    /// When it was heard, nanoseconds since the Unix epoch.
    pub at_ns: u64,
    /// The message.
    pub payload: Payload,
}

/// A reader of one recording file.
pub struct RecordingReader {
    path: PathBuf,
    file: File,
    reader: LinearReader,
    channels: BTreeMap<u16, Channel>,
    about: BTreeMap<String, String>,
    first: Option<RecordedMessage>,
    cut: Option<String>,
}

/// Whether a file is one of our recordings.
pub fn is_recording(path: &Path) -> bool {
    path.is_file() && RecordingReader::open(path).is_ok()
}

impl RecordingReader {
    /// Opens a file and reads up to its first message.
    ///
    /// # Errors
    /// [`RecordingError::File`] when it cannot be read, [`RecordingError::Content`] when it is no recording of ours.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = File::open(path).map_err(|source| RecordingError::File { path: path.to_owned(), source })?;
        let options = LinearReaderOptions::default().with_validate_chunk_crcs(true).with_record_length_limit(MAX_RECORD_BYTES);
        let reader = LinearReader::new_with_options(options);
        let (channels, about) = (BTreeMap::new(), BTreeMap::new());
        let mut reading = Self { path: path.to_owned(), file, reader, channels, about, first: None, cut: None };
        let mut profile = None;
        reading.first = reading.advance(&mut profile)?;
        match profile.as_deref() {
            Some(PROFILE) => Ok(reading),
            other => {
                let reason = match (&reading.cut, other) {
                    (Some(reason), None) => format!("not an MCAP file: {reason}"),
                    (_, other) => format!("expected a recording of the profile {PROFILE:?}, got {:?}", other.unwrap_or_default()),
                };
                Err(RecordingError::Content { path: path.to_owned(), reason })
            }
        }
    }

    /// What the recorder said of it: `cell`, `version`, `started_ns`.
    pub fn about(&self) -> &BTreeMap<String, String> {
        &self.about
    }

    /// Why it ends early, where it does; known at the end.
    pub fn cut(&self) -> Option<&str> {
        self.cut.as_deref()
    }

    /// The next message of the wire, or none at the end.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        match self.first.take() {
            Some(first) => Ok(Some(first)),
            None => self.advance(&mut None),
        }
    }

    fn advance(&mut self, profile: &mut Option<String>) -> Result<Option<RecordedMessage>, RecordingError> {
        while self.cut.is_none()
            && let Some(event) = self.reader.next_event()
        {
            let record = match event {
                Ok(LinearReadEvent::ReadRequest(bytes)) => {
                    let read = self.file.read(self.reader.insert(bytes));
                    let read = read.map_err(|source| RecordingError::File { path: self.path.clone(), source })?;
                    self.reader.notify_read(read);
                    continue;
                }
                Ok(LinearReadEvent::Record { data, opcode }) => mcap::parse_record(opcode, data),
                Err(error) => Err(error),
            };
            match record {
                Ok(Record::Header(header)) => *profile = Some(header.profile),
                Ok(Record::Metadata(metadata)) if metadata.name == PROFILE => self.about = metadata.metadata,
                Ok(Record::Channel(channel)) => drop(self.channels.insert(channel.id, channel)),
                Ok(Record::Message { header, data }) => {
                    // What is there to look at has no encoding of the wire.
                    let wire = self.channels.get(&header.channel_id).and_then(|c| Some((c, c.metadata.get(ENCODING)?)));
                    let Some((channel, encoding)) = wire else { continue };
                    let payload = Payload { encoding: encoding.clone(), bytes: data.into_owned().into() };
                    return Ok(Some(RecordedMessage { topic: channel.topic.clone(), at_ns: header.log_time, payload }));
                }
                Ok(_) => {}
                Err(error) => self.cut = Some(error.to_string()),
            }
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file::writing::PartWriter;

    fn state(text: &str) -> Payload {
        Payload { encoding: "application/json;repose.RobotState.v1".to_owned(), bytes: text.to_owned().into() }
    }

    #[test]
    fn what_was_written_out_is_there_when_the_process_was_killed() {
        let folder = tempfile::tempdir().expect("a folder");
        let (whole, cut) = (folder.path().join("whole.mcap"), folder.path().join("cut.mcap"));
        let about = BTreeMap::from([("cell".to_owned(), "lab".to_owned())]);
        let mut writer = PartWriter::create(&whole, about.clone()).expect("a file");
        for k in 0..3 {
            writer.wire("repose/v1/lab/robot/panda/state", &state(&format!("{{\"seq\":{k}}}")), k).expect("written");
        }
        writer.flush().expect("written");
        // As a killed process leaves it: the chunk, and part of the next.
        let mut left = std::fs::read(&whole).expect("the file");
        writer.wire("repose/v1/lab/robot/panda/state", &state("{}"), 3).expect("written");
        writer.finish(BTreeMap::new()).expect("written");
        let all = std::fs::read(&whole).expect("the file");
        for more in [0, 5, 40] {
            left.extend_from_slice(&all[left.len()..][..more]);
            std::fs::write(&cut, &left).expect("written");
            let mut reading = RecordingReader::open(&cut).expect("a recording");
            assert_eq!(reading.about(), &about);
            let stamps: Vec<u64> =
                std::iter::from_fn(|| reading.next_message().expect("readable")).map(|recorded| recorded.at_ns).collect();
            assert_eq!(stamps, [0, 1, 2]);
            assert!(reading.cut().is_some(), "it is said that the end is missing");
        }
        let mut reading = RecordingReader::open(&whole).expect("a recording");
        let last = std::iter::from_fn(|| reading.next_message().expect("readable")).last().expect("messages");
        assert_eq!((last.at_ns, &last.payload, reading.cut()), (3, &state("{}"), None));
    }

    #[test]
    fn other_files_are_refused_with_what_is_wrong() {
        let folder = tempfile::tempdir().expect("a folder");
        let text = folder.path().join("text.mcap");
        std::fs::write(&text, "no recording at all").expect("written");
        assert!(RecordingReader::open(&text).err().expect("refused").to_string().contains("not an MCAP file"));
        let foreign = folder.path().join("foreign.mcap");
        let mut writer = mcap::Writer::new(File::create(&foreign).expect("a file")).expect("a writer");
        writer.finish().expect("written");
        assert!(RecordingReader::open(&foreign).err().expect("refused").to_string().contains("expected a recording of the profile"));
        assert!(!is_recording(&foreign) && !is_recording(folder.path()));
    }
}
