//! A worker's copies of its calls and replies, for whoever records the cell: made while somebody shows that they record, and none otherwise.
//!
//! Copying costs the call no more than a push into a bounded queue, whose messages share their bytes with the call's; a task of its own encodes and
//! sends them. What finds no room is dropped and counted, which a recorder sees as a gap in the numbers.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use repose_proto::{Cell, JournalEntry, JournalKind, Payload, Service};
use tokio::sync::{Notify, mpsc};
use tokio_util::sync::CancellationToken;

use crate::RuntimeError;
use crate::transport::{AliveWatch, Traffic, Transport};

/// Copies that may wait to be sent.
const MAX_WAITING: usize = 4096;
/// Bytes that they may have together.
const MAX_WAITING_BYTES: usize = 64 << 20;

/// Takes copies. Cheap to clone; the last clone ends the journal.
#[derive(Clone)]
pub(crate) struct Journal {
    is_on: Arc<AtomicBool>,
    waiting_bytes: Arc<AtomicUsize>,
    line: Arc<Mutex<Line>>,
}

/// The line of copies, and the number of the next: a copy is numbered and put in line in one step, so that they come in the order of their numbers.
struct Line {
    next_seq: u64,
    waiting: mpsc::Sender<JournalEntry>,
}

impl Journal {
    /// Watches for recorders of a cell on behalf of a worker, until `stop`. `changed` is told whenever the journal begins or ends.
    pub(crate) async fn follow(
        transport: Arc<dyn Transport>,
        cell: &Cell,
        (service, worker): (Service, &str),
        changed: Arc<Notify>,
        stop: CancellationToken,
    ) -> Result<Self, RuntimeError> {
        let recorders = transport.watch_alive(&cell.live_recorder("*")).await?;
        let (journal, entries) = Self::new();
        tokio::spawn(stop.run_until_cancelled_owned(switch(recorders, journal.is_on.clone(), changed)));
        tokio::spawn(send(transport, cell.journal(service, worker), entries, journal.waiting_bytes.clone()));
        Ok(journal)
    }

    fn new() -> (Self, mpsc::Receiver<JournalEntry>) {
        let (waiting, entries) = mpsc::channel(MAX_WAITING);
        let line = Arc::new(Mutex::new(Line { next_seq: 0, waiting }));
        (Self { is_on: Arc::default(), waiting_bytes: Arc::default(), line }, entries)
    }

    /// Whether somebody records.
    pub(crate) fn is_on(&self) -> bool {
        self.is_on.load(Ordering::Acquire)
    }

    /// Puts a copy in line; never waits.
    pub(crate) fn copy(&self, kind: JournalKind, attachment: &[u8], payload: &Payload) {
        let (stamp_ns, attachment) = (now_ns(), String::from_utf8_lossy(attachment).into_owned());
        let bytes = payload.bytes.len();
        let had = self.waiting_bytes.fetch_add(bytes, Ordering::AcqRel);
        let mut line = self.line.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = JournalEntry { seq: line.next_seq, stamp_ns, kind, attachment, payload: payload.clone() };
        line.next_seq += 1;
        let has_room = had + bytes <= MAX_WAITING_BYTES && line.waiting.try_send(entry).is_ok();
        drop(line);
        if !has_room {
            self.waiting_bytes.fetch_sub(bytes, Ordering::AcqRel);
            metrics::counter!("repose_journal_dropped_total").increment(1);
        }
    }
}

fn now_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64)
}

/// Switches the journal on and off, until the network goes.
async fn switch(mut recorders: AliveWatch, is_on: Arc<AtomicBool>, changed: Arc<Notify>) {
    loop {
        let there = !recorders.current().is_empty();
        if is_on.swap(there, Ordering::AcqRel) != there {
            tracing::info!("{}", if there { "somebody records: calls are copied" } else { "nobody records any more" });
            changed.notify_one();
        }
        if !recorders.changed().await {
            return;
        }
    }
}

async fn send(transport: Arc<dyn Transport>, key: String, mut entries: mpsc::Receiver<JournalEntry>, waiting_bytes: Arc<AtomicUsize>) {
    while let Some(entry) = entries.recv().await {
        waiting_bytes.fetch_sub(entry.payload.bytes.len(), Ordering::AcqRel);
        let sent = match Payload::bulk(JournalEntry::SCHEMA, &entry.to_bulk()) {
            Ok(copy) => transport.put(&key, copy, Traffic::Journal).await.map_err(|e| e.to_string()),
            // A message of nearly the largest size: its copy would be larger.
            Err(error) => Err(error.to_string()),
        };
        if let Err(error) = sent {
            metrics::counter!("repose_journal_dropped_total").increment(1);
            tracing::debug!(error, seq = entry.seq, "a copy of a call is lost");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn copies_of_many_threads_come_in_the_order_of_their_numbers() {
        let (journal, mut entries) = Journal::new();
        let payload = Payload { encoding: String::new(), bytes: vec![7; 64].into() };
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| (0..MAX_WAITING / 16).for_each(|_| journal.copy(JournalKind::Call, b"{}", &payload)));
            }
        });
        for seq in 0..MAX_WAITING as u64 / 2 {
            assert_eq!(entries.recv().await.map(|entry| entry.seq), Some(seq));
        }
        assert_eq!(journal.waiting_bytes.load(Ordering::Acquire), 64 * MAX_WAITING / 2);
    }

    #[tokio::test]
    async fn a_copy_without_room_is_missing_in_the_numbers() {
        let (journal, mut entries) = Journal::new();
        let copy =
            |bytes: usize| journal.copy(JournalKind::Call, b"{}", &Payload { encoding: String::new(), bytes: vec![0; bytes].into() });
        copy(1);
        copy(MAX_WAITING_BYTES);
        copy(1);
        assert_eq!((entries.recv().await.map(|entry| entry.seq), entries.recv().await.map(|entry| entry.seq)), (Some(0), Some(2)));
    }
}
