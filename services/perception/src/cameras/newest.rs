//! The newest frame of each camera, until somebody takes it.
//!
//! A slow computation must neither queue up old frames nor let a fast camera starve a slow one: a newer frame replaces the camera's
//! waiting one, and cameras are taken in turn. A camera's next frame is taken once its last one is done, so that what comes of them keeps
//! their order.

use std::collections::{BTreeMap, BTreeSet};

/// One waiting item per camera, at most `max_cameras` of them.
#[derive(Debug)]
pub struct NewestFrames<T> {
    waiting: BTreeMap<String, T>,
    /// Cameras whose last frame is not done.
    busy: BTreeSet<String>,
    max_cameras: usize,
    /// The camera taken last; its successor in name order is next.
    last: Option<String>,
}

/// What became of a frame that came in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Placed {
    /// It waits alone.
    Waiting,
    /// It waits in place of an older one.
    Replaced,
    /// It was refused: too many cameras have frames waiting.
    Refused,
}

impl<T> NewestFrames<T> {
    /// Nothing waits.
    pub fn new(max_cameras: usize) -> Self {
        Self { waiting: BTreeMap::new(), busy: BTreeSet::new(), max_cameras, last: None }
    }

    /// A frame came in.
    pub fn put(&mut self, camera: &str, frame: T) -> Placed {
        if let Some(waiting) = self.waiting.get_mut(camera) {
            *waiting = frame;
            return Placed::Replaced;
        }
        if self.waiting.len() >= self.max_cameras {
            return Placed::Refused;
        }
        self.waiting.insert(camera.to_owned(), frame);
        Placed::Waiting
    }

    /// The next frame of a camera whose turn may come; [`NewestFrames::done`] must be told when it is done.
    pub fn take(&mut self, is_due: impl Fn(&str) -> bool) -> Option<(String, T)> {
        use std::ops::Bound::{Excluded, Unbounded};
        let free = |(camera, _): &(&String, &T)| !self.busy.contains(*camera) && is_due(camera);
        let after = self.last.as_ref().and_then(|last| self.waiting.range::<String, _>((Excluded(last), Unbounded)).find(free));
        let camera = after.or_else(|| self.waiting.iter().find(free)).map(|(camera, _)| camera.clone())?;
        let taken = self.waiting.remove_entry(&camera);
        self.busy.insert(camera.clone());
        self.last = Some(camera);
        taken
    }

    /// The cameras with a frame that waits for nothing but its time.
    pub fn waiting(&self) -> impl Iterator<Item = &str> {
        self.waiting.keys().map(String::as_str).filter(|camera| !self.busy.contains(*camera))
    }

    /// A camera's frame is done: its next one may be taken.
    pub fn done(&mut self, camera: &str) {
        self.busy.remove(camera);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_newer_frame_replaces_the_waiting_one() {
        let mut frames = NewestFrames::new(4);
        assert_eq!((frames.put("a", 1), frames.put("a", 2)), (Placed::Waiting, Placed::Replaced));
        assert_eq!((frames.take(|_| true), frames.take(|_| true)), (Some(("a".to_owned(), 2)), None));
    }

    #[test]
    fn cameras_take_turns_however_fast_one_is() {
        let mut frames = NewestFrames::new(4);
        let mut taken = Vec::new();
        for i in 0..6 {
            frames.put("fast", i);
            if i < 2 {
                frames.put("slow", i);
                frames.put("other", i);
            }
            let (camera, _) = frames.take(|_| true).unwrap();
            frames.done(&camera);
            taken.push(camera);
        }
        assert_eq!(taken[..4], ["fast", "other", "slow", "fast"]);
    }

    #[test]
    fn a_cameras_next_frame_waits_for_its_last_one() {
        let mut frames = NewestFrames::new(4);
        frames.put("a", 1);
        assert_eq!(frames.take(|_| true), Some(("a".to_owned(), 1)));
        frames.put("a", 2);
        assert_eq!(frames.take(|_| true), None);
        frames.put("b", 3);
        assert_eq!(frames.take(|_| true), Some(("b".to_owned(), 3)));
        frames.done("a");
        assert_eq!(frames.take(|_| true), Some(("a".to_owned(), 2)));
    }

    #[test]
    fn the_number_of_cameras_is_bounded() {
        let mut frames = NewestFrames::new(1);
        frames.put("a", 1);
        assert_eq!(frames.put("b", 2), Placed::Refused);
        frames.take(|_| true);
        assert_eq!(frames.put("b", 2), Placed::Waiting);
    }

    #[test]
    fn a_camera_whose_time_has_not_come_lets_others_go_first() {
        let mut frames = NewestFrames::new(4);
        frames.put("idle", 1);
        frames.put("asked", 2);
        assert_eq!(frames.take(|camera| camera != "idle"), Some(("asked".to_owned(), 2)));
        assert_eq!((frames.take(|camera| camera != "idle"), frames.waiting().collect::<Vec<_>>()), (None, vec!["idle"]));
    }
}
