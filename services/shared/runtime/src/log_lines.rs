//! What is logged, written so that one event does not pass for several.
//!
//! Names, keys and reasons come from whoever is let in, and may have line ends: what comes after one would stand in the log as an event of its own.

use std::io::{Result, Write};

/// What further lines of an event begin with: no event does.
const GOES_ON: &[u8] = b"\n    | ";

/// Writes events, each of which comes as one piece with a line end behind it.
pub(crate) struct EventWriter<W>(pub(crate) W);

impl<W: Write> Write for EventWriter<W> {
    fn write(&mut self, event: &[u8]) -> Result<usize> {
        match set_in(event) {
            Some(text) => self.0.write_all(&text)?,
            None => self.0.write_all(event)?,
        }
        Ok(event.len())
    }

    fn flush(&mut self) -> Result<()> {
        self.0.flush()
    }
}

/// An event with its further lines set in; none where it is one line.
fn set_in(event: &[u8]) -> Option<Vec<u8>> {
    let (lines, end) = event.split_at(event.len() - usize::from(event.ends_with(b"\n")));
    if !lines.iter().any(|byte| b"\n\r".contains(byte)) {
        return None;
    }
    let mut text = Vec::with_capacity(event.len() + GOES_ON.len());
    for byte in lines {
        match byte {
            b'\n' => text.extend_from_slice(GOES_ON),
            // A terminal would write over the line's beginning.
            b'\r' => text.extend_from_slice(b"\\r"),
            _ => text.push(*byte),
        }
    }
    text.extend_from_slice(end);
    Some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(event: &str) -> String {
        let mut writer = EventWriter(Vec::<u8>::new());
        writer.write_all(event.as_bytes()).expect("written");
        String::from_utf8(writer.0).expect("text")
    }

    #[test]
    fn an_event_of_several_lines_is_told_from_several_events() {
        assert_eq!(written("INFO ended\n"), "INFO ended\n");
        assert_eq!(written(""), "");
        let forged = written("INFO a camera called \"x\nERROR refused a login from 10.0.0.7\r\n\"\n");
        assert_eq!(forged, "INFO a camera called \"x\n    | ERROR refused a login from 10.0.0.7\\r\n    | \"\n");
        assert_eq!(forged.lines().filter(|line| line.starts_with("ERROR")).count(), 0);
    }
}
