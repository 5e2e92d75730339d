//! What is put in a cell, and the workers' copies of calls: as a recording hears it.

use repose_runtime::{RuntimeError, Sample, Session, Subscription};

use crate::lost::LostMessages;

/// Messages of each kind that may wait to be taken.
const WAITING: usize = 4096;
/// Pictures that may: they are large.
const PICTURES: usize = 16;

/// What is put in a cell.
pub struct Heard {
    frames: Subscription,
    scenes: Subscription,
    states: Subscription,
    stops: Subscription,
    journals: Subscription,
}

/// A message by what it is.
pub enum Message {
    /// A camera's picture.
    Frame(Sample),
    /// A scene, in short.
    Scene(Sample),
    /// What is recorded as it comes, and what it counts as.
    Other(&'static str, Sample),
    /// A copy of a call or an answer.
    Journal(Sample),
}

impl Heard {
    /// Subscribes to all of it.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn of(session: &Session) -> Result<Self, RuntimeError> {
        let (cell, subscribe) = (session.cell(), async |key: String, room: usize| session.subscribe_queue(&key, room).await);
        Ok(Self {
            frames: subscribe(cell.camera_frames(), PICTURES).await?,
            scenes: subscribe(cell.scenes(), WAITING).await?,
            states: subscribe(cell.robot_states(), WAITING).await?,
            stops: subscribe(cell.robot_estops(), WAITING).await?,
            journals: subscribe(cell.journals(), WAITING).await?,
        })
    }

    /// The next message, or none when the session has closed. Cancel safe.
    pub async fn next(&mut self) -> Option<Message> {
        tokio::select! {
            frame = self.frames.recv() => frame.map(Message::Frame),
            scene = self.scenes.recv() => scene.map(Message::Scene),
            state = self.states.recv() => state.map(|state| Message::Other("states", state)),
            stop = self.stops.recv() => stop.map(|stop| Message::Other("stops", stop)),
            journal = self.journals.recv() => journal.map(Message::Journal),
        }
    }

    /// Counts what came faster than it was taken; of copies of calls those that are not among the `missing`, which are counted already by the number of
    /// one that came later.
    pub fn count_dropped(&self, lost: &LostMessages, missing: u64) {
        let Self { frames, scenes, states, stops, journals } = self;
        for (kind, heard) in [("frames", frames), ("summaries", scenes), ("states", states), ("stops", stops)] {
            lost.add(kind, heard.dropped());
        }
        lost.add("calls", journals.dropped().saturating_sub(missing));
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use repose_proto::{Payload, Service};
    use repose_runtime::Traffic;

    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn copies_that_came_too_fast_are_counted_unless_the_number_of_a_later_one_has_shown_them() {
        let session = Session::embedded().await.expect("a session");
        let key = session.cell().journal(Service::Planner, "w");
        let payload = Payload { encoding: String::new(), bytes: Vec::new().into() };
        let journals = session.subscribe_queue(&key, 1).await.expect("a subscription");
        let heard = Heard { journals, ..Heard::of(&session).await.expect("subscriptions") };
        for _ in 0..6 {
            session.put(&key, payload.clone(), Traffic::Journal).await.expect("put");
        }
        while heard.journals.dropped() < 5 {
            tokio::task::yield_now().await;
        }
        for (missing, counts) in [(0, BTreeMap::from([("calls", 5)])), (3, BTreeMap::from([("calls", 2)])), (9, BTreeMap::new())] {
            let lost = LostMessages::default();
            heard.count_dropped(&lost, missing);
            assert_eq!(lost.by_kind(), counts, "{missing} are missing by the numbers");
        }
    }
}
