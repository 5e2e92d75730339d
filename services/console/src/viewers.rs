//! What waits for each viewer: one place per topic, where the newest message takes the place of an older one.
//!
//! So a viewer that reads slowly gets fewer and newer messages, never a growing queue, and whoever sends never waits. Answers to a viewer's
//! own requests have a topic each; a viewer that leaves too many of them unread is let go. To a viewer that keeps a [`Pace`], large messages go
//! in [`Parts`], and others go between them.

mod message;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use tokio::sync::Notify;
use tokio::time::Instant;

use crate::pace::Pace;
use crate::parts::Parts;

pub use message::{Outgoing, Topic, ViewerMessage};

/// Topics that may wait for one viewer: all there are, robots and open requests included, with room to spare.
const MAX_WAITING: usize = 96;

#[derive(Default)]
struct Waiting {
    /// In the order in which the topics' oldest unread messages came.
    order: VecDeque<Topic>,
    newest: BTreeMap<Topic, ViewerMessage>,
    /// Of which nothing more is sent for now: a message of theirs was begun, or was not yet said to be seen.
    on_its_way: BTreeSet<Topic>,
    /// Messages of which parts were sent, and not all of them; they take turns.
    begun: VecDeque<(Topic, Parts)>,
    /// Whether it is their turn before what waits.
    is_turn_of_begun: bool,
    /// That of a viewer that says what has come.
    pace: Option<Pace>,
    is_closed: bool,
}

impl Waiting {
    /// What goes next. What waits and what was begun take turns: neither a scene keeps robots back, nor they a scene.
    fn take(&mut self) -> Option<Outgoing> {
        if self.pace.as_ref().is_some_and(|pace| !pace.has_room()) {
            return None;
        }
        let waits = self.order.iter().position(|topic| !self.on_its_way.contains(topic));
        match waits {
            Some(at) if !self.is_turn_of_begun || self.begun.is_empty() => {
                self.is_turn_of_begun = true;
                self.begin(at)
            }
            _ => {
                self.is_turn_of_begun = false;
                self.next_part().map(|bytes| Outgoing::Part { bytes, begins: None })
            }
        }
    }

    /// The message, or the first part of it, of the topic at a place of the order.
    fn begin(&mut self, at: usize) -> Option<Outgoing> {
        let topic = self.order.remove(at)?;
        let message = self.newest.remove(&topic)?;
        if topic.waits_for_viewer() {
            self.on_its_way.insert(topic.clone());
        }
        let Some(pace) = &mut self.pace else { return Some(Outgoing::Whole(message)) };
        if message.length() <= pace.part_bytes() {
            pace.sends(message.length());
            return Some(Outgoing::Whole(message));
        }
        self.on_its_way.insert(topic.clone());
        let parts = Parts::new(topic.name(), message.form(), message.bytes());
        self.begun.push_front((topic, parts));
        let begins = if let ViewerMessage::View(view) = message { Some(view) } else { None };
        self.next_part().map(|bytes| Outgoing::Part { bytes, begins })
    }

    /// The next part of the message whose turn it is of those that were begun.
    fn next_part(&mut self) -> Option<Bytes> {
        let pace = self.pace.as_mut()?;
        let (topic, mut parts) = self.begun.pop_front()?;
        let part = parts.next(pace.part_bytes());
        pace.sends(part.len());
        if !parts.are_sent() {
            self.begun.push_back((topic, parts));
        } else if !topic.waits_for_viewer() {
            self.on_its_way.remove(&topic);
        }
        Some(part)
    }

    /// Drops all that is not sent yet of some topics.
    fn forget(&mut self, is_out_of_date: impl Fn(&Topic) -> bool) {
        let Self { order, newest, on_its_way, begun, .. } = self;
        order.retain(|topic| !is_out_of_date(topic));
        newest.retain(|topic, _| !is_out_of_date(topic));
        begun.retain(|(topic, _)| {
            let stays = !is_out_of_date(topic);
            if !stays {
                // It never comes to its end, and is never said to be seen.
                on_its_way.remove(topic);
            }
            stays
        });
    }
}

/// The messages that wait for one viewer.
#[derive(Default)]
pub struct Outbox {
    waiting: Mutex<Waiting>,
    replaced: AtomicU64,
    changed: Notify,
}

impl Outbox {
    /// That of a viewer that says of everything that it has come: see [`Outbox::received`].
    pub fn paced() -> Self {
        let waiting = Waiting { pace: Some(Pace::default()), ..Waiting::default() };
        Self { waiting: Mutex::new(waiting), ..Self::default() }
    }

    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Leaves a message; an unread one of the same topic is dropped for it, and keeps its turn.
    pub fn put(&self, topic: Topic, message: ViewerMessage) {
        let mut waiting = self.waiting();
        if waiting.is_closed {
            return;
        }
        if waiting.newest.insert(topic.clone(), message).is_some() {
            self.replaced.fetch_add(1, Ordering::Relaxed);
        } else if waiting.order.len() + waiting.begun.len() < MAX_WAITING {
            waiting.order.push_back(topic);
        } else {
            *waiting = Waiting { is_closed: true, ..Waiting::default() };
        }
        drop(waiting);
        self.changed.notify_one();
    }

    /// The next message, or part of one; none once closed. For one reader at a time. Cancel safe.
    pub async fn next(&self) -> Option<Outgoing> {
        loop {
            {
                let mut waiting = self.waiting();
                if waiting.is_closed {
                    return None;
                }
                if let Some(message) = waiting.take() {
                    return Some(message);
                }
            }
            self.changed.notified().await;
        }
    }

    /// Drops what waits of some topics, and what is left to be sent of messages that were begun.
    pub fn forget(&self, is_out_of_date: impl Fn(&Topic) -> bool) {
        self.waiting().forget(is_out_of_date);
    }

    /// The message or part that was sent first, of those of which this was not yet said, has come to the viewer.
    pub fn received(&self) {
        if let Some(pace) = &mut self.waiting().pace {
            pace.has_come();
        }
        self.changed.notify_one();
    }

    /// The viewer has seen the last message of a topic.
    pub fn seen(&self, topic: &Topic) {
        self.waiting().on_its_way.remove(topic);
        self.changed.notify_one();
    }

    /// Lets the reader go; what waits is dropped.
    pub fn close(&self) {
        *self.waiting() = Waiting { is_closed: true, ..Waiting::default() };
        self.changed.notify_one();
    }

    /// What waits of some topics, in its order and whatever the pace, for a reader that is let go with it; the rest is dropped.
    pub fn last_words(&self, are_of: impl Fn(&Topic) -> bool) -> Vec<ViewerMessage> {
        let closed = Waiting { is_closed: true, ..Waiting::default() };
        let Waiting { order, mut newest, .. } = std::mem::replace(&mut *self.waiting(), closed);
        order.iter().filter(|topic| are_of(topic)).filter_map(|topic| newest.remove(topic)).collect()
    }

    /// How many messages were dropped for newer ones.
    pub fn replaced(&self) -> u64 {
        self.replaced.load(Ordering::Relaxed)
    }
}

/// Viewers who are told the same, and what they were told last, for those who come later.
#[derive(Default)]
pub struct Audience {
    inner: Mutex<AudienceState>,
}

#[derive(Default)]
struct AudienceState {
    viewers: BTreeMap<u64, Arc<Outbox>>,
    newest: BTreeMap<Topic, (Instant, ViewerMessage)>,
}

impl Audience {
    fn told(&self) -> MutexGuard<'_, AudienceState> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells everyone.
    pub fn tell(&self, topic: &Topic, message: &ViewerMessage) {
        let mut told = self.told();
        told.viewers.values().for_each(|outbox| outbox.put(topic.clone(), message.clone()));
        told.newest.insert(topic.clone(), (Instant::now(), message.clone()));
    }

    /// Adds a viewer, who is told the newest of everything; what passes for live with its age.
    pub fn join(&self, viewer: u64, outbox: Arc<Outbox>) {
        let mut told = self.told();
        for (topic, (at, message)) in &told.newest {
            outbox.put(topic.clone(), if topic.is_live() { message.told_late(at.elapsed()) } else { message.clone() });
        }
        told.viewers.insert(viewer, outbox);
    }

    /// Forgets what was told last of some topics: those who come later are not told of them.
    pub fn forget(&self, is_out_of_date: impl Fn(&Topic) -> bool) {
        self.told().newest.retain(|topic, _| !is_out_of_date(topic));
    }

    /// Takes a viewer out.
    pub fn leave(&self, viewer: u64) {
        self.told().viewers.remove(&viewer);
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use repose_proto::{Bulk, Payload};

    use super::*;
    use crate::view::{CameraPicture, picture_bytes};

    fn text(text: &str) -> ViewerMessage {
        ViewerMessage::Text(text.into())
    }

    async fn next(outbox: &Outbox) -> Option<String> {
        outbox.next().await.map(|message| match message {
            Outgoing::Whole(ViewerMessage::Text(text)) => text.to_string(),
            _ => panic!("expected text"),
        })
    }

    #[tokio::test]
    async fn a_newer_message_takes_the_place_of_an_unread_one_of_its_topic_and_keeps_its_turn() {
        let outbox = Outbox::default();
        outbox.put(Topic::Picture, text("picture 1"));
        outbox.put(Topic::System, text("system 1"));
        for k in 2..=1000 {
            outbox.put(Topic::Picture, text(&format!("picture {k}")));
        }
        assert_eq!(next(&outbox).await.as_deref(), Some("picture 1000"));
        assert_eq!(next(&outbox).await.as_deref(), Some("system 1"));
        assert_eq!(outbox.replaced(), 999);
    }

    #[tokio::test]
    async fn large_messages_wait_until_the_last_one_was_seen_and_nothing_else_waits_for_them() {
        let outbox = Outbox::default();
        outbox.put(Topic::Scene, text("scene 1"));
        assert_eq!(next(&outbox).await.as_deref(), Some("scene 1"));
        outbox.put(Topic::Scene, text("scene 2"));
        outbox.put(Topic::System, text("system"));
        outbox.put(Topic::Scene, text("scene 3"));
        assert_eq!(next(&outbox).await.as_deref(), Some("system"));
        outbox.seen(&Topic::Scene);
        assert_eq!(next(&outbox).await.as_deref(), Some("scene 3"));
    }

    #[tokio::test]
    async fn what_waits_of_a_cell_is_forgotten_with_it_and_answers_are_not() {
        let outbox = Outbox::default();
        outbox.put(Topic::Robot("panda".into()), text("the old cell's robot"));
        outbox.put(Topic::Answer(1), text("answer"));
        outbox.put(Topic::Scene, text("the old cell's scene"));
        outbox.forget(Topic::is_of_cell);
        outbox.put(Topic::Watching, text("watching"));
        outbox.put(Topic::Scene, text("the new cell's scene"));
        for expected in ["answer", "watching", "the new cell's scene"] {
            assert_eq!(next(&outbox).await.as_deref(), Some(expected));
        }
    }

    #[tokio::test]
    async fn every_answer_arrives_in_its_turn() {
        let outbox = Outbox::default();
        for id in 0..5 {
            outbox.put(Topic::Answer(id), text(&id.to_string()));
            outbox.put(Topic::System, text("system"));
        }
        let mut answers = Vec::new();
        for _ in 0..6 {
            answers.extend(next(&outbox).await);
        }
        answers.retain(|m| m != "system");
        assert_eq!(answers, ["0", "1", "2", "3", "4"]);
    }

    #[tokio::test]
    async fn a_viewer_that_reads_nothing_is_let_go_and_holds_nothing() {
        let outbox = Outbox::default();
        for id in 0..=MAX_WAITING as u64 {
            outbox.put(Topic::Answer(id), text("answer"));
        }
        assert_eq!(next(&outbox).await, None);
        outbox.put(Topic::Picture, text("picture"));
        assert!(outbox.waiting().newest.is_empty());
    }

    #[tokio::test]
    async fn the_last_words_wait_for_no_pace_and_nothing_comes_after_them() {
        let outbox = Outbox::paced();
        outbox.put(Topic::System, text(&" ".repeat(1 << 20)));
        while outbox.waiting().take().is_some() {}
        outbox.put(Topic::Robot("panda".into()), text("state"));
        outbox.put(Topic::Activity, text("ended"));
        outbox.put(Topic::Answer(1), text("answer"));
        let last = outbox.last_words(|topic| !matches!(topic, Topic::Robot(_)));
        let said = |message: &ViewerMessage| String::from_utf8_lossy(&message.bytes()).into_owned();
        assert_eq!(last.iter().map(said).collect::<Vec<_>>(), ["ended", "answer"]);
        outbox.put(Topic::Activity, text("later"));
        assert_eq!(next(&outbox).await, None);
    }

    #[tokio::test]
    async fn a_reader_that_waits_is_woken() {
        let outbox = Arc::new(Outbox::default());
        let reading = tokio::spawn({
            let outbox = outbox.clone();
            async move { (next(&outbox).await, next(&outbox).await) }
        });
        tokio::task::yield_now().await;
        outbox.put(Topic::Cells, text("cells"));
        tokio::task::yield_now().await;
        outbox.close();
        assert_eq!(reading.await.expect("joined"), (Some("cells".to_owned()), None));
    }

    #[tokio::test]
    async fn whoever_joins_late_is_told_the_newest_and_whoever_left_nothing() {
        let (audience, early, late) = (Audience::default(), Arc::new(Outbox::default()), Arc::new(Outbox::default()));
        audience.join(1, early.clone());
        audience.tell(&Topic::Scene, &text("scene 1"));
        audience.tell(&Topic::Scene, &text("scene 2"));
        audience.join(2, late.clone());
        audience.leave(1);
        audience.tell(&Topic::Robot("panda".into()), &text("state"));
        assert_eq!(next(&late).await.as_deref(), Some("scene 2"));
        assert_eq!(next(&late).await.as_deref(), Some("state"));
        assert_eq!(next(&early).await.as_deref(), Some("scene 2"));
        early.close();
        assert_eq!(next(&early).await, None);
    }

    #[tokio::test(start_paused = true)]
    async fn whoever_joins_long_after_the_last_picture_and_state_is_told_how_old_they_are() {
        let (audience, early, late) = (Audience::default(), Arc::new(Outbox::default()), Arc::new(Outbox::default()));
        let frame = Payload { encoding: String::new(), bytes: Bytes::new() };
        let picture = picture_bytes("front", &CameraPicture { stamp_ns: 7, jpeg: vec![1, 2, 3].into(), frame });
        audience.join(1, early.clone());
        audience.tell(&Topic::Picture, &ViewerMessage::Binary(picture));
        audience.tell(&Topic::Robot("panda".into()), &text(r#"{"kind":"robot"}"#));
        tokio::time::advance(Duration::from_secs(3600)).await;
        audience.join(2, late.clone());
        for (outbox, age) in [(early, None), (late, Some("3600000"))] {
            let Some(Outgoing::Whole(ViewerMessage::Binary(bytes))) = outbox.next().await else { panic!("expected a picture") };
            let told = Bulk::decode(&bytes).expect("bulk");
            assert_eq!((told.text("kind"), told.metadata.get("age_ms").map(String::as_str)), (Ok("picture"), age));
            assert_eq!(told.tensors["jpeg"].bytes, [1, 2, 3]);
            let robot: serde_json::Value = serde_json::from_str(&next(&outbox).await.expect("a state")).expect("JSON");
            assert_eq!((&robot["kind"], robot["age_ms"].as_u64()), (&"robot".into(), age.and_then(|age| age.parse::<u64>().ok())));
        }
    }
}
