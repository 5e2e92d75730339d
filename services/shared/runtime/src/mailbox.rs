//! A bounded mailbox that drops the oldest when it is full, and counts what it dropped.
//!
//! Everything that the network delivers goes through one: a transport's callback may neither block nor wait, and memory is bounded.
//! Dropping the oldest suits every use here: of states and frames the newest counts, and of a call's replies the last one, the
//! terminal reply, must not be lost.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

struct Shared<T> {
    items: Mutex<VecDeque<T>>,
    capacity: usize,
    arrived: Notify,
    closed: AtomicBool,
    dropped: AtomicU64,
}

impl<T> Shared<T> {
    fn items(&self) -> MutexGuard<'_, VecDeque<T>> {
        self.items.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn close(&self) {
        self.closed.store(true, Ordering::Release);
        self.arrived.notify_one();
    }
}

/// A mailbox of at most `capacity` items (at least one).
pub fn mailbox<T>(capacity: usize) -> (MailboxSender<T>, MailboxReceiver<T>) {
    let shared = Arc::new(Shared {
        items: Mutex::new(VecDeque::new()),
        capacity: capacity.max(1),
        arrived: Notify::new(),
        closed: AtomicBool::new(false),
        dropped: AtomicU64::new(0),
    });
    (MailboxSender { owner: Arc::new(Closer(shared.clone())) }, MailboxReceiver { shared })
}

struct Closer<T>(Arc<Shared<T>>);

impl<T> Drop for Closer<T> {
    fn drop(&mut self) {
        self.0.close();
    }
}

/// The side that puts in; the mailbox ends when the last clone is dropped.
pub struct MailboxSender<T> {
    owner: Arc<Closer<T>>,
}

impl<T> Clone for MailboxSender<T> {
    fn clone(&self) -> Self {
        Self { owner: self.owner.clone() }
    }
}

impl<T> MailboxSender<T> {
    /// Puts an item in; never waits. The oldest goes when there is no room.
    pub fn push(&self, item: T) {
        let shared = &self.owner.0;
        let mut items = shared.items();
        let displaced = if items.len() == shared.capacity { items.pop_front() } else { None };
        items.push_back(item);
        drop(items);
        if displaced.is_some() {
            shared.dropped.fetch_add(1, Ordering::Relaxed);
            if shared.capacity > 1 {
                // Room for one is for the newest only, which is no loss.
                metrics::counter!("repose_messages_dropped_total").increment(1);
            }
        }
        shared.arrived.notify_one();
    }

    /// Puts an item in unless there is no room; never waits.
    ///
    /// # Errors
    /// The item itself when the mailbox is full.
    pub fn try_push(&self, item: T) -> Result<(), T> {
        let shared = &self.owner.0;
        let mut items = shared.items();
        if items.len() == shared.capacity {
            shared.dropped.fetch_add(1, Ordering::Relaxed);
            return Err(item);
        }
        items.push_back(item);
        drop(items);
        shared.arrived.notify_one();
        Ok(())
    }
}

/// The side that takes out.
pub struct MailboxReceiver<T> {
    shared: Arc<Shared<T>>,
}

impl<T> MailboxReceiver<T> {
    /// The next item, or none when every sender is gone and nothing is left. Cancel safe.
    pub async fn recv(&mut self) -> Option<T> {
        loop {
            let arrived = self.shared.arrived.notified();
            // Read before the items: what was put in before the close must still come out.
            let closed = self.shared.closed.load(Ordering::Acquire);
            if let Some(item) = self.shared.items().pop_front() {
                return Some(item);
            }
            if closed {
                return None;
            }
            arrived.await;
        }
    }

    /// The next item if one is there.
    pub fn try_recv(&mut self) -> Option<T> {
        self.shared.items().pop_front()
    }

    /// How many items were dropped because there was no room.
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_full_mailbox_drops_the_oldest_and_counts_it() {
        let (sender, mut receiver) = mailbox(2);
        for i in 0..5 {
            sender.push(i);
        }
        assert_eq!(receiver.dropped(), 3);
        drop(sender);
        assert_eq!((receiver.recv().await, receiver.recv().await, receiver.recv().await), (Some(3), Some(4), None));
    }

    #[tokio::test]
    async fn a_full_mailbox_can_refuse_instead() {
        let (sender, mut receiver) = mailbox(1);
        assert_eq!((sender.try_push(1), sender.try_push(2)), (Ok(()), Err(2)));
        assert_eq!(receiver.try_recv(), Some(1));
    }

    #[tokio::test]
    async fn a_waiting_receiver_wakes_for_an_item_and_for_the_end() {
        let (sender, mut receiver) = mailbox(4);
        let waiting = tokio::spawn(async move { (receiver.recv().await, receiver.recv().await) });
        tokio::task::yield_now().await;
        sender.push(7);
        tokio::task::yield_now().await;
        drop(sender);
        assert_eq!(waiting.await.unwrap(), (Some(7), None));
    }
}
