//! How much may be on its way to a viewer at once, so that whatever is said next comes soon, however slow the link is.
//!
//! What has been handed to a connection cannot be overtaken: on a slow link a scene of a megabyte that was handed over whole keeps a robot's state
//! back for many seconds, and the states themselves grow old behind each other. A viewer that says of every message that it has come is sent as much at
//! once as its link takes within [`SOON`], however long the way is.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::time::Instant;

/// How long a message may wait on the way behind those that were sent before it.
const SOON: Duration = Duration::from_millis(300);
/// Bytes that may be on their way at first.
const FIRST: usize = 32 << 10;
/// Bytes that may, however slow the link is.
const LEAST: usize = 16 << 10;
/// Bytes that may, however fast it is: 20 Mbit/s over 200 ms there and back.
const MOST: usize = 512 << 10;
/// A larger message goes in parts, of which so many are on their way at once.
const PARTS: usize = 4;

/// A message that was sent and has not come yet.
struct OnItsWay {
    sent: Instant,
    bytes: usize,
    /// Bytes on their way when it was sent, its own included.
    with_those_before: usize,
}

/// The pace of a viewer.
pub struct Pace {
    on_its_way: VecDeque<OnItsWay>,
    /// Bytes of those.
    bytes: usize,
    /// Bytes that may be on their way.
    window: usize,
    /// The least time that a message took to come and its word back: that of the way itself.
    quickest: Option<Duration>,
}

impl Default for Pace {
    fn default() -> Self {
        Self { on_its_way: VecDeque::new(), bytes: 0, window: FIRST, quickest: None }
    }
}

impl Pace {
    /// The most bytes of a message that are sent at once.
    pub fn part_bytes(&self) -> usize {
        self.window / PARTS
    }

    /// Whether another message, or part of one, may be sent.
    pub fn has_room(&self) -> bool {
        self.bytes + self.part_bytes() <= self.window
    }

    /// A message of so many bytes is sent.
    pub fn sends(&mut self, bytes: usize) {
        self.bytes += bytes;
        self.on_its_way.push_back(OnItsWay { sent: Instant::now(), bytes, with_those_before: self.bytes });
    }

    /// The message that was sent first of those on their way has come.
    pub fn has_come(&mut self) {
        let Some(OnItsWay { sent, bytes, with_those_before }) = self.on_its_way.pop_front() else { return };
        self.bytes -= bytes;
        let took = sent.elapsed();
        let quickest = self.quickest.map_or(took, |quickest| quickest.min(took));
        self.quickest = Some(quickest);
        let waited = took - quickest;
        self.window = if waited <= SOON {
            // Twice of what came soon is tried, where that much was asked for.
            self.window.max(2 * with_those_before).min(MOST)
        } else {
            let come_soon = with_those_before as f64 * (SOON.as_secs_f64() / waited.as_secs_f64());
            // A viewer may have been held up by something else: one message that is late does not say how fast the link is.
            self.window.min((come_soon as usize).max(self.window / 2)).max(LEAST)
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends as much as may be sent.
    fn fill(pace: &mut Pace) -> usize {
        let mut sent = 0;
        while pace.has_room() {
            let bytes = pace.part_bytes();
            pace.sends(bytes);
            sent += bytes;
        }
        sent
    }

    #[tokio::test(start_paused = true)]
    async fn what_comes_soon_is_doubled_up_to_a_most_however_long_the_way_is() {
        let mut pace = Pace::default();
        let mut sent = Vec::new();
        for _ in 0..8 {
            sent.push(fill(&mut pace));
            tokio::time::advance(Duration::from_millis(700)).await;
            while !pace.on_its_way.is_empty() {
                pace.has_come();
            }
        }
        assert_eq!(sent, [32, 64, 128, 256, 512, 512, 512, 512].map(|kib| kib << 10));
    }

    #[tokio::test(start_paused = true)]
    async fn what_comes_late_is_made_less_down_to_a_least_and_nothing_is_sent_before_it_has_come() {
        let mut pace = Pace::default();
        pace.sends(1);
        pace.has_come();
        for _ in 0..4 {
            fill(&mut pace);
            assert!(!pace.has_room());
            tokio::time::advance(Duration::from_secs(60)).await;
            while !pace.on_its_way.is_empty() {
                pace.has_come();
            }
        }
        assert_eq!(fill(&mut pace), LEAST);
    }

    #[tokio::test(start_paused = true)]
    async fn a_message_that_a_busy_page_has_taken_late_costs_no_more_than_half() {
        let mut pace = Pace::default();
        fill(&mut pace);
        while !pace.on_its_way.is_empty() {
            pace.has_come();
        }
        assert_eq!(pace.window, 2 * FIRST);
        pace.sends(1);
        tokio::time::advance(Duration::from_secs(1)).await;
        pace.has_come();
        assert_eq!(pace.window, FIRST);
    }

    #[test]
    fn a_word_that_nothing_was_sent_for_changes_nothing() {
        let mut pace = Pace::default();
        pace.has_come();
        assert_eq!((pace.bytes, pace.window), (0, FIRST));
    }
}
