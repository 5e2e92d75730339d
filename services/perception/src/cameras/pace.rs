//! How often each camera's newest frame becomes a scene: every time while somebody asks for its scenes, seldom while nobody does.
//!
//! A scene costs milliseconds of a core and megabytes, and a cell stands idle for most of its day. Who asks for a camera's newest scene after a
//! pause waits until the newest frame has become one, so that what is asked for is never older than it would have been.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// When frames are due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PaceSettings {
    /// Least time from one scene of a camera to its next while nobody asks; zero takes every frame.
    pub idle_period: Duration,
    /// How long a camera's scenes count as asked for.
    pub asked_for: Duration,
    /// Most cameras that are known; the one that nobody heard or asked of for the longest goes.
    pub cameras: usize,
}

/// What is known of one camera.
#[derive(Debug, Clone, Copy)]
struct Paced {
    touched: Instant,
    taken: Option<Instant>,
    asked: Option<Instant>,
    /// Number of the newest frame that came, and of the newest that is done, whatever became of it.
    came: u64,
    done: u64,
}

/// The pace of each camera.
#[derive(Debug)]
pub struct Pace {
    settings: PaceSettings,
    of_cameras: BTreeMap<String, Paced>,
}

impl Pace {
    /// No camera is known yet.
    pub fn new(settings: PaceSettings) -> Self {
        Self { settings, of_cameras: BTreeMap::new() }
    }

    /// A frame came. Returns its number among its camera's.
    pub fn came(&mut self, camera: &str, now: Instant) -> u64 {
        let known = self.camera(camera, now);
        known.came += 1;
        known.came
    }

    /// A frame is taken to be made a scene.
    pub fn taken(&mut self, camera: &str, now: Instant) {
        self.camera(camera, now).taken = Some(now);
    }

    /// What was to become of a frame has become of it.
    pub fn done(&mut self, camera: &str, number: u64) {
        if let Some(known) = self.of_cameras.get_mut(camera) {
            known.done = known.done.max(number);
        }
    }

    /// Somebody asks for a scene of a camera. Where nobody had for a while, and a frame waits or is being made a scene: its number, which
    /// [`Pace::is_done`] tells of.
    pub fn asked(&mut self, camera: &str, now: Instant) -> Option<u64> {
        let was_idle = self.is_idle(camera, now);
        let known = self.camera(camera, now);
        known.asked = Some(now);
        (was_idle && known.done < known.came).then_some(known.came)
    }

    /// Whether a frame of a number, or a later one, is done. A camera that is not known any more has nothing to wait for.
    pub fn is_done(&self, camera: &str, number: u64) -> bool {
        self.of_cameras.get(camera).is_none_or(|known| known.done >= number)
    }

    /// Whether nobody asks for a camera's scenes.
    pub fn is_idle(&self, camera: &str, now: Instant) -> bool {
        let asked = self.of_cameras.get(camera).and_then(|known| known.asked);
        asked.is_none_or(|asked| now.duration_since(asked) >= self.settings.asked_for)
    }

    /// When a camera's next frame may be taken.
    pub fn due(&self, camera: &str, now: Instant) -> Instant {
        let taken = self.of_cameras.get(camera).and_then(|known| known.taken);
        match taken {
            Some(taken) if self.is_idle(camera, now) => taken + self.settings.idle_period,
            _ => now,
        }
    }

    fn camera(&mut self, camera: &str, now: Instant) -> &mut Paced {
        if !self.of_cameras.contains_key(camera) && self.of_cameras.len() >= self.settings.cameras.max(1) {
            let silent = self.of_cameras.iter().min_by_key(|(_, known)| known.touched).map(|(name, _)| name.clone());
            silent.and_then(|name| self.of_cameras.remove(&name));
        }
        let known = self.of_cameras.entry(camera.to_owned()).or_insert(Paced { touched: now, taken: None, asked: None, came: 0, done: 0 });
        known.touched = now;
        known
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pace() -> (Pace, impl Fn(u64) -> Instant) {
        let start = Instant::now();
        let settings = PaceSettings { idle_period: Duration::from_secs(1), asked_for: Duration::from_secs(10), cameras: 2 };
        (Pace::new(settings), move |ms| start + Duration::from_millis(ms))
    }

    #[test]
    fn frames_that_nobody_asks_for_are_taken_seldom_and_the_first_at_once() {
        let (mut pace, at) = pace();
        assert_eq!(pace.due("front", at(0)), at(0));
        pace.came("front", at(0));
        pace.taken("front", at(0));
        assert_eq!(pace.due("front", at(200)), at(1000));
        pace.asked("front", at(300));
        assert_eq!(pace.due("front", at(400)), at(400));
        pace.taken("front", at(10_299));
        assert_eq!(pace.due("front", at(10_300)), at(11_299), "ten seconds after it was asked for");
    }

    #[test]
    fn who_asks_after_a_pause_waits_for_the_newest_frame_and_others_do_not() {
        let (mut pace, at) = pace();
        assert_eq!(pace.asked("front", at(0)), None, "no frame has come");
        let (mut pace, at) = (Pace { of_cameras: BTreeMap::new(), ..pace }, at);
        let first = pace.came("front", at(0));
        assert_eq!(pace.asked("front", at(1)), Some(first));
        pace.done("front", first);
        assert!(pace.is_done("front", first));
        let second = pace.came("front", at(2));
        assert_eq!(pace.asked("front", at(3)), None, "asked for a moment ago: the newest scene is good enough");
        assert!(!pace.is_done("front", second));
        pace.done("front", second);
        assert_eq!(pace.asked("front", at(60_000)), None, "every frame is a scene already");
    }

    #[test]
    fn the_number_of_cameras_is_bounded() {
        let (mut pace, at) = pace();
        for (k, camera) in ["a", "b", "a", "c"].into_iter().enumerate() {
            pace.came(camera, at(k as u64));
        }
        assert_eq!(pace.came("a", at(5)), 3);
        assert!(pace.is_done("b", 1), "forgotten");
    }
}
