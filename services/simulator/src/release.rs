//! What happens when an object is let go somewhere: the physical test of a placement.
//!
//! Paper, section 3: a placement is stable when the object's centre moves less than 5 cm in 500 physics steps.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3};
use repose_geometry::transform::tilt;

use crate::contact::{FAR_M, PlacedParts};
use crate::objects::ObjectShape;
use crate::physics::{PhysicsSettings, RestSettings};
use crate::scene::SimulatedScene;

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

/// The outcome of a simulated release.
#[derive(Debug, Clone, PartialEq)]
pub struct ReleaseOutcome {
    /// How far the object's centre moved, metres.
    pub moved_m: f64,
    /// How far it tipped, radians; a turn about the vertical is none.
    pub tilt_rad: f64,
    /// How deep it overlapped something at the start, metres.
    pub penetration_m: f32,
    /// The farthest that another object's centre moved, metres.
    pub others_moved_m: f64,
    /// Where everything came to be, in the scene's order.
    pub world_from_objects: Vec<Isometry3<f64>>,
}

/// Puts object `index` of the scene at `world_from_object`, at rest, and lets go. `None` when the scene has no such object.
pub fn released(
    scene: &SimulatedScene,
    index: usize,
    world_from_object: &Isometry3<f64>,
    settings: &ReleaseSettings,
) -> Option<ReleaseOutcome> {
    let mut start: Vec<Isometry3<f64>> = scene.objects.iter().map(|o| o.world_from_object).collect();
    *start.get_mut(index)? = *world_from_object;
    let penetration_m = penetration_of(scene, index, world_from_object);
    let mut world = scene.world(settings.physics);
    world.place_object(index, world_from_object);
    world.run(settings.steps, settings.ends_at_rest.then(RestSettings::default).as_ref());
    let end = world.poses();
    let moved = |i: usize| (end[i].translation.vector - start[i].translation.vector).norm();
    Some(ReleaseOutcome {
        moved_m: moved(index),
        tilt_rad: tilt(&start[index], &end[index]),
        penetration_m,
        others_moved_m: (0..end.len()).filter(|&i| i != index).map(moved).fold(0.0, f64::max),
        world_from_objects: end,
    })
}

/// How deep object `index` would be in anything else at `world_from_object`, metres.
pub fn penetration_of(scene: &SimulatedScene, index: usize, world_from_object: &Isometry3<f64>) -> f32 {
    Surroundings::of(scene, index).map_or(0.0, |around| around.deepest(world_from_object).map_or(0.0, |(_, depth_m)| depth_m))
}

/// Something that an object can touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Thing {
    /// The object of this id.
    Object(u16),
    /// The fixture at this position in the scene's list.
    Fixture(usize),
}

/// Everything in a scene but one object, to try many places of that object against.
#[derive(Debug, Clone)]
pub struct Surroundings {
    shape: Arc<ObjectShape>,
    others: Vec<(Thing, PlacedParts)>,
}

impl Surroundings {
    /// What surrounds object `index`; `None` when the scene has no such object.
    pub fn of(scene: &SimulatedScene, index: usize) -> Option<Self> {
        let shape = scene.objects.get(index)?.shape.clone();
        let objects = scene.objects.iter().enumerate().filter(|(i, _)| *i != index).filter_map(|(_, o)| {
            let parts = PlacedParts::new(&o.shape.parts, &o.world_from_object)?;
            Some((Thing::Object(o.id), parts))
        });
        let fixtures = scene.fixtures.iter().enumerate().filter_map(|(i, f)| Some((Thing::Fixture(i), f.placed()?)));
        Some(Self { shape, others: objects.chain(fixtures).collect() })
    }

    /// What the object would be deepest in at `world_from_object`, and how deep, metres; `None` where it is free. The first of equals.
    pub fn deepest(&self, world_from_object: &Isometry3<f64>) -> Option<(Thing, f32)> {
        let object = PlacedParts::new(&self.shape.parts, world_from_object)?;
        let mut deepest: Option<(Thing, f32)> = None;
        for (thing, parts) in &self.others {
            let depth_m = object.penetration_m(parts);
            if depth_m > deepest.map_or(0.0, |(_, d)| d) {
                deepest = Some((*thing, depth_m));
            }
        }
        deepest
    }

    /// The smallest distance from the object at `world_from_object` to anything, metres: 0 where it overlaps something, at most
    /// [`crate::contact::FAR_M`].
    pub fn distance_m(&self, world_from_object: &Isometry3<f64>) -> f32 {
        let Some(object) = PlacedParts::new(&self.shape.parts, world_from_object) else { return FAR_M };
        self.others.iter().map(|(_, parts)| object.distance_m(parts)).fold(FAR_M, f32::min)
    }

    /// Whether something else overlaps any of them.
    pub fn overlaps(&self, parts: &PlacedParts) -> bool {
        self.others.iter().any(|(_, other)| other.penetration_m(parts) > 0.0)
    }

    /// Whether a place in the world is inside anything.
    pub fn fills(&self, place: &Point3<f32>) -> bool {
        self.others.iter().any(|(_, parts)| parts.contains(place))
    }

    /// The lowest point of the object at `world_from_object`, and the highest of everything whose box is over or under its box, highest first,
    /// metres.
    pub fn column_m(&self, world_from_object: &Isometry3<f64>) -> (f64, Vec<f64>) {
        let Some(object) = PlacedParts::new(&self.shape.parts, world_from_object) else { return (0.0, Vec::new()) };
        let bounds = object.bounds();
        let meets = |parts: &PlacedParts| (0..2).all(|k| parts.bounds().min[k] < bounds.max[k] && parts.bounds().max[k] > bounds.min[k]);
        let mut tops: Vec<f64> = self.others.iter().filter(|(_, p)| meets(p)).map(|(_, p)| f64::from(p.bounds().max.z)).collect();
        tops.sort_by(|a, b| b.total_cmp(a));
        (f64::from(bounds.min.z), tops)
    }

    /// What the object would stand on at `world_from_object`, where it is at most `reach_m` above it: what it is deepest in when it is
    /// lowered by that much.
    pub fn carrier(&self, world_from_object: &Isometry3<f64>, reach_m: f64) -> Option<Thing> {
        let mut lowered = *world_from_object;
        lowered.translation.z -= reach_m;
        self.deepest(&lowered).map(|(thing, _)| thing)
    }
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

    #[test]
    fn what_an_object_stands_on_is_what_it_sinks_into() {
        let (scene, _) = scene_of_seed(11, &SceneSettings::default()).expect("seed 11 gives a scene");
        let around = Surroundings::of(&scene, 0).expect("an object");
        let here = scene.objects[0].world_from_object;
        assert!(around.deepest(&here).is_none_or(|(_, depth_m)| depth_m < 0.002), "at rest it is in nothing");
        assert!(around.carrier(&here, 0.004).is_some());
        let mut above = here;
        above.translation.z += 2.0;
        assert_eq!((around.deepest(&above), around.carrier(&above, 0.004)), (None, None));
        assert_eq!(penetration_of(&scene, 0, &above), 0.0);
        assert!(Surroundings::of(&scene, 99).is_none());
    }
}
