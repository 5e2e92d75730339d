//! Copies of calls and answers, for whoever records a cell: queries cannot be overheard.
//!
//! A worker puts them on its [`crate::Cell::journal`] while somebody shows the token [`crate::Cell::live_recorder`], and makes none otherwise. A copy
//! is in bulk form: the tensor `payload` (u8 `[n]`) has the bytes as they were on the wire, the metadata what was beside them.

use safetensors::Dtype;

use crate::{Bulk, CallError, Payload, Tensor};

/// Which of the two a copy is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JournalKind {
    /// A call, as it came.
    Call,
    /// A reply, as it went: progress, or the terminal one.
    Reply,
}

impl JournalKind {
    fn as_str(self) -> &'static str {
        match self {
            Self::Call => "call",
            Self::Reply => "reply",
        }
    }
}

/// A copy of a call or of a reply.
#[derive(Debug, Clone, PartialEq)]
pub struct JournalEntry {
    /// Counts the copies that a worker has made since it started, those included that it could not send: a gap is a loss.
    pub seq: u64,
    /// When the call came or the reply went, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// Which of the two.
    pub kind: JournalKind,
    /// The cell that a call is for, where that is not the worker's own: it has the scenes that the call is about. Of replies none.
    pub cell: Option<String>,
    /// The attachment, JSON: a [`crate::CallAttachment`] or a [`crate::ReplyAttachment`].
    pub attachment: String,
    /// The message.
    pub payload: Payload,
}

impl JournalEntry {
    /// The bulk schema's name.
    pub const SCHEMA: &'static str = "JournalEntry.v1";

    /// The bulk form.
    pub fn to_bulk(&self) -> Bulk {
        let mut bulk = Bulk::default();
        for (name, text) in [
            ("seq", self.seq.to_string()),
            ("stamp_ns", self.stamp_ns.to_string()),
            ("kind", self.kind.as_str().to_owned()),
            ("attachment", self.attachment.clone()),
            ("encoding", self.payload.encoding.clone()),
        ] {
            bulk.metadata.insert(name.to_owned(), text);
        }
        if let Some(cell) = &self.cell {
            bulk.metadata.insert("cell".to_owned(), cell.clone());
        }
        bulk.tensors.insert("payload".to_owned(), Tensor::u8(&[self.payload.bytes.len()], &self.payload.bytes));
        bulk
    }

    /// Reads the bulk form.
    ///
    /// # Errors
    /// `invalid_argument` that names the entry at fault.
    pub fn from_bulk(bulk: &Bulk) -> Result<Self, CallError> {
        let number = |name: &str| {
            bulk.text(name)?.parse().map_err(|_| CallError::invalid(name, format!("expected a count, got {:?}", bulk.text(name))))
        };
        let kind = match bulk.text("kind")? {
            "call" => JournalKind::Call,
            "reply" => JournalKind::Reply,
            other => return Err(CallError::invalid("kind", format!("expected call or reply, got {other:?}"))),
        };
        let (_, bytes) = bulk.values::<u8>("payload", Dtype::U8, "[n]", |shape| shape.len() == 1)?;
        Ok(Self {
            seq: number("seq")?,
            stamp_ns: number("stamp_ns")?,
            kind,
            cell: bulk.metadata.get("cell").cloned(),
            attachment: bulk.text("attachment")?.to_owned(),
            payload: Payload { encoding: bulk.text("encoding")?.to_owned(), bytes: bytes.into() },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_comes_back_as_it_went_and_a_bad_one_names_what_is_wrong() {
        let payload = Payload { encoding: "application/json;repose.PlaceRequest.v1".to_owned(), bytes: vec![0, 1, 255].into() };
        let reply =
            JournalEntry { seq: 7, stamp_ns: u64::MAX, kind: JournalKind::Reply, cell: None, attachment: "{\"v\":1}".to_owned(), payload };
        let call = JournalEntry { kind: JournalKind::Call, cell: Some("cell-2".to_owned()), ..reply.clone() };
        for entry in [&call, &reply] {
            let bulk = Bulk::decode(&entry.to_bulk().encode()).expect("bulk");
            assert_eq!(&JournalEntry::from_bulk(&bulk).expect("an entry"), entry);
        }
        let bulk = reply.to_bulk();
        for (name, text) in [("kind", "gossip"), ("seq", "-1")] {
            let mut wrong = bulk.clone();
            wrong.metadata.insert(name.to_owned(), text.to_owned());
            assert_eq!(JournalEntry::from_bulk(&wrong).expect_err("it is wrong").field.as_deref(), Some(name));
        }
    }
}
