//! Scenes of streams that nobody has asked for: they go sooner than others.
//!
//! A camera makes a scene of some megabytes several times a second, and hardly any is ever asked for. Those that were stay as long as there is
//! room; of the others a few seconds are enough for whoever has just read an id. A camera's newest scene stays: some cameras show a picture now and
//! then, and `latest` tells of it for as long as there is no other.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Scenes that came from cameras and were not asked for, the oldest first.
#[derive(Debug)]
pub struct Unasked {
    kept: Duration,
    most: usize,
    scenes: VecDeque<Waiting>,
}

/// A scene that nobody has asked for.
#[derive(Debug)]
struct Waiting {
    id: String,
    /// Whether it was its camera's newest when a scene came last.
    was_newest: bool,
    /// When it came; of one that was its camera's newest, when a newer one came in its place: until then `latest` told of it.
    since: Instant,
}

impl Unasked {
    /// None yet; each is to go once its camera has had a newer one for longer than `kept`, or once there are more than `most`.
    pub fn new(kept: Duration, most: usize) -> Self {
        Self { kept, most: most.max(1), scenes: VecDeque::new() }
    }

    /// A camera's scene came. `was_held`: the same content had come before; then it stays asked for if it was. `is_newest` says which scenes are the
    /// newest of a camera. Returns the scenes whose time is over.
    pub fn came(&mut self, scene_id: &str, was_held: bool, is_newest: impl Fn(&str) -> bool, now: Instant) -> Vec<String> {
        if self.asked(scene_id) || !was_held {
            self.scenes.push_back(Waiting { id: scene_id.to_owned(), was_newest: false, since: now });
        }
        for scene in &mut self.scenes {
            let is_newest = is_newest(&scene.id);
            if scene.was_newest && !is_newest {
                scene.since = now;
            }
            scene.was_newest = is_newest;
        }
        let kept = self.kept;
        let is_over = |scene: &Waiting| !scene.was_newest && now.duration_since(scene.since) > kept;
        let (over, stay): (VecDeque<_>, VecDeque<_>) = std::mem::take(&mut self.scenes).into_iter().partition(is_over);
        self.scenes = stay;
        let mut over: Vec<String> = over.into_iter().map(|scene| scene.id).collect();
        while self.scenes.len() > self.most {
            let first = self.scenes.iter().position(|scene| !scene.was_newest).unwrap_or(0);
            over.extend(self.scenes.remove(first).map(|scene| scene.id));
        }
        over
    }

    /// Somebody asked for a scene. Returns whether nobody had before.
    pub fn asked(&mut self, scene_id: &str) -> bool {
        let at = self.scenes.iter().position(|scene| scene.id == scene_id);
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
        assert_eq!(came(&mut unasked, "c", 4), [""; 0], "b was the newest until now");
        assert_eq!(came(&mut unasked, "d", 7), [""; 0], "there is a newer one than b for three seconds and no more");
        assert_eq!(came(&mut unasked, "e", 12), ["b", "c"]);
        let gone: Vec<String> = ["f", "g"].iter().flat_map(|id| came(&mut unasked, id, 12)).collect();
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
        let is_picture = |gone: &[String]| gone.iter().any(|id| id == "picture");
        let gone = unasked.came("next picture", false, |id| id == "next picture", later);
        assert!(!is_picture(&gone), "who was told of it a moment ago asks for it now: {gone:?}");
        let gone = unasked.came("a third", false, |id| id == "a third", later + Duration::from_secs(4));
        assert!(is_picture(&gone), "{gone:?}");
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
