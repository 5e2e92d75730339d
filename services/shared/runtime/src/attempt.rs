//! One attempt of a call: its reply stream, read up to the one terminal reply.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use repose_proto::{CallError, Payload, ReplyAttachment, ReplyKind};
use tokio::sync::mpsc;

use crate::transport::{ReplyEvent, ReplyStream};

/// How an attempt ended.
#[derive(Debug)]
pub enum Ended {
    /// A result came.
    Result {
        /// The result.
        payload: Payload,
        /// Who sent it.
        worker: Option<String>,
        /// Milliseconds by stage.
        timing_ms: BTreeMap<String, f64>,
    },
    /// An error came.
    Error(CallError),
    /// The stream ended without a terminal reply: there is no such worker, or it died.
    Empty,
    /// The caller goes to another worker.
    Left,
    /// What came could not be read.
    Garbled(CallError),
    /// The caller cancelled.
    Cancelled,
    /// The deadline passed.
    Overdue,
}

/// The replies to one attempt.
pub struct Attempt<'a> {
    replies: ReplyStream,
    id: &'a str,
    progress: Option<&'a mpsc::Sender<Payload>>,
    progressed: bool,
}

impl<'a> Attempt<'a> {
    /// Reads `replies` of the call `id`, passing progress on.
    pub fn new(replies: ReplyStream, id: &'a str, progress: Option<&'a mpsc::Sender<Payload>>) -> Self {
        Self { replies, id, progress, progressed: false }
    }

    /// Waits for the end. Cancel safe.
    pub async fn next(&mut self) -> Ended {
        while let Some(event) = self.replies.next().await {
            match event {
                ReplyEvent::TimedOut => return Ended::Overdue,
                ReplyEvent::Reply { payload, attachment } => {
                    if let Some(ended) = self.take(payload, &attachment) {
                        return ended;
                    }
                }
            }
        }
        Ended::Empty
    }

    /// Reads what still comes after the end, up to the end of the stream, and counts terminal replies in it.
    pub fn count_rest(self, duplicates: Arc<AtomicU64>) {
        let (mut replies, id) = (self.replies, self.id.to_owned());
        tokio::spawn(async move {
            while let Some(ReplyEvent::Reply { attachment, .. }) = replies.next().await {
                let terminal = |a: ReplyAttachment| a.id == id && a.kind != ReplyKind::Progress;
                if ReplyAttachment::decode(&attachment).is_ok_and(terminal) {
                    tracing::error!(id, "a second terminal reply came");
                    duplicates.fetch_add(1, Ordering::Relaxed);
                }
            }
        });
    }

    /// Whether the worker has shown that it has the call.
    pub fn has_progressed(&self) -> bool {
        self.progressed
    }

    fn take(&mut self, payload: Payload, attachment: &[u8]) -> Option<Ended> {
        let attachment = match ReplyAttachment::decode(attachment) {
            Ok(attachment) => attachment,
            Err(error) => return Some(Ended::Garbled(error)),
        };
        // An error about an attachment that the worker could not read has no id to carry.
        if attachment.id != self.id && !(attachment.id.is_empty() && attachment.kind == ReplyKind::Error) {
            tracing::warn!(expected = self.id, got = attachment.id, "a reply to another call was ignored");
            return None;
        }
        match attachment.kind {
            ReplyKind::Progress => {
                self.progressed = true;
                if let Some(progress) = self.progress {
                    // A reader that is slow, or gone, loses progress and nothing else.
                    drop(progress.try_send(payload));
                }
                None
            }
            ReplyKind::Result => Some(Ended::Result { payload, worker: attachment.worker, timing_ms: attachment.timing_ms }),
            ReplyKind::Error => Some(payload.decode_json().map_or_else(Ended::Garbled, Ended::Error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use repose_proto::limits;

    use super::*;
    use crate::mailbox::mailbox;

    #[tokio::test]
    async fn terminal_replies_after_the_terminal_one_are_counted_and_progress_is_not() {
        let (sender, replies) = mailbox(8);
        let reply = |kind: ReplyKind| {
            let attachment = ReplyAttachment {
                v: limits::VERSION,
                id: "a".to_owned(),
                kind,
                n: None,
                worker: None,
                attempt: None,
                timing_ms: BTreeMap::new(),
            };
            ReplyEvent::Reply {
                payload: Payload { encoding: String::new(), bytes: Default::default() },
                attachment: attachment.encode().into(),
            }
        };
        for kind in [ReplyKind::Result, ReplyKind::Progress, ReplyKind::Error, ReplyKind::Result] {
            sender.push(reply(kind));
        }
        drop(sender);
        let mut attempt = Attempt::new(ReplyStream { replies, _query: Box::new(()) }, "a", None);
        assert!(matches!(attempt.next().await, Ended::Result { .. }));
        let duplicates = Arc::new(AtomicU64::new(0));
        attempt.count_rest(duplicates.clone());
        let both = async {
            while duplicates.load(Ordering::Relaxed) < 2 {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(10), both).await.unwrap();
    }
}
