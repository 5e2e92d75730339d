//! What tools answer.

use repose_proto::CallError;
use serde::Serialize;
use serde_json::Value;

/// The result of a tool call.
#[derive(Debug, Clone, PartialEq)]
pub struct ToolResult {
    /// In sentences.
    pub text: String,
    /// The same as data.
    pub data: Value,
    /// JPEG.
    pub picture: Option<Vec<u8>>,
}

impl ToolResult {
    /// An answer as text and data.
    ///
    /// # Errors
    /// `internal` when the data cannot be encoded.
    pub fn new<T: Serialize>(text: String, data: &T, picture: Option<Vec<u8>>) -> Result<Self, CallError> {
        let data = serde_json::to_value(data).map_err(|e| CallError::internal(e.to_string()))?;
        Ok(Self { text, data, picture })
    }
}
