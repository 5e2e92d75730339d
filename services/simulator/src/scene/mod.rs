//! A scene: furniture and objects at rest, made from a seed.
//!
//! Paper, appendix: 3 to 7 objects start in a random orientation above the surface, or on a flat surface, which may be another object's,
//! and physics runs until they rest. What fell off, still moves, or sits inside something else is not a scene; the same seed then tries
//! again with its next draw ([`draw`]).

mod draw;
mod measures;
pub mod object;
pub mod rejected;
mod settings;

use nalgebra::{Isometry3, Point3, Vector3};
use repose_geometry::ViewerFrame;
use repose_relations::{RELATIONS, TrueBounds, ground_truth};

pub use crate::furniture::{Fixture, Focus, FurnitureSurface, KindWeights, Outlook, SceneKind};
pub use draw::scene_of_seed;
pub use measures::displacement_m;
pub use object::SceneObject;
pub use rejected::{NoScene, Rejected};
pub use settings::{KnockSettings, SceneSettings};

use crate::physics::{PhysicsSettings, World};
use crate::render::Drawable;

/// A simulated scene: furniture and objects at rest. World is z up; the main surface (a table's or a cabinet's top, a board) is z = 0.
#[derive(Debug, Clone)]
pub struct SimulatedScene {
    /// What it was made from.
    pub seed: u64,
    /// What it is about.
    pub kind: SceneKind,
    /// What never moves.
    pub fixtures: Vec<Fixture>,
    /// Where objects can stand; the first is the main surface.
    pub surfaces: Vec<FurnitureSurface>,
    /// From where a camera sees the objects.
    pub outlook: Outlook,
    /// The movable objects; ids are 1, 2, … in order.
    pub objects: Vec<SceneObject>,
    /// Distance between the surfaces of objects, metres, `[n * n]` of `i * n + j`, at most [`crate::contact::FAR_M`].
    pub gaps_m: Vec<f32>,
}

impl SimulatedScene {
    /// Ground-truth relations for a viewer, `[n * n]` of `query * n + anchor`; the diagonal is all false.
    pub fn relations(&self, viewer: &ViewerFrame) -> Vec<[bool; RELATIONS]> {
        let n = self.objects.len();
        let truths: Vec<TrueBounds> = self.objects.iter().map(|o| TrueBounds { bounds: o.shape.bounds(&o.world_from_object) }).collect();
        let of_pair = |i: usize, j: usize| {
            if i == j { [false; RELATIONS] } else { ground_truth(&truths[i], &truths[j], f64::from(self.gaps_m[i * n + j]), viewer) }
        };
        (0..n * n).map(|k| of_pair(k / n, k % n)).collect()
    }

    /// Everything there is to draw: furniture with label 0, objects with their ids.
    pub fn drawables(&self) -> Vec<Drawable<'_>> {
        let fixtures =
            self.fixtures.iter().map(|f| Drawable { mesh: &f.mesh, world_from_mesh: f.world_from_fixture, label: 0, color: f.color });
        let objects = self.objects.iter().map(|o| Drawable {
            mesh: &o.shape.mesh,
            world_from_mesh: o.world_from_object,
            label: o.id,
            color: o.color,
        });
        fixtures.chain(objects).collect()
    }

    /// The mean of the objects' centres; the main surface's middle without objects.
    pub fn middle(&self) -> Point3<f64> {
        let sum: Vector3<f64> = self.objects.iter().map(|o| o.world_from_object.translation.vector).sum();
        Point3::from(sum / self.objects.len().max(1) as f64)
    }

    /// What a camera should look at, and from where it sees the objects.
    pub fn focus(&self) -> Focus {
        self.outlook.at(self.middle())
    }

    /// A world in which the scene's objects rest where they are; object indices are the scene's.
    pub fn world(&self, physics: PhysicsSettings) -> World {
        let mut world = World::new(physics);
        for fixture in &self.fixtures {
            world.add_fixture(fixture.collider(), &fixture.world_from_fixture, fixture.friction);
        }
        for object in &self.objects {
            world.add_object(&object.shape, &object.world_from_object);
        }
        world
    }

    /// The same scene with other poses; distances are measured anew.
    pub fn with_poses(&self, world_from_objects: &[Isometry3<f64>]) -> Self {
        let mut scene = self.clone();
        scene.put(world_from_objects);
        scene.gaps_m = measures::measured(&scene).gaps_m;
        scene
    }

    fn put(&mut self, world_from_objects: &[Isometry3<f64>]) {
        for (object, pose) in self.objects.iter_mut().zip(world_from_objects) {
            object.world_from_object = *pose;
        }
    }

    /// The deepest overlap of any two things of which at least one is an object, metres.
    pub fn penetration_m(&self) -> f32 {
        measures::measured(self).penetration_m
    }
}
