//! Plain CDR with its header, both ways.

use byteorder::{BigEndian, LittleEndian};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Why bytes are not the message they should be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MessageError {
    /// The header names no byte order of plain CDR.
    #[error("expected the header of plain CDR (00 00 or 00 01), got {got:02x?}")]
    Encapsulation {
        /// The first bytes.
        got: Vec<u8>,
    },
    /// The body ends early or holds something else.
    #[error("not a {message}: {reason}")]
    Body {
        /// The message's name.
        message: &'static str,
        /// What the decoder says.
        reason: String,
    },
    /// The picture's or cloud's data is shorter than its sizes say.
    #[error("{message}: {expected} bytes of data expected, got {got}")]
    Short {
        /// The message's name.
        message: &'static str,
        /// Bytes that the sizes ask for.
        expected: usize,
        /// Bytes that came.
        got: usize,
    },
    /// An organized cloud whose points are not where their pixels look.
    #[error("{off_percent} % of the points lie off their pixels' rays; expected the camera's optical frame (x right, y down, z forward)")]
    NotOptical {
        /// How many of them.
        off_percent: usize,
    },
    /// A kind of content that is not read.
    #[error("{field}: {got} is not supported, only {expected}")]
    Unsupported {
        /// The field.
        field: &'static str,
        /// What came.
        got: String,
        /// What would do.
        expected: &'static str,
    },
}

/// A message from its header and body; `message` is its name, for errors.
///
/// # Errors
/// [`MessageError`] when the bytes are none.
pub fn decode<T: DeserializeOwned>(bytes: &[u8], message: &'static str) -> Result<T, MessageError> {
    let Some((header, body)) = bytes.split_at_checked(4) else {
        return Err(MessageError::Encapsulation { got: bytes.to_vec() });
    };
    let decoded = match header {
        [0, 0, _, _] => cdr_encoding::from_bytes::<T, BigEndian>(body),
        [0, 1, _, _] => cdr_encoding::from_bytes::<T, LittleEndian>(body),
        _ => return Err(MessageError::Encapsulation { got: header.to_vec() }),
    };
    decoded.map(|(value, _)| value).map_err(|e| MessageError::Body { message, reason: e.to_string() })
}

/// A message as bytes, little-endian.
///
/// # Errors
/// [`MessageError::Body`] for what CDR cannot say, which no message here is.
pub fn encode<T: Serialize>(value: &T, message: &'static str) -> Result<Vec<u8>, MessageError> {
    let body = cdr_encoding::to_vec::<T, LittleEndian>(value).map_err(|e| MessageError::Body { message, reason: e.to_string() })?;
    Ok([&[0, 1, 0, 0], body.as_slice()].concat())
}
