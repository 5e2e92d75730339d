//! Scenes of streams that nobody has asked for: they go sooner than others.
//!
//! A camera makes a scene of some megabytes several times a second, and hardly any is ever asked for. Those that were stay as long as there is
//! room; of the others a few seconds are enough for whoever has just read an id. A camera's newest scene stays: some cameras show a picture now and
//! then, and `latest` tells of it for as long as there is no other.

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
    /// None yet; each is to go once it is older than `kept` and its camera has a newer one, or once there are more than `most`.
    pub fn new(kept: Duration, most: usize) -> Self {
        Self { kept, most: most.max(1), scenes: VecDeque::new() }
    }

    /// A camera's scene came. `was_held`: the same content had come before; then it stays asked for if it was. `is_newest` says which scenes are the
    /// newest of a camera. Returns the scenes whose time is over.
    pub fn came(&mut self, scene_id: &str, was_held: bool, is_newest: impl Fn(&str) -> bool, now: Instant) -> Vec<String> {
        if self.asked(scene_id) || !was_held {
            self.scenes.push_back((now, scene_id.to_owned()));
        }
        let kept = self.kept;
        let is_over = |(came, id): &(Instant, String)| now.duration_since(*came) > kept && !is_newest(id);
        let (over, stay): (VecDeque<_>, VecDeque<_>) = std::mem::take(&mut self.scenes).into_iter().partition(is_over);
        self.scenes = stay;
        let mut over: Vec<String> = over.into_iter().map(|(_, id)| id).collect();
        while self.scenes.len() > self.most {
            let first = self.scenes.iter().position(|(_, id)| !is_newest(id)).unwrap_or(0);
            over.extend(self.scenes.remove(first).map(|(_, id)| id));
        }
        over
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
        // All of one camera.
        let came = |unasked: &mut Unasked, id: &str, s: u64| unasked.came(id, false, |newest| newest == id, at(s));
        assert!(came(&mut unasked, "a", 0).is_empty());
        assert!(came(&mut unasked, "b", 1).is_empty());
        assert!(unasked.asked("a") && !unasked.asked("a"));
        assert_eq!(came(&mut unasked, "c", 4), [""; 0], "b is three seconds old and no more");
        assert_eq!(came(&mut unasked, "d", 9), ["b", "c"]);
        let gone: Vec<String> = ["e", "f", "g"].iter().flat_map(|id| came(&mut unasked, id, 9)).collect();
        assert_eq!(gone, ["d"], "more than there is room for");
    }

    #[test]
    fn a_cameras_newest_scene_stays_while_another_camera_streams() {
        let mut unasked = Unasked::new(Duration::from_secs(3), 3);
        let start = Instant::now();
        unasked.came("picture", false, |id| id == "picture", start);
        for tenth in 1..200 {
            let scene = format!("stream {tenth}");
            let now = start + Duration::from_millis(100 * tenth);
            let gone = unasked.came(&scene, false, |id| id == "picture" || id == scene, now);
            assert!(gone.iter().all(|id| id != "picture"), "{tenth}: {gone:?}");
            assert!(unasked.scenes.len() <= 3);
        }
        let later = start + Duration::from_secs(60);
        assert!(unasked.came("next picture", false, |id| id == "next picture", later).contains(&"picture".to_owned()));
    }

    #[test]
    fn the_same_content_again_begins_anew_and_stays_asked_for() {
        let mut unasked = Unasked::new(Duration::from_secs(3), 3);
        let start = Instant::now();
        let at = |s: u64| start + Duration::from_secs(s);
        unasked.came("still", false, |id| id == "still", at(0));
        let again = unasked.came("still", true, |id| id == "still", at(5));
        assert!(again.is_empty(), "a scene in which nothing changes is as new as its last frame");
        assert!(unasked.asked("still"));
        unasked.came("still", true, |id| id == "still", at(6));
        assert!(unasked.came("other", false, |id| id == "other", at(20)).is_empty());
    }
}
