//! A cell's cameras, with how often they show something new.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use repose_proto::load::CameraLoad;

use crate::messages::CameraShown;

/// Weight of the newest interval between two scenes in the smoothed one.
const NEWEST: f64 = 0.2;
/// How long a camera that shows nothing, and a robot that tells nothing, is remembered.
pub const REMEMBERED: Duration = Duration::from_secs(600);
/// A camera whose newest scene came longer ago shows nothing now: of a stream that nobody asks about there is one every ten seconds.
const SHOWS: Duration = Duration::from_secs(30);

struct Seen {
    at: Instant,
    interval_s: Option<f64>,
}

/// When each camera's newest scene arrived.
#[derive(Default)]
pub struct SceneArrivals(BTreeMap<String, Seen>);

impl SceneArrivals {
    /// Notes a scene of a camera; whether the camera is new.
    pub fn saw(&mut self, camera: &str, at: Instant) -> bool {
        match self.0.get_mut(camera) {
            Some(seen) => {
                let interval_s = at.duration_since(seen.at).as_secs_f64();
                seen.interval_s = Some(seen.interval_s.map_or(interval_s, |old| old + NEWEST * (interval_s - old)));
                seen.at = at;
                false
            }
            None => self.0.insert(camera.to_owned(), Seen { at, interval_s: None }).is_none(),
        }
    }

    /// Workers tell of the cameras whose scenes they made; whether one of these is new. While nobody asks for scenes they are seldom, so that a
    /// camera is known by this alone for a while.
    pub fn told<'a>(&mut self, cameras: impl Iterator<Item = &'a CameraLoad>, now: Instant) -> bool {
        let mut is_new = false;
        for (camera, newest) in cameras.filter_map(|load| Some((&load.camera, load.newest.as_ref()?))) {
            if !self.0.contains_key(camera) {
                is_new |= self.saw(camera, now.checked_sub(Duration::from_millis(newest.age_ms)).unwrap_or(now));
            }
        }
        is_new
    }

    /// The first by name of those that show something now; where none does, the one that did last.
    pub fn first(&self, now: Instant) -> Option<&str> {
        let shows = |(_, seen): &(&String, &Seen)| now.duration_since(seen.at) < SHOWS;
        let last = || self.0.iter().max_by_key(|(_, seen)| seen.at);
        self.0.iter().find(shows).or_else(last).map(|(name, _)| name.as_str())
    }

    /// Each as viewers get it; those long silent are forgotten.
    pub fn shown(&mut self, now: Instant) -> Vec<CameraShown> {
        self.0.retain(|_, seen| now.duration_since(seen.at) < REMEMBERED);
        let shown = |(name, seen): (&String, &Seen)| {
            let age_s = now.duration_since(seen.at).as_secs_f64();
            // A camera that has stopped slows down to nothing.
            let scenes_per_s = seen.interval_s.map_or(0.0, |interval_s| 1.0 / interval_s.max(age_s).max(1e-3));
            CameraShown { name: name.clone(), scenes_per_s, age_ms: age_s * 1e3 }
        };
        self.0.iter().map(shown).collect()
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::load::NewestSceneLoad;

    use super::*;

    #[test]
    fn a_camera_has_the_rate_of_its_scenes_and_loses_it_when_it_stops() {
        let (mut cameras, start) = (SceneArrivals::default(), Instant::now());
        let at = |ms: u64| start + Duration::from_millis(ms);
        assert!(cameras.saw("front", at(0)) && cameras.first(at(0)) == Some("front"));
        for k in 1..50 {
            assert!(!cameras.saw("front", at(200 * k)));
        }
        assert!((cameras.shown(at(9900))[0].scenes_per_s - 5.0).abs() < 1e-6);
        assert!(cameras.shown(at(19_800))[0].scenes_per_s < 0.11);
        assert!(cameras.shown(at(10_000_000)).is_empty());
        let mut told = |age_ms, now| {
            let newest = Some(NewestSceneLoad { scene_id: "scene".to_owned(), objects: 0, age_ms, lag_ms: 0.0 });
            let load = CameraLoad { camera: "side".to_owned(), frames: 1, frame_age_ms: 0, newest };
            cameras.told(std::iter::once(&load), now)
        };
        assert!(told(0, at(10_000_000)) && !told(0, at(10_000_500)));
        assert!((cameras.shown(at(10_001_000))[0].age_ms - 1000.0).abs() < 1e-6, "its scene is as old as it was told first");
    }

    #[test]
    fn a_camera_that_has_died_is_not_chosen_before_one_that_shows_something() {
        let (mut cameras, start) = (SceneArrivals::default(), Instant::now());
        let at = |s: u64| start + Duration::from_secs(s);
        assert!(cameras.saw("a-died", at(0)) && cameras.saw("front", at(0)) && cameras.saw("wrist", at(1)));
        assert_eq!(cameras.first(at(5)), Some("a-died"), "nobody knows yet");
        cameras.saw("wrist", at(500));
        cameras.saw("front", at(505));
        assert_eq!(cameras.first(at(510)), Some("front"));
        assert_eq!(cameras.first(at(590)), Some("front"), "none shows anything, and this one did last");
    }
}
