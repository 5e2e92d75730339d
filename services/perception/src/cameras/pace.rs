//! How often each camera's newest frame becomes a scene: every time while somebody asks for its scenes, seldom while nobody does.
//!
//! A scene costs milliseconds of a core and megabytes, and a cell stands idle for most of its day. Who asks for a camera's newest scene after a
//! pause waits until the newest frame has become one, so that what is asked for is never older than it would have been. Only streams are thinned:
//! a frame that comes after a pause, or that none follows, becomes a scene whether or not anybody asks.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// A camera that shows nothing for so long pauses: streams have several frames a second.
pub const PAUSE: Duration = Duration::from_secs(1);
/// How long before a frame's turn the robots' states are listened to. The frame that is taken comes within that time, except the last of a stream: for
/// that one later states serve, since the robots go on telling where they stand.
const ROBOTS_LEAD: Duration = Duration::from_millis(500);

/// When frames are due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PaceSettings {
    /// Least time from one scene of a stream to its next while nobody asks; zero takes every frame.
    pub idle_period: Duration,
    /// How long a camera's scenes count as asked for.
    pub asked_for: Duration,
    /// Most cameras that are known; the one that nobody heard or asked of for the longest goes, those that never showed anything first.
    pub cameras: usize,
}

/// What is known of one camera.
#[derive(Debug, Clone, Copy)]
struct Paced {
    touched: Instant,
    taken: Option<Instant>,
    asked: Option<Instant>,
    came_at: Option<Instant>,
    /// Whether its newest frame came after a pause.
    resumed: bool,
    /// Frames that came.
    frames: u64,
    /// Number of the newest frame that came, and of the newest that is done, whatever became of it.
    came: u64,
    done: u64,
    /// When its newest scene was made.
    made: Option<Instant>,
    /// From that scene's stamp to when its frame came, by this host's clock, milliseconds.
    lag_ms: f64,
}

/// What a camera has shown.
#[derive(Debug, Clone, Copy)]
pub struct Shown<'a> {
    /// The camera.
    pub camera: &'a str,
    /// Frames that came.
    pub frames: u64,
    /// When the newest did.
    pub came_at: Instant,
    /// When its newest scene was made, and from that scene's stamp to when its frame came, by this host's clock, milliseconds.
    pub scene: Option<(Instant, f64)>,
}

/// The pace of each camera.
#[derive(Debug)]
pub struct Pace {
    settings: PaceSettings,
    of_cameras: BTreeMap<String, Paced>,
    /// Frames of all cameras so far, which are numbered together. If a camera that was forgotten began at 1 again, an earlier frame of it that is done
    /// late would pass for newer than frames that came since.
    frames: u64,
}

impl Pace {
    /// No camera is known yet.
    pub fn new(settings: PaceSettings) -> Self {
        Self { settings, of_cameras: BTreeMap::new(), frames: 0 }
    }

    /// A frame came. Returns its number, which grows with every frame of any camera.
    pub fn came(&mut self, camera: &str, now: Instant) -> u64 {
        self.frames += 1;
        let number = self.frames;
        let known = self.camera(camera, now);
        known.resumed = known.came_at.is_none_or(|before| now.duration_since(before) >= PAUSE);
        known.came_at = Some(now);
        known.frames += 1;
        known.came = number;
        number
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
        self.of_cameras.get(camera).is_none_or(|known| self.settings.is_idle(known, now))
    }

    /// When a camera's newest frame may be taken.
    pub fn due(&self, camera: &str, now: Instant) -> Instant {
        let Some(known) = self.of_cameras.get(camera).filter(|known| self.settings.is_idle(known, now)) else { return now };
        match (known.taken, known.came_at) {
            (Some(taken), Some(came_at)) if !known.resumed => (taken + self.settings.idle_period).min(came_at + PAUSE),
            _ => now,
        }
    }

    /// Whether the robots' states are needed now, for the scenes that are asked for or that soon will be made; and when that changes, if only time
    /// passes.
    pub fn wants_robots(&self, now: Instant) -> (bool, Option<Instant>) {
        let mut next: Option<Instant> = None;
        let mut sooner = |at: Instant| next = Some(next.map_or(at, |next| next.min(at)));
        // Before any frame has come the next one is a first.
        let mut wants = self.of_cameras.is_empty();
        for known in self.of_cameras.values() {
            let from = match known.taken {
                _ if known.came > known.done && known.resumed => now,
                Some(taken) if self.settings.is_idle(known, now) => {
                    let turn = taken + self.settings.idle_period.saturating_sub(ROBOTS_LEAD);
                    // What waits may be the last of a stream, which is due after a pause.
                    let waiting = known.came_at.filter(|came_at| *came_at > taken);
                    waiting.map_or(turn, |came_at| turn.min(came_at + PAUSE.saturating_sub(ROBOTS_LEAD)))
                }
                _ => now,
            };
            // A camera that shows nothing has no turn.
            let shows = known.came_at.is_some_and(|came_at| now.duration_since(came_at) < PAUSE + ROBOTS_LEAD);
            if from <= now && (shows || !self.settings.is_idle(known, now)) {
                wants = true;
                sooner(now + ROBOTS_LEAD);
            } else if from > now {
                sooner(from);
            }
        }
        (wants, next)
    }

    /// A scene was made of a camera's frame, which came so long after its stamp by this host's clock.
    pub fn made(&mut self, camera: &str, now: Instant, lag_ms: f64) {
        if let Some(known) = self.of_cameras.get_mut(camera) {
            (known.made, known.lag_ms) = (Some(now), lag_ms);
        }
    }

    /// What each camera has shown, by name.
    pub fn shown(&self) -> impl Iterator<Item = Shown<'_>> {
        self.of_cameras.iter().filter_map(|(camera, known)| {
            let scene = known.made.map(|made| (made, known.lag_ms));
            Some(Shown { camera, frames: known.frames, came_at: known.came_at?, scene })
        })
    }

    fn camera(&mut self, camera: &str, now: Instant) -> &mut Paced {
        if !self.of_cameras.contains_key(camera) && self.of_cameras.len() >= self.settings.cameras.max(1) {
            // Questions about cameras that never showed anything here make no other camera forgotten.
            let silent =
                self.of_cameras.iter().min_by_key(|(_, known)| (known.came_at.is_some(), known.touched)).map(|(name, _)| name.clone());
            silent.and_then(|name| self.of_cameras.remove(&name));
        }
        let unknown = Paced {
            touched: now,
            taken: None,
            asked: None,
            came_at: None,
            resumed: false,
            frames: 0,
            came: 0,
            done: 0,
            made: None,
            lag_ms: 0.0,
        };
        let known = self.of_cameras.entry(camera.to_owned()).or_insert(unknown);
        known.touched = now;
        known
    }
}

impl PaceSettings {
    fn is_idle(&self, known: &Paced, now: Instant) -> bool {
        known.asked.is_none_or(|asked| now.duration_since(asked) >= self.asked_for)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pace() -> (Pace, impl Fn(u64) -> Instant) {
        let start = Instant::now();
        let settings = PaceSettings { idle_period: Duration::from_secs(5), asked_for: Duration::from_secs(10), cameras: 2 };
        (Pace::new(settings), move |ms| start + Duration::from_millis(ms))
    }

    #[test]
    fn frames_of_a_stream_that_nobody_asks_for_are_taken_seldom_and_the_first_at_once() {
        let (mut pace, at) = pace();
        pace.came("front", at(0));
        assert_eq!(pace.due("front", at(0)), at(0));
        pace.taken("front", at(0));
        for ms in [200, 400, 4900] {
            pace.came("front", at(ms - 100));
            pace.came("front", at(ms));
            assert!(pace.due("front", at(ms)) > at(ms), "{ms}");
        }
        assert_eq!(pace.due("front", at(4900)), at(5000));
        pace.asked("front", at(4910));
        assert_eq!(pace.due("front", at(4920)), at(4920));
        pace.taken("front", at(14_900));
        pace.came("front", at(14_950));
        pace.came("front", at(15_000));
        assert_eq!(pace.due("front", at(15_000)), at(16_000), "ten seconds after it was asked for, unless another follows");
    }

    #[test]
    fn a_frame_after_a_pause_and_the_last_of_a_stream_are_scenes_whoever_asks() {
        let (mut pace, at) = pace();
        pace.came("front", at(0));
        pace.taken("front", at(0));
        pace.came("front", at(300));
        assert_eq!(pace.due("front", at(300)), at(1300), "a second after the last");
        pace.taken("front", at(1300));
        pace.came("front", at(2500));
        assert_eq!(pace.due("front", at(2500)), at(2500), "at once after a pause");
    }

    #[test]
    fn robots_are_listened_to_while_somebody_asks_and_before_a_turn() {
        let (mut pace, at) = pace();
        assert_eq!(pace.wants_robots(at(0)), (true, None), "the first frame may come");
        let stream = |pace: &mut Pace, from: u64, to: u64| {
            for ms in (from..to).step_by(100) {
                pace.came("front", at(ms));
            }
        };
        stream(&mut pace, 0, 100);
        assert!(pace.wants_robots(at(50)).0, "nothing was taken yet");
        pace.taken("front", at(60));
        pace.done("front", 1);
        stream(&mut pace, 100, 3000);
        assert_eq!(pace.wants_robots(at(3000)), (false, Some(at(3400))), "unless another follows");
        stream(&mut pace, 3000, 4600);
        assert!(pace.wants_robots(at(4560)).0, "half a second before its turn");
        pace.taken("front", at(5060));
        assert!(!pace.wants_robots(at(5060)).0);
        pace.asked("front", at(5070));
        assert!(pace.wants_robots(at(5070)).0);
    }

    #[test]
    fn robots_are_listened_to_before_the_last_frame_of_a_stream_becomes_a_scene() {
        let (mut pace, at) = pace();
        pace.came("front", at(0));
        pace.taken("front", at(0));
        pace.done("front", 1);
        for ms in (100..=3000).step_by(100) {
            pace.came("front", at(ms));
            assert!(!pace.wants_robots(at(ms + 90)).0, "{ms}: the stream goes on");
        }
        assert_eq!((pace.due("front", at(3500)), pace.wants_robots(at(3500)).0), (at(4000), true));
        pace.taken("front", at(4000));
        assert!(!pace.wants_robots(at(4000)).0, "nothing waits any more");
    }

    #[test]
    fn who_asks_after_a_pause_waits_for_the_newest_frame_and_others_do_not() {
        let (mut pace, at) = pace();
        assert_eq!(pace.asked("front", at(0)), None, "no frame has come");
        let (mut pace, at) = (Pace::new(pace.settings), at);
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
        pace.came("a", at(5));
        assert_eq!(pace.shown().map(|shown| (shown.camera, shown.frames)).collect::<Vec<_>>(), [("a", 3), ("c", 1)]);
        assert!(pace.is_done("b", 2), "forgotten");
    }

    #[test]
    fn a_frame_of_before_a_camera_was_forgotten_is_not_taken_for_its_newest() {
        let (mut pace, at) = pace();
        for ms in 0..50 {
            pace.came("a", at(ms));
        }
        let old = pace.came("a", at(50));
        for camera in ["b", "c", "a"] {
            pace.came(camera, at(60));
        }
        // It was under way all the while.
        pace.done("a", old);
        let newest = pace.asked("a", at(70)).expect("the frame that came since is no scene yet");
        assert!(newest > old && !pace.is_done("a", newest));
        pace.done("a", newest);
        assert!(pace.is_done("a", old) && pace.is_done("a", newest), "and who waited for the old one waits no longer");
    }

    #[test]
    fn who_asks_for_cameras_that_never_showed_anything_makes_no_other_forgotten() {
        let (mut pace, at) = pace();
        pace.came("a", at(0));
        for (k, camera) in ["of another worker", "misspelt", "of nobody"].into_iter().enumerate() {
            pace.asked(camera, at(1 + k as u64));
        }
        assert!(pace.shown().any(|shown| shown.camera == "a"));
        pace.came("a", at(10));
        assert_eq!(pace.shown().map(|shown| shown.frames).collect::<Vec<_>>(), [2]);
    }
}
