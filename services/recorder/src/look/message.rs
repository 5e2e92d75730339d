//! One message to look at, encoded.

use foxglove::{Encode, Schema};

/// A message for visualization tools.
#[derive(Debug, Clone)]
pub struct VisualMessage {
    /// Where viewers find it, `/camera/front/image`.
    pub topic: String,
    /// Of which schema.
    pub schema: Schema,
    /// When, nanoseconds since the Unix epoch.
    pub at_ns: u64,
    /// The message, in Protocol Buffers.
    pub message: Vec<u8>,
}

impl VisualMessage {
    /// A message of one of Foxglove's schemas; none of a message without one.
    pub(super) fn new<T: Encode>(topic: String, at_ns: u64, message: &T) -> Option<Self> {
        let mut bytes = Vec::with_capacity(message.encoded_len().unwrap_or_default());
        // A vector grows: there is always room.
        message.encode(&mut bytes).ok()?;
        Some(Self { topic, schema: T::get_schema()?, at_ns, message: bytes })
    }
}
