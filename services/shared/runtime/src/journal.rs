//! A worker's copies of its calls and replies, for whoever records the cell: made while somebody shows that they record, and none otherwise.
//!
//! Copying costs the call no more than a push into a bounded queue, whose messages share their bytes with the call's; a task of its own encodes and
//! sends them, some time later and several together: a message that goes alone wakes several threads here, in the router and in the recorder, just
//! when the answer that it is a copy of is on its way. What finds no room, here or on a link to a recorder that does not keep up, is dropped: a recorder
//! sees a gap in the numbers, and nobody waits for it.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use repose_proto::{Cell, JournalEntry, JournalKind, Payload, Service};
use tokio::sync::{Notify, mpsc, oneshot};
use tokio_util::sync::CancellationToken;

use crate::RuntimeError;
use crate::robots::now_ns;
use crate::transport::{AliveWatch, Traffic, Transport};

/// How long a copy may wait for others to go with. Longer: fewer threads woken, and more lost with a worker that is killed.
pub const COPIES_WAIT: Duration = Duration::from_millis(200);
/// Copies that may wait to be sent.
const MAX_WAITING: usize = 4096;
/// Bytes that they may have together.
const MAX_WAITING_BYTES: usize = 64 << 20;
/// Bytes of them at which they wait no longer.
const ENOUGH_BYTES: usize = MAX_WAITING_BYTES / 8;

/// Takes copies. Cheap to clone; the last clone ends the journal.
#[derive(Clone)]
pub(crate) struct Journal {
    is_on: Arc<AtomicBool>,
    waiting_bytes: Arc<AtomicUsize>,
    line: Arc<Mutex<Line>>,
    /// Asks for what waits to be sent at once; whoever asks is told when it is.
    flushes: mpsc::Sender<oneshot::Sender<()>>,
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
        let (journal, waiting) = Self::new();
        tokio::spawn(stop.run_until_cancelled_owned(switch(recorders, journal.is_on.clone(), changed)));
        tokio::spawn(send(transport, cell.journal(service, worker), waiting));
        Ok(journal)
    }

    fn new() -> (Self, Waiting) {
        let (waiting, entries) = mpsc::channel(MAX_WAITING);
        let (flushes, flushed) = mpsc::channel(1);
        let line = Arc::new(Mutex::new(Line { next_seq: 0, waiting }));
        let journal = Self { is_on: Arc::default(), waiting_bytes: Arc::default(), line, flushes };
        let waiting = Waiting { entries, flushes: flushed, bytes: journal.waiting_bytes.clone() };
        (journal, waiting)
    }

    /// Waits until the copies made so far have been sent.
    pub(crate) async fn flush(&self) {
        let (done, sent) = oneshot::channel();
        if self.flushes.send(done).await.is_ok() {
            // A sender that has ended has nothing left to send.
            let _ended = sent.await;
        }
    }

    /// Whether somebody records.
    pub(crate) fn is_on(&self) -> bool {
        self.is_on.load(Ordering::Acquire)
    }

    /// Puts a copy in line; never waits. `cell` is the one that a call is for, where that is another than the worker's.
    pub(crate) fn copy(&self, kind: JournalKind, cell: Option<&str>, attachment: &[u8], payload: &Payload) {
        let (stamp_ns, attachment) = (now_ns(), String::from_utf8_lossy(attachment).into_owned());
        let bytes = payload.bytes.len();
        let had = self.waiting_bytes.fetch_add(bytes, Ordering::AcqRel);
        let mut line = self.line.lock().unwrap_or_else(PoisonError::into_inner);
        let cell = cell.map(str::to_owned);
        let entry = JournalEntry { seq: line.next_seq, stamp_ns, kind, cell, attachment, payload: payload.clone() };
        line.next_seq += 1;
        let has_room = had + bytes <= MAX_WAITING_BYTES && line.waiting.try_send(entry).is_ok();
        drop(line);
        if had + bytes >= ENOUGH_BYTES {
            // Nobody waits for the answer. Where there is no room, somebody has asked already.
            let _asked = self.flushes.try_send(oneshot::channel().0);
        }
        if !has_room {
            self.waiting_bytes.fetch_sub(bytes, Ordering::AcqRel);
            metrics::counter!("repose_journal_dropped_total").increment(1);
        }
    }
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

/// The copies that wait, as the task that sends them sees them.
struct Waiting {
    entries: mpsc::Receiver<JournalEntry>,
    flushes: mpsc::Receiver<oneshot::Sender<()>>,
    bytes: Arc<AtomicUsize>,
}

impl Waiting {
    /// Copies to be sent together, and who waits for that; none when the journal has ended.
    async fn next(&mut self) -> Option<(Vec<JournalEntry>, Option<oneshot::Sender<()>>)> {
        let (mut together, mut flush) = (Vec::new(), None);
        tokio::select! {
            first = self.entries.recv() => together.push(first?),
            Some(asked) = self.flushes.recv() => flush = Some(asked),
        }
        if flush.is_none() {
            tokio::select! {
                () = tokio::time::sleep(COPIES_WAIT) => {}
                asked = self.flushes.recv() => flush = asked,
            }
        }
        while let Ok(entry) = self.entries.try_recv() {
            together.push(entry);
        }
        self.bytes.fetch_sub(together.iter().map(|entry| entry.payload.bytes.len()).sum(), Ordering::AcqRel);
        Some((together, flush))
    }
}

async fn send(transport: Arc<dyn Transport>, key: String, mut waiting: Waiting) {
    while let Some((together, flush)) = waiting.next().await {
        let encoded = together.iter().map(|entry| Payload::bulk(JournalEntry::SCHEMA, &entry.to_bulk()));
        // A message of nearly the largest size: its copy would be larger.
        let copies: Vec<Payload> = encoded.filter_map(Result::ok).collect();
        let (too_large, count) = (together.len() - copies.len(), copies.len());
        let lost = match transport.put_all(&key, copies, Traffic::Journal).await {
            Ok(()) => too_large,
            Err(error) => {
                tracing::debug!(%error, count, "copies of calls are lost");
                too_large + count
            }
        };
        metrics::counter!("repose_journal_dropped_total").increment(lost as u64);
        if let Some(done) = flush {
            // It may not wait for it.
            let _gone = done.send(());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn copies_of_many_threads_come_in_the_order_of_their_numbers() {
        let (journal, Waiting { mut entries, .. }) = Journal::new();
        let payload = Payload { encoding: String::new(), bytes: vec![7; 64].into() };
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| (0..MAX_WAITING / 16).for_each(|_| journal.copy(JournalKind::Call, None, b"{}", &payload)));
            }
        });
        for seq in 0..MAX_WAITING as u64 / 2 {
            assert_eq!(entries.recv().await.map(|entry| entry.seq), Some(seq));
        }
        assert_eq!(journal.waiting_bytes.load(Ordering::Acquire), 64 * MAX_WAITING / 2);
    }

    #[tokio::test]
    async fn a_copy_without_room_is_missing_in_the_numbers() {
        let (journal, Waiting { mut entries, .. }) = Journal::new();
        let copy =
            |bytes: usize| journal.copy(JournalKind::Call, None, b"{}", &Payload { encoding: String::new(), bytes: vec![0; bytes].into() });
        copy(1);
        copy(MAX_WAITING_BYTES);
        copy(1);
        assert_eq!((entries.recv().await.map(|entry| entry.seq), entries.recv().await.map(|entry| entry.seq)), (Some(0), Some(2)));
    }
    #[tokio::test(start_paused = true)]
    async fn copies_go_together_some_time_after_the_first_and_at_once_where_somebody_waits_or_they_are_large() {
        let (journal, mut waiting) = Journal::new();
        let copy =
            |bytes: usize| journal.copy(JournalKind::Call, None, b"{}", &Payload { encoding: String::new(), bytes: vec![0; bytes].into() });
        let numbers = |together: &[JournalEntry]| together.iter().map(|entry| entry.seq).collect::<Vec<_>>();
        copy(1);
        copy(1);
        let began = tokio::time::Instant::now();
        let (together, flush) = waiting.next().await.expect("copies");
        assert_eq!((numbers(&together), flush.is_some(), began.elapsed()), (vec![0, 1], false, COPIES_WAIT));
        copy(1);
        copy(ENOUGH_BYTES);
        let began = tokio::time::Instant::now();
        let (together, _) = waiting.next().await.expect("copies");
        assert_eq!((numbers(&together), began.elapsed()), (vec![2, 3], Duration::ZERO));
        assert_eq!(journal.waiting_bytes.load(Ordering::Acquire), 0);
        copy(1);
        let sending = async {
            let (together, flush) = waiting.next().await.expect("a copy");
            flush.expect("somebody waits").send(()).expect("still");
            numbers(&together)
        };
        assert_eq!(tokio::join!(journal.flush(), sending).1, [4]);
        assert_eq!(began.elapsed(), Duration::ZERO);
        drop(journal);
        assert!(waiting.next().await.is_none(), "the journal has ended");
    }
}
