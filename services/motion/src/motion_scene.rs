//! A scene as a worker holds it: what is believed of it is made when it is first planned on, once for all requests.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use repose_proto::{CallError, Scene};

use crate::scene::PlanningScene;
use crate::wire;

/// A scene held by a motion worker, with its planning scene, which is made on first use.
#[derive(Debug)]
pub struct MotionScene {
    scene: Scene,
    planning: Arc<OnceLock<Result<PlanningScene, CallError>>>,
    came: Instant,
}

impl MotionScene {
    /// A scene that nobody has planned on yet.
    pub fn new(scene: Scene) -> Self {
        Self { scene, planning: Arc::default(), came: Instant::now() }
    }

    /// The same content, seen at another time.
    pub fn seen_again(&self, scene: Scene) -> Self {
        Self { scene, planning: self.planning.clone(), came: Instant::now() }
    }

    /// As it came.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// How long ago it came.
    pub fn held_for(&self) -> Duration {
        self.came.elapsed()
    }

    /// To plan on. The first caller makes it; others that come meanwhile wait for that.
    ///
    /// # Errors
    /// Those of [`wire::planning_scene`].
    pub fn planning(&self) -> Result<&PlanningScene, CallError> {
        self.planning.get_or_init(|| wire::planning_scene(&self.scene)).as_ref().map_err(Clone::clone)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    #[test]
    fn what_is_believed_of_a_scene_is_made_once_and_stays_when_the_scene_is_seen_again() {
        let first = MotionScene::new(synthetic::wire_scene(7));
        let again = first.seen_again(synthetic::wire_scene(9));
        assert_eq!((first.scene().stamp_ns, again.scene().stamp_ns), (7, 9));
        assert!(std::ptr::eq(first.planning().unwrap(), again.planning().unwrap()));
        assert_eq!(first.planning().unwrap().belief.objects.keys().collect::<Vec<_>>(), [&1, &2, &3]);
    }

    #[test]
    fn a_scene_that_cannot_be_planned_on_says_so_each_time() {
        let mut scene = synthetic::wire_scene(7);
        scene.meta.camera.world_from_camera = None;
        let held = MotionScene::new(scene);
        for _ in 0..2 {
            assert_eq!(held.planning().unwrap_err().field.as_deref(), Some("scene.camera.world_from_camera"));
        }
    }
}
