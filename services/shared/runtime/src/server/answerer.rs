//! The way back of one call.

use std::collections::BTreeMap;

use bytes::Bytes;
use repose_proto::{CallError, JournalKind, Payload, ReplyAttachment, ReplyKind};

use crate::journal::Journal;
use crate::registry::CallResult;
use crate::transport::Replier;

/// The way back of one call, with what every reply carries.
pub(super) struct Answerer {
    pub(super) replier: Box<dyn Replier>,
    pub(super) attachment: ReplyAttachment,
    /// Takes copies, where somebody records and the call was copied too.
    pub(super) journal: Option<Journal>,
}

impl Answerer {
    async fn send(&self, payload: Payload, attachment: &ReplyAttachment) {
        let encoded = Bytes::from(attachment.encode());
        if let Some(journal) = &self.journal {
            journal.copy(JournalKind::Reply, None, &encoded, &payload);
        }
        // The caller sees a stream that ends, and calls again or not.
        if let Err(error) = self.replier.reply(payload, encoded).await {
            tracing::warn!(%error, id = attachment.id, "a reply could not be sent");
        }
    }

    pub(super) async fn progress(&mut self, payload: Payload) {
        let n = self.attachment.n.unwrap_or(0) + 1;
        self.attachment.n = Some(n);
        let progress = ReplyAttachment {
            kind: ReplyKind::Progress,
            n: Some(n),
            worker: None,
            attempt: None,
            timing_ms: BTreeMap::new(),
            ..self.attachment.clone()
        };
        self.send(payload, &progress).await;
    }

    /// The one terminal reply. Consumes the way back, which ends the stream.
    pub(super) async fn finish(self, outcome: CallResult, timing_ms: BTreeMap<String, f64>) {
        let outcome = outcome.and_then(|payload| {
            let size = payload.bytes.len();
            payload.within_limit().map_err(|_| CallError::internal(format!("the result has {size} bytes, more than a message may have")))
        });
        let (kind, payload) = match outcome {
            Ok(payload) => (ReplyKind::Result, payload),
            Err(error) => (ReplyKind::Error, error_payload(&error)),
        };
        let attachment = ReplyAttachment { kind, n: None, timing_ms, ..self.attachment.clone() };
        self.send(payload, &attachment).await;
    }
}

fn error_payload(error: &CallError) -> Payload {
    Payload::json(error).unwrap_or_else(|cause| {
        tracing::error!(%cause, "an error reply could not be encoded");
        Payload { encoding: String::new(), bytes: Bytes::new() }
    })
}
