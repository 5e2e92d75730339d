//! A worker's copies of its calls and replies, for whoever records the cell: made while somebody shows that they record, and none otherwise.
//!
//! Copying costs the call no more than a push into a bounded queue, whose messages share their bytes with the call's; a task of its own encodes and
//! sends them. What finds no room is dropped and counted, which a recorder sees as a gap in the numbers.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
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
    counted: Arc<Counted>,
    waiting: mpsc::Sender<JournalEntry>,
}

#[derive(Default)]
struct Counted {
    seq: AtomicU64,
    waiting_bytes: AtomicUsize,
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
        let (waiting, entries) = mpsc::channel(MAX_WAITING);
        let journal = Self { is_on: Arc::default(), counted: Arc::default(), waiting };
        tokio::spawn(stop.run_until_cancelled_owned(switch(recorders, journal.is_on.clone(), changed)));
        tokio::spawn(send(transport, cell.journal(service, worker), entries, journal.counted.clone()));
        Ok(journal)
    }

    /// Whether somebody records.
    pub(crate) fn is_on(&self) -> bool {
        self.is_on.load(Ordering::Acquire)
    }

    /// Puts a copy in line; never waits.
    pub(crate) fn copy(&self, kind: JournalKind, attachment: &[u8], payload: &Payload) {
        let seq = self.counted.seq.fetch_add(1, Ordering::AcqRel);
        let bytes = payload.bytes.len();
        let had = self.counted.waiting_bytes.fetch_add(bytes, Ordering::AcqRel);
        let attachment = String::from_utf8_lossy(attachment).into_owned();
        let entry = JournalEntry { seq, stamp_ns: now_ns(), kind, attachment, payload: payload.clone() };
        if had + bytes > MAX_WAITING_BYTES || self.waiting.try_send(entry).is_err() {
            self.counted.waiting_bytes.fetch_sub(bytes, Ordering::AcqRel);
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

async fn send(transport: Arc<dyn Transport>, key: String, mut entries: mpsc::Receiver<JournalEntry>, counted: Arc<Counted>) {
    while let Some(entry) = entries.recv().await {
        counted.waiting_bytes.fetch_sub(entry.payload.bytes.len(), Ordering::AcqRel);
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
