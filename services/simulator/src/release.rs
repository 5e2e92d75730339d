//! What happens when an object is let go somewhere: the physical test of a placement.
//!
//! Paper, section 3: a placement is stable when the object's centre moves less than 5 cm in 500 physics steps.

use nalgebra::{Isometry3, Vector3};

use crate::contact::PlacedParts;
use crate::physics::{PhysicsSettings, RestSettings};
use crate::scene::Scene;

/// How long and how finely the release is simulated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReleaseSettings {
    /// Steps to simulate.
    pub steps: usize,
    /// The stepping.
    pub physics: PhysicsSettings,
    /// Whether the simulation ends before its last step once everything has come to rest: several times faster, and what creeps slower than
    /// [`RestSettings`] says is not waited for. Default false, as in the paper.
    pub ends_at_rest: bool,
}

impl Default for ReleaseSettings {
    fn default() -> Self {
        Self { steps: 500, physics: PhysicsSettings::default(), ends_at_rest: false }
    }
}

/// What came of a release.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// How far the object's centre moved, metres.
    pub moved_m: f64,
    /// How far its own up axis turned away from where it pointed, radians.
    pub tilt_rad: f64,
    /// How deep it overlapped something at the start, metres.
    pub penetration_m: f32,
    /// The farthest that another object's centre moved, metres.
    pub others_moved_m: f64,
    /// Where everything came to be, in the scene's order.
    pub world_from_objects: Vec<Isometry3<f64>>,
}

/// Puts object `index` of the scene at `world_from_object`, at rest, and lets go. `None` when the scene has no such object.
pub fn released(scene: &Scene, index: usize, world_from_object: &Isometry3<f64>, settings: &ReleaseSettings) -> Option<Outcome> {
    let mut start: Vec<Isometry3<f64>> = scene.objects.iter().map(|o| o.world_from_object).collect();
    *start.get_mut(index)? = *world_from_object;
    let penetration_m = penetration_of(scene, index, world_from_object);
    let mut world = scene.world(settings.physics);
    world.place_object(index, world_from_object);
    let (rest, mut still) = (RestSettings::default(), 0);
    for _ in 0..settings.steps {
        world.step();
        still = if settings.ends_at_rest && world.first_moving(&rest).is_none() { still + 1 } else { 0 };
        if still >= rest.steps {
            break;
        }
    }
    let end = world.poses();
    let moved = |i: usize| (end[i].translation.vector - start[i].translation.vector).norm();
    let up = |pose: &Isometry3<f64>| pose.rotation * Vector3::z();
    Some(Outcome {
        moved_m: moved(index),
        tilt_rad: up(&start[index]).angle(&up(&end[index])),
        penetration_m,
        others_moved_m: (0..end.len()).filter(|&i| i != index).map(moved).fold(0.0, f64::max),
        world_from_objects: end,
    })
}

/// How deep object `index` would be in anything else at `world_from_object`, metres.
pub fn penetration_of(scene: &Scene, index: usize, world_from_object: &Isometry3<f64>) -> f32 {
    let Some(object) = PlacedParts::new(&scene.objects[index].shape.parts, world_from_object) else { return 0.0 };
    let others = scene
        .objects
        .iter()
        .enumerate()
        .filter(|(i, _)| *i != index)
        .filter_map(|(_, o)| PlacedParts::new(&o.shape.parts, &o.world_from_object));
    let fixtures = scene.fixtures.iter().filter_map(crate::scene::Fixture::placed);
    others.chain(fixtures).map(|other| object.penetration_m(&other)).fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{SceneSettings, scene_of_seed};

    #[test]
    fn what_is_released_where_it_rested_stays_and_what_floats_falls() {
        let (scene, _) = scene_of_seed(11, &SceneSettings::default()).expect("seed 11 gives a scene");
        let here = scene.objects[0].world_from_object;
        let stayed = released(&scene, 0, &here, &ReleaseSettings::default()).expect("an object");
        assert!(stayed.moved_m < 0.005 && stayed.others_moved_m < 0.005, "{stayed:?}");
        let mut above = here;
        above.translation.z += 0.25;
        let fell = released(&scene, 0, &above, &ReleaseSettings::default()).expect("an object");
        assert!(fell.moved_m > 0.1, "{fell:?}");
        assert!(released(&scene, 99, &here, &ReleaseSettings::default()).is_none());
    }
}
