//! What is kept for the sessions of one server: so much for each, that none throws out another's, and for all together no more than there is room for.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use crate::seen::ShownScene;

/// How much is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// For one session; over that its own oldest goes.
    pub per_session: usize,
    /// For all sessions; over that the oldest goes of the session that has most.
    pub total: usize,
    /// The same in bytes of the scenes that are held.
    pub bytes: usize,
}

/// Things that hold a scene, each under an id and for a session.
#[derive(Debug)]
pub struct PerSession<T> {
    /// The oldest first.
    kept: VecDeque<Kept<T>>,
    bounds: Bounds,
    scene_of: fn(&T) -> &ShownScene,
}

#[derive(Debug)]
struct Kept<T> {
    session: String,
    id: String,
    thing: Arc<T>,
}

impl<T> PerSession<T> {
    /// Nothing yet. `scene_of` is the scene that a thing holds.
    pub fn new(bounds: Bounds, scene_of: fn(&T) -> &ShownScene) -> Self {
        Self { kept: VecDeque::new(), bounds, scene_of }
    }

    /// Keeps a thing for a session, as its newest. Whoever has another under this id has this one from now on.
    pub fn keep(&mut self, session: &str, id: &str, thing: Arc<T>) {
        self.kept.retain(|kept| kept.session != session || kept.id != id);
        self.kept.iter_mut().filter(|kept| kept.id == id).for_each(|kept| kept.thing = thing.clone());
        if self.kept.iter().filter(|kept| kept.session == session).count() >= self.bounds.per_session
            && let Some(oldest) = self.kept.iter().position(|kept| kept.session == session)
        {
            self.kept.remove(oldest);
        }
        self.kept.push_back(Kept { session: session.to_owned(), id: id.to_owned(), thing });
        while self.kept.len() > 1 && (self.kept.len() > self.bounds.total || self.bytes() > self.bounds.bytes) {
            self.let_one_go();
        }
    }

    /// What a session has under an id.
    pub fn of(&self, session: &str, id: &str) -> Option<Arc<T>> {
        self.kept.iter().find(|kept| kept.session == session && kept.id == id).map(|kept| kept.thing.clone())
    }

    /// What any session has under an id.
    pub fn of_any(&self, id: &str) -> Option<Arc<T>> {
        self.kept.iter().find(|kept| kept.id == id).map(|kept| kept.thing.clone())
    }

    /// Lets go what is kept under an id.
    pub fn remove(&mut self, id: &str) {
        self.kept.retain(|kept| kept.id != id);
    }

    /// Lets the oldest go of the session that has most. The newest of all is never that: where every session has one, the oldest of all goes.
    fn let_one_go(&mut self) {
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        for kept in &self.kept {
            *counts.entry(&kept.session).or_default() += 1;
        }
        let most = counts.values().copied().max();
        if let Some(oldest) = self.kept.iter().position(|kept| counts.get(kept.session.as_str()).copied() == most) {
            self.kept.remove(oldest);
        }
    }

    /// The size of the scenes that are held; one that several things share counts once.
    fn bytes(&self) -> usize {
        let scenes = self.kept.iter().map(|kept| (self.scene_of)(&kept.thing));
        scenes.map(|scene| (std::ptr::from_ref(scene), scene.bytes())).collect::<BTreeMap<_, _>>().values().sum()
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::{Bulk, Scene};

    use super::*;

    const BOUNDS: Bounds = Bounds { per_session: 3, total: 6, bytes: usize::MAX };

    fn scene(stamp_ns: u64) -> Arc<ShownScene> {
        let golden = include_bytes!("../../../proto/tests/golden/Scene.v1.safetensors");
        let golden = Scene::from_bulk(&Bulk::decode(golden).expect("bulk")).expect("a scene");
        Arc::new(ShownScene { scene_id: "an id".to_owned(), scene: Scene { stamp_ns, ..golden } })
    }

    fn kept(bounds: Bounds) -> PerSession<ShownScene> {
        PerSession::new(bounds, |scene| scene)
    }

    /// The ids that are kept for a session, the oldest first.
    fn ids<'a>(kept: &'a PerSession<ShownScene>, session: &str) -> Vec<&'a str> {
        kept.kept.iter().filter(|kept| kept.session == session).map(|kept| kept.id.as_str()).collect()
    }

    #[test]
    fn a_session_that_keeps_much_loses_its_own_oldest_and_nobody_elses() {
        let (mut kept, scene) = (kept(BOUNDS), scene(1));
        kept.keep("a", "first", scene.clone());
        for id in ["1", "2", "3", "4", "5"] {
            kept.keep("b", id, scene.clone());
        }
        assert_eq!((ids(&kept, "a"), ids(&kept, "b")), (vec!["first"], vec!["3", "4", "5"]));
        assert!(kept.of("a", "first").is_some() && kept.of("b", "first").is_none() && kept.of_any("first").is_some());
        // What is kept again is the newest.
        kept.keep("b", "3", scene.clone());
        kept.keep("b", "6", scene);
        assert_eq!(ids(&kept, "b"), ["5", "3", "6"]);
    }

    #[test]
    fn where_all_have_too_much_the_session_with_the_most_gives_its_oldest() {
        let (mut kept, scene) = (kept(BOUNDS), scene(1));
        for (session, id) in [("a", "1"), ("b", "2"), ("b", "3"), ("b", "4"), ("c", "5"), ("d", "6"), ("e", "7")] {
            kept.keep(session, id, scene.clone());
        }
        assert_eq!((ids(&kept, "a"), ids(&kept, "b"), ids(&kept, "e")), (vec!["1"], vec!["3", "4"], vec!["7"]));
        for session in ["f", "g", "h"] {
            kept.keep(session, session, scene.clone());
        }
        // With one each, the oldest of all goes.
        let left: Vec<&str> = kept.kept.iter().map(|kept| kept.id.as_str()).collect();
        assert_eq!(left, ["5", "6", "7", "f", "g", "h"]);
    }

    #[test]
    fn bytes_are_bounded_by_the_scenes_that_are_held_and_the_newest_stays_whatever_its_size() {
        let size = scene(1).bytes();
        assert!(size > 0);
        let mut kept = kept(Bounds { bytes: 2 * size, ..BOUNDS });
        let shared = scene(1);
        kept.keep("a", "1", shared.clone());
        kept.keep("b", "2", shared.clone());
        kept.keep("c", "3", scene(2));
        assert_eq!((kept.kept.len(), kept.bytes()), (3, 2 * size), "two of them share a scene");
        kept.keep("d", "4", scene(3));
        assert!(kept.of("d", "4").is_some() && kept.of("a", "1").is_none() && kept.bytes() <= 2 * size);
        kept.bounds.bytes = 1;
        kept.keep("e", "5", scene(4));
        assert_eq!((kept.kept.len(), ids(&kept, "e")), (1, vec!["5"]));
    }

    #[test]
    fn a_later_sighting_of_the_same_scene_is_everybodys() {
        let mut kept = kept(BOUNDS);
        kept.keep("a", "1", scene(1));
        kept.keep("b", "1", scene(2));
        let stamp = |session: &str| kept.of(session, "1").map(|seen| seen.scene.stamp_ns);
        assert_eq!((stamp("a"), stamp("b")), (Some(2), Some(2)));
        kept.remove("1");
        assert!(kept.of_any("1").is_none());
    }
}
