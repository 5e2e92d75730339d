//! One message to look at, encoded.

use serde::Serialize;

use super::schema::Kind;

/// Something to look at.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    /// Where viewers find it, `/camera/front/image`.
    pub topic: String,
    /// Of which schema.
    pub kind: Kind,
    /// When, nanoseconds since the Unix epoch.
    pub at_ns: u64,
    /// The message, JSON.
    pub message: Vec<u8>,
}

impl Look {
    pub(super) fn new<T: Serialize>(topic: String, kind: Kind, at_ns: u64, message: &T) -> Self {
        // Plain structs of numbers and text: they can always be written.
        Self { topic, kind, at_ns, message: serde_json::to_vec(message).unwrap_or_default() }
    }
}
