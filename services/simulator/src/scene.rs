//! A scene: furniture and objects at rest, made from a seed.
//!
//! Paper, appendix: 3 to 7 objects start in a random orientation above the surface, or on a flat surface, which may be another object's,
//! and physics runs until they rest. What fell off, still moves, or sits inside something else is not a scene; the same seed then tries
//! again with its next draw.

use nalgebra::{Isometry3, Point3, Vector3};
use parry3d::shape::SharedShape;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use rapier3d::math::Pose;
use repose_geometry::{TriMesh, ViewerFrame};
use repose_relations::{RELATIONS, TrueObject, ground_truth};
use std::sync::Arc;

use crate::arrange::{ArrangeSettings, arranged};
use crate::contact::PlacedParts;
use crate::objects::Shape;
use crate::objects::body::cuboid_mesh;
use crate::physics::{PhysicsSettings, RestSettings, World};
use crate::render::Drawable;

/// Furniture: a box that never moves.
#[derive(Debug, Clone)]
pub struct Fixture {
    /// What it is (`table`, `support`, `floor`).
    pub name: &'static str,
    /// Half its edge lengths, metres.
    pub half_extents_m: Vector3<f64>,
    /// Where it is.
    pub world_from_fixture: Isometry3<f64>,
    /// Its surface.
    pub mesh: TriMesh,
    /// Color in full light.
    pub color: [u8; 3],
    /// Coulomb friction coefficient.
    pub friction: f32,
}

impl Fixture {
    /// A box between two corners (world frame), edges along the axes.
    pub fn between(name: &'static str, low: Point3<f64>, high: Point3<f64>, color: [u8; 3]) -> Self {
        let center = nalgebra::center(&low, &high);
        Self::new(name, (high - low) / 2.0, Isometry3::translation(center.x, center.y, center.z), color)
    }

    /// A box with a pose.
    pub fn new(name: &'static str, half_extents_m: Vector3<f64>, world_from_fixture: Isometry3<f64>, color: [u8; 3]) -> Self {
        Self { name, half_extents_m, world_from_fixture, mesh: cuboid_mesh(half_extents_m.cast()), color, friction: 0.6 }
    }

    /// Height of its upper face, metres. Furniture stands level.
    pub fn top_m(&self) -> f64 {
        self.world_from_fixture.translation.z + self.half_extents_m.z
    }

    pub(crate) fn collider(&self) -> SharedShape {
        let half = self.half_extents_m.cast::<f32>();
        SharedShape::cuboid(half.x, half.y, half.z)
    }

    pub(crate) fn placed(&self) -> Option<PlacedParts> {
        PlacedParts::new(&[(Pose::IDENTITY, self.collider())], &self.world_from_fixture)
    }
}

/// An object in a scene.
#[derive(Debug, Clone)]
pub struct SceneObject {
    /// Instance id, from 1.
    pub id: u16,
    /// What it is.
    pub shape: Arc<Shape>,
    /// Where it rests.
    pub world_from_object: Isometry3<f64>,
    /// Color in full light.
    pub color: [u8; 3],
}

/// Furniture and objects at rest. World is z up; the top of the table is z = 0.
#[derive(Debug, Clone)]
pub struct Scene {
    /// What it was made from.
    pub seed: u64,
    /// Furniture; the first is the table.
    pub fixtures: Vec<Fixture>,
    /// The movable objects; ids are 1, 2, … in order.
    pub objects: Vec<SceneObject>,
    /// Distance between the surfaces of objects, metres, `[n * n]` of `i * n + j`, at most [`crate::contact::FAR_M`].
    pub gaps_m: Vec<f32>,
}

impl Scene {
    /// Ground-truth relations for a viewer, `[n * n]` of `query * n + anchor`; the diagonal is all false.
    pub fn relations(&self, viewer: &ViewerFrame) -> Vec<[bool; RELATIONS]> {
        let n = self.objects.len();
        let truths: Vec<TrueObject> = self.objects.iter().map(|o| TrueObject { bounds: o.shape.bounds(&o.world_from_object) }).collect();
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

    /// The mean of the objects' centres; the table's middle without objects.
    pub fn middle(&self) -> Point3<f64> {
        let sum: Vector3<f64> = self.objects.iter().map(|o| o.world_from_object.translation.vector).sum();
        Point3::from(sum / self.objects.len().max(1) as f64)
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
        scene.gaps_m = measured(&scene).gaps_m;
        scene
    }

    fn put(&mut self, world_from_objects: &[Isometry3<f64>]) {
        for (object, pose) in self.objects.iter_mut().zip(world_from_objects) {
            object.world_from_object = *pose;
        }
    }

    /// The deepest overlap of any two things of which at least one is an object, metres.
    pub fn penetration_m(&self) -> f32 {
        measured(self).penetration_m
    }
}

/// Where scenes come from.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneSettings {
    /// What is put where before physics runs.
    pub arrange: ArrangeSettings,
    /// The stepping.
    pub physics: PhysicsSettings,
    /// When the world counts as at rest.
    pub rest: RestSettings,
    /// Steps that rest is then watched for: a second at the usual step.
    pub watch_steps: usize,
    /// How far any point of an object may move while watched, metres.
    pub watch_limit_m: f64,
    /// Deepest overlap that is accepted, metres.
    pub max_penetration_m: f32,
    /// Draws per seed before it is given up.
    pub max_attempts: u32,
}

impl Default for SceneSettings {
    fn default() -> Self {
        Self {
            arrange: ArrangeSettings::default(),
            physics: PhysicsSettings::default(),
            rest: RestSettings::default(),
            watch_steps: 240,
            watch_limit_m: 0.001,
            max_penetration_m: 0.002,
            max_attempts: 30,
        }
    }
}

/// Why a draw gave no scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Rejected {
    /// There was no room for enough objects.
    #[error("room for {placed} objects, wanted {wanted}")]
    NoRoom {
        /// Objects that found a place.
        placed: usize,
        /// Objects asked for.
        wanted: usize,
    },
    /// An object left the table.
    #[error("object {id} fell off")]
    FellOff {
        /// Which.
        id: u16,
    },
    /// Something kept moving.
    #[error("object {id} ({name}) still moving after {steps} steps")]
    Moving {
        /// One that moves.
        id: u16,
        /// What it is.
        name: Arc<str>,
        /// Steps waited.
        steps: usize,
    },
    /// Two things overlap.
    #[error("{depth_m} m of overlap, at most {limit_m} m allowed")]
    Penetrates {
        /// How deep.
        depth_m: f32,
        /// The limit.
        limit_m: f32,
    },
}

/// A seed that gave no scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("seed {seed} gave no scene in {attempts} draws; the last: {last}")]
pub struct NoScene {
    /// The seed.
    pub seed: u64,
    /// How often it was tried.
    pub attempts: u32,
    /// Why the last draw was rejected.
    pub last: Rejected,
}

/// The scene of a seed, and the draws that were rejected before it.
///
/// # Errors
/// [`NoScene`] when `settings.max_attempts` draws were rejected.
pub fn scene_of_seed(seed: u64, settings: &SceneSettings) -> Result<(Scene, Vec<Rejected>), NoScene> {
    let mut rejections = Vec::new();
    for attempt in 0..settings.max_attempts.max(1) {
        match attempted(seed, attempt, settings) {
            Ok(scene) => return Ok((scene, rejections)),
            Err(why) => rejections.push(why),
        }
    }
    let last = rejections.last().cloned().unwrap_or(Rejected::NoRoom { placed: 0, wanted: 0 });
    Err(NoScene { seed, attempts: rejections.len() as u32, last })
}

/// One draw: arranged, settled, checked.
fn attempted(seed: u64, attempt: u32, settings: &SceneSettings) -> Result<Scene, Rejected> {
    // A stream of its own for each attempt: a rejected draw must not shift what the next one sees.
    let mut rng = Pcg64::seed_from_u64(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(u64::from(attempt)));
    let (fixtures, objects) = arranged(&settings.arrange, &mut rng)?;
    let start = Scene { seed, fixtures, objects, gaps_m: Vec::new() };
    let poses = settled(&start, settings)?;
    let mut scene = start;
    scene.put(&poses);
    let measures = measured(&scene);
    if measures.penetration_m > settings.max_penetration_m {
        return Err(Rejected::Penetrates { depth_m: measures.penetration_m, limit_m: settings.max_penetration_m });
    }
    scene.gaps_m = measures.gaps_m;
    Ok(scene)
}

fn settled(start: &Scene, settings: &SceneSettings) -> Result<Vec<Isometry3<f64>>, Rejected> {
    const PATIENCE: usize = 3;
    let moving = |index: usize, steps: usize| {
        let object = &start.objects[index];
        Rejected::Moving { id: object.id, name: object.shape.name.clone(), steps }
    };
    let mut scene = start.clone();
    let mut steps = 0;
    let mut creeping = 0;
    for _ in 0..PATIENCE {
        let mut world = scene.world(settings.physics);
        let Some(taken) = world.settle(&settings.rest) else {
            return Err(moving(world.first_moving(&settings.rest).unwrap_or(0), steps + settings.rest.max_steps));
        };
        scene.put(&world.poses());
        if let Some(fallen) = scene.objects.iter().find(|o| o.world_from_object.translation.z < 0.0) {
            return Err(Rejected::FellOff { id: fallen.id });
        }
        // Watched in a world of its own: what only stands thanks to the solver's memory of a moment ago would fall when loaded again.
        let mut watched = scene.world(settings.physics);
        for _ in 0..settings.watch_steps {
            watched.step();
        }
        steps += taken + settings.watch_steps;
        let after = watched.poses();
        let moves =
            |(o, pose): (&SceneObject, &Isometry3<f64>)| displacement_m(&o.shape, &o.world_from_object, pose) > settings.watch_limit_m;
        match scene.objects.iter().zip(&after).position(moves) {
            None => return Ok(scene.objects.iter().map(|o| o.world_from_object).collect()),
            Some(mover) => creeping = mover,
        }
        scene.put(&after);
    }
    Err(moving(creeping, steps))
}

/// A bound on how far any point of an object moved between two poses, metres.
pub fn displacement_m(shape: &Shape, world_from_before: &Isometry3<f64>, world_from_after: &Isometry3<f64>) -> f64 {
    let turned = world_from_before.rotation.angle_to(&world_from_after.rotation);
    (world_from_after.translation.vector - world_from_before.translation.vector).norm() + turned * shape.radius_m()
}

struct Measures {
    gaps_m: Vec<f32>,
    penetration_m: f32,
}

fn measured(scene: &Scene) -> Measures {
    let n = scene.objects.len();
    let objects: Vec<Option<PlacedParts>> = scene.objects.iter().map(|o| PlacedParts::new(&o.shape.parts, &o.world_from_object)).collect();
    let fixtures: Vec<PlacedParts> = scene.fixtures.iter().filter_map(Fixture::placed).collect();
    let mut gaps_m = vec![0.0f32; n * n];
    let mut penetration_m = 0.0f32;
    for (i, a) in objects.iter().enumerate() {
        let Some(a) = a else { continue };
        for fixture in &fixtures {
            penetration_m = penetration_m.max(a.penetration_m(fixture));
        }
        for (j, b) in objects.iter().enumerate().skip(i + 1) {
            let Some(b) = b else { continue };
            let gap = a.distance_m(b);
            gaps_m[i * n + j] = gap;
            gaps_m[j * n + i] = gap;
            if gap == 0.0 {
                penetration_m = penetration_m.max(a.penetration_m(b));
            }
        }
    }
    Measures { gaps_m, penetration_m }
}
