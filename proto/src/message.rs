//! Payloads: a schema name, a form (JSON or bulk) and bytes; and the one place where JSON is read with errors that name the field.

use bytes::Bytes;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{Bulk, CallError, ErrorCode, limits, packed};

/// A type that crosses the wire under a schema name of its own.
pub trait Message {
    /// The schema's name and version, `PlaceRequest.v1`.
    const SCHEMA: &'static str;

    /// Checks what the types cannot: ranges, finiteness, limits.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    fn validate(&self) -> Result<(), CallError> {
        Ok(())
    }
}

/// An encoded message with its encoding.
#[derive(Debug, Clone, PartialEq)]
pub struct Payload {
    /// `application/json;repose.PlaceRequest.v1` or `application/octet-stream;repose.Scene.v1`.
    pub encoding: String,
    /// The encoded message.
    pub bytes: Bytes,
}

const JSON: &str = "application/json";
const BULK: &str = "application/octet-stream";

impl Payload {
    /// A message as JSON.
    ///
    /// # Errors
    /// `invalid_argument` when it is larger than a message may be, `internal` when it cannot be written.
    pub fn json<T: Message + Serialize>(message: &T) -> Result<Self, CallError> {
        let bytes = serde_json::to_vec(message).map_err(|e| CallError::internal(format!("{} could not be encoded: {e}", T::SCHEMA)))?;
        Self { encoding: format!("{JSON};repose.{}", T::SCHEMA), bytes: bytes.into() }.within_limit()
    }

    /// A message in bulk form.
    ///
    /// # Errors
    /// `invalid_argument` when it is larger than a message may be.
    pub fn bulk(schema: &str, bulk: &Bulk) -> Result<Self, CallError> {
        Self { encoding: format!("{BULK};repose.{schema}"), bytes: bulk.encode().into() }.within_limit()
    }

    /// A payload in packed form, which [`Payload::decode_bulk`] reads as the plain one.
    ///
    /// # Errors
    /// As [`Payload::bulk`].
    pub fn packed(schema: &str, bulk: &Bulk) -> Result<Self, CallError> {
        Self { encoding: format!("{BULK};repose.Packed{schema}"), bytes: packed::pack(bulk)?.into() }.within_limit()
    }

    /// Whether the payload is in packed form.
    pub fn is_packed(&self) -> bool {
        self.is_bulk() && self.schema().starts_with("Packed")
    }

    /// The same payload, if a message may be that large.
    ///
    /// # Errors
    /// `invalid_argument` on `payload` over [`limits::MAX_MESSAGE_BYTES`].
    pub fn within_limit(self) -> Result<Self, CallError> {
        check_size(self.bytes.len())?;
        Ok(self)
    }

    /// Whether the payload is in bulk form.
    pub fn is_bulk(&self) -> bool {
        self.encoding.starts_with(BULK)
    }

    /// The schema's name without its prefix, `PlaceRequest.v1`.
    pub fn schema(&self) -> &str {
        self.encoding.split_once(";repose.").map_or("", |(_, schema)| schema)
    }

    /// Reads and validates a JSON message.
    ///
    /// # Errors
    /// `invalid_argument` on `encoding` (wrong form, schema or version), on `payload` (oversize, not JSON) or on the field at fault.
    pub fn decode_json<T: Message + DeserializeOwned>(&self) -> Result<T, CallError> {
        check_size(self.bytes.len())?;
        self.expect(JSON, T::SCHEMA)?;
        let message: T = from_json(&self.bytes)?;
        message.validate()?;
        Ok(message)
    }

    /// Reads a bulk message of a schema.
    ///
    /// # Errors
    /// `invalid_argument` on `encoding` or on `payload`.
    pub fn decode_bulk(&self, schema: &str) -> Result<Bulk, CallError> {
        check_size(self.bytes.len())?;
        if self.is_packed() {
            self.expect(BULK, &format!("Packed{schema}"))?;
            return packed::unpack(&self.bytes);
        }
        self.expect(BULK, schema)?;
        Bulk::decode(&self.bytes)
    }

    fn expect(&self, form: &str, schema: &str) -> Result<(), CallError> {
        let expected = format!("{form};repose.{schema}");
        if self.encoding == expected {
            return Ok(());
        }
        Err(CallError::invalid("encoding", format!("expected {expected:?}, got {:?}", self.encoding)))
    }
}

/// Refuses more bytes than a message may have.
///
/// # Errors
/// `invalid_argument` on `payload`.
pub fn check_size(bytes: usize) -> Result<(), CallError> {
    if bytes > limits::MAX_MESSAGE_BYTES {
        return Err(CallError::invalid("payload", format!("at most {} bytes, got {bytes}", limits::MAX_MESSAGE_BYTES)));
    }
    Ok(())
}

/// Reads JSON; an error names the field by its path, or by its name where it is unknown or missing.
///
/// # Errors
/// `invalid_argument`.
pub fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CallError> {
    let mut reader = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let path = error.path().to_string();
        let message = error.into_inner().to_string();
        CallError { message: message.clone(), ..CallError::new(ErrorCode::InvalidArgument, "").at(field_of(&path, &message)) }
    })?;
    reader.end().map_err(|e| CallError::invalid("payload", e.to_string()))?;
    Ok(value)
}

/// Reads a metadata entry of JSON; an error names the field by its path below the entry.
///
/// # Errors
/// `invalid_argument`.
pub fn from_entry<T: DeserializeOwned>(bulk: &Bulk, entry: &str) -> Result<T, CallError> {
    from_json(bulk.text(entry)?.as_bytes()).map_err(|error| below(entry, error))
}

/// The error of a part of a message, with its field named from the message's top. What is no JSON at all is the fault of the part as a whole.
pub fn below(part: &str, error: CallError) -> CallError {
    let field = match error.field.as_deref() {
        None | Some("payload") => part.to_owned(),
        Some(field) if field.starts_with('[') => format!("{part}{field}"),
        Some(field) => format!("{part}.{field}"),
    };
    error.at(field)
}

/// Reads JSON that a person wrote: as [`from_json`], and refuses fields at the top that `T` does not have, even where `T` ignores them on the
/// wire for the sake of newer senders. A misspelt name in a file is a mistake.
///
/// # Errors
/// `invalid_argument`.
pub fn from_file_json<T: DeserializeOwned + Serialize>(bytes: &[u8]) -> Result<T, CallError> {
    let value: T = from_json(bytes)?;
    let given: serde_json::Map<String, serde_json::Value> = from_json(bytes)?;
    let known = serde_json::to_value(&value).map_err(|e| CallError::internal(e.to_string()))?;
    match given.iter().find(|(name, given)| !given.is_null() && known.get(name.as_str()).is_none()) {
        Some((name, _)) => Err(CallError::invalid(name.as_str(), format!("unknown field `{name}`"))),
        None => Ok(value),
    }
}

/// serde reports an unknown or missing field at its parent's path and names it in the message only.
fn field_of(path: &str, message: &str) -> String {
    let named =
        ["unknown field `", "missing field `"].iter().find_map(|start| message.strip_prefix(start)).and_then(|rest| rest.split('`').next());
    match (path, named) {
        ("." | "?", None) => "payload".to_owned(),
        ("." | "?", Some(name)) => name.to_owned(),
        (path, Some(name)) if !path.ends_with(name) => format!("{path}.{name}"),
        (path, _) => path.to_owned(),
    }
}
