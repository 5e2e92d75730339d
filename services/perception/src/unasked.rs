//! Scenes of streams that nobody has asked for: they go sooner than others.
//!
//! A camera makes a scene of some megabytes several times a second, and hardly any is ever asked for. Those that were stay as long as there is
//! room; of the others a few seconds are enough for whoever has just read an id.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Ids of scenes that came from cameras and were not asked for, the oldest first.
#[derive(Debug)]
pub struct Unasked {
    kept: Duration,
    most: usize,
    scenes: VecDeque<(Instant, String)>,
}

impl Unasked {
    /// None yet; each is to go once it is older than `kept` and a newer one has come, or once there are more than `most`.
    pub fn new(kept: Duration, most: usize) -> Self {
        Self { kept, most: most.max(1), scenes: VecDeque::new() }
    }

    /// A camera's scene came. `was_held`: the same content had come before; then it stays asked for if it was. Returns the scenes whose time is over.
    pub fn came(&mut self, scene_id: &str, was_held: bool, now: Instant) -> Vec<String> {
        if self.asked(scene_id) || !was_held {
            self.scenes.push_back((now, scene_id.to_owned()));
        }
        let late = self.scenes.iter().take_while(|(came, id)| now.duration_since(*came) > self.kept && id != scene_id).count();
        let over = late.max(self.scenes.len().saturating_sub(self.most));
        self.scenes.drain(..over).map(|(_, id)| id).collect()
    }

    /// Somebody asked for a scene. Returns whether nobody had before.
    pub fn asked(&mut self, scene_id: &str) -> bool {
        let at = self.scenes.iter().position(|(_, id)| id == scene_id);
        at.and_then(|at| self.scenes.remove(at)).is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_that_nobody_asked_for_go_when_their_time_is_over_and_others_stay() {
        let mut unasked = Unasked::new(Duration::from_secs(3), 3);
        let start = Instant::now();
        let at = |s: u64| start + Duration::from_secs(s);
        assert!(unasked.came("a", false, at(0)).is_empty());
        assert!(unasked.came("b", false, at(1)).is_empty());
        assert!(unasked.asked("a") && !unasked.asked("a"));
        assert_eq!(unasked.came("c", false, at(4)), [""; 0], "b is three seconds old and no more");
        assert_eq!(unasked.came("d", false, at(9)), ["b", "c"]);
        let gone: Vec<String> = ["e", "f", "g"].iter().flat_map(|id| unasked.came(id, false, at(9))).collect();
        assert_eq!(gone, ["d"], "more than there is room for");
    }

    #[test]
    fn the_same_content_again_begins_anew_and_stays_asked_for() {
        let mut unasked = Unasked::new(Duration::from_secs(3), 3);
        let start = Instant::now();
        let at = |s: u64| start + Duration::from_secs(s);
        unasked.came("still", false, at(0));
        assert!(unasked.came("still", true, at(5)).is_empty(), "a scene in which nothing changes is as new as its last frame");
        assert!(unasked.asked("still"));
        unasked.came("still", true, at(6));
        assert!(unasked.came("other", false, at(20)).is_empty());
    }
}
