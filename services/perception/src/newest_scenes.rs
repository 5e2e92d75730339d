//! Which scene is each camera's newest.

use std::collections::BTreeMap;

use repose_proto::{Payload, SceneSummary};

/// A scene in the form that it is answered with, so that answering copies nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptScene {
    /// What `latest` answers and the scene's topic carries; names the id.
    pub summary: SceneSummary,
    /// The scene in bulk form.
    pub payload: Payload,
}

/// Which cameras' newest scenes are known, and which stamps count as late.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NewestLimits {
    /// Most cameras whose newest scene is known.
    pub cameras: usize,
    /// A stamp this much before its camera's newest is late; an earlier one says that the camera's clock was set back.
    pub late_ns: u64,
}

/// The newest scene of each camera.
#[derive(Debug)]
pub struct NewestScenes {
    limits: NewestLimits,
    of_cameras: BTreeMap<String, Newest>,
    /// Scenes of streams so far.
    streamed: u64,
}

/// A camera's newest scene.
#[derive(Debug)]
struct Newest {
    summary: SceneSummary,
    /// Its number among the scenes of streams.
    number: u64,
}

/// How a camera's scene stands to those that came before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// It is the camera's newest.
    Newest,
    /// It is the camera's newest, although its stamp is far before the last one's.
    Restarted,
    /// The camera has a newer one already.
    Late,
}

impl NewestScenes {
    /// No camera is known yet.
    pub fn new(limits: NewestLimits) -> Self {
        Self { limits, of_cameras: BTreeMap::new(), streamed: 0 }
    }

    /// Takes a scene of a camera's stream. Scenes come in the order of their frames, so it is the camera's newest, unless its stamp says
    /// that its frame was overtaken on the way: only a little before the newest one's, for a clock may also have been wrong.
    pub fn take(&mut self, scene: &KeptScene) -> Arrival {
        let summary = scene.summary.clone();
        let newest_ns = self.of_cameras.get(&summary.camera).map_or(0, |newest| newest.summary.stamp_ns);
        let arrival = match newest_ns.saturating_sub(summary.stamp_ns) {
            0 => Arrival::Newest,
            back_ns if back_ns > self.limits.late_ns => Arrival::Restarted,
            _ => return Arrival::Late,
        };
        self.streamed += 1;
        let newest = Newest { number: self.streamed, summary };
        self.of_cameras.insert(newest.summary.camera.clone(), newest);
        if self.of_cameras.len() > self.limits.cameras.max(1)
            && let Some(gone) = self.of_cameras.iter().min_by_key(|(_, newest)| newest.number).map(|(camera, _)| camera.clone())
        {
            self.of_cameras.remove(&gone);
        }
        arrival
    }

    /// The ids of the cameras' newest scenes.
    pub fn scene_ids(&self) -> impl Iterator<Item = &str> {
        self.of_cameras.values().map(|newest| newest.summary.scene_id.as_str())
    }

    /// The newest scene of a camera's stream.
    pub fn of(&self, camera: &str) -> Option<&SceneSummary> {
        self.of_cameras.get(camera).map(|newest| &newest.summary)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(id: &str, camera: &str, stamp_ns: u64) -> KeptScene {
        let summary = SceneSummary {
            scene_id: id.to_owned(),
            camera: camera.to_owned(),
            stamp_ns,
            objects: Vec::new(),
            surfaces: Vec::new(),
            left_out: Vec::new(),
            warnings: Vec::new(),
        };
        KeptScene { summary, payload: Payload { encoding: String::new(), bytes: Vec::new().into() } }
    }

    fn newest() -> NewestScenes {
        NewestScenes::new(NewestLimits { cameras: 2, late_ns: 10 })
    }

    #[test]
    fn a_late_frame_does_not_become_the_newest() {
        let mut newest = newest();
        assert_eq!(newest.take(&scene("a", "left", 5)), Arrival::Newest);
        assert_eq!(newest.take(&scene("b", "left", 4)), Arrival::Late);
        assert_eq!(newest.take(&scene("c", "right", 1)), Arrival::Newest);
        assert_eq!(newest.of("left").unwrap().scene_id, "a");
        assert_eq!(newest.of("nobody"), None);
    }

    #[test]
    fn one_stamp_from_the_future_does_not_silence_a_camera() {
        let mut newest = newest();
        assert_eq!(newest.take(&scene("a", "left", 1000)), Arrival::Newest);
        assert_eq!(newest.take(&scene("b", "left", 990)), Arrival::Late);
        assert_eq!(newest.take(&scene("c", "left", 100)), Arrival::Restarted);
        assert_eq!(newest.of("left").unwrap().scene_id, "c");
        assert_eq!(newest.take(&scene("d", "left", 101)), Arrival::Newest);
    }

    #[test]
    fn the_number_of_cameras_is_bounded_and_the_longest_silent_one_goes() {
        let mut newest = newest();
        for camera in ["a", "b", "a", "c"] {
            newest.take(&scene(camera, camera, 1));
        }
        assert_eq!(["a", "b", "c"].map(|camera| newest.of(camera).is_some()), [true, false, true]);
    }
}
