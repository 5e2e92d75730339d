//! The physics of a small world: fixed furniture, rigid objects, gravity; rapier underneath.
//!
//! A fixed step and one thread: the same world stepped the same way gives the same poses on the same machine. The engine's tolerances
//! are for things of a metre; its length unit is set to a decimetre so that they fit cups.

use nalgebra::Isometry3;
use parry3d::shape::SharedShape;
use rapier3d::dynamics::{RigidBodyBuilder, RigidBodyHandle};
use rapier3d::geometry::{ColliderBuilder, ColliderHandle, ContactPair};
use rapier3d::math::Vector;
use rapier3d::pipeline::PhysicsWorld;

use crate::convert;
use crate::objects::ObjectShape;

/// How the world is stepped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhysicsSettings {
    /// Simulated time of a step. Smaller is stiffer and slower; the paper's 500 steps are of 1/240 s.
    pub step_s: f32,
    /// Solver iterations (substeps) a step. More keeps stacks and grasps stiffer.
    pub solver_iterations: usize,
    /// Angular damping, 1/s: stands in for rolling resistance, without which round things roll for ever.
    pub angular_damping: f32,
    /// Linear damping, 1/s.
    pub linear_damping: f32,
    /// Natural frequency of contacts, Hz; with furniture twice that. Higher is harder: at 30 Hz twenty newtons press a gripper's fingers
    /// millimetres into a light object. Must stay well below the solver's rate (iterations over step).
    pub contact_frequency_hz: f32,
    /// Distance at which contacts are foreseen, metres. Less means fewer contacts to solve and fast things caught later.
    pub prediction_m: f32,
    /// Whether friction also acts while overlaps are pushed apart. Without it what is held slips; with it tall stacks may lean.
    pub friction_while_separating: bool,
    /// Whether contacts between bodies that hardly move against each other keep their points and normals from step to step. Cheaper, but what
    /// is kept is kept in the world's axes: a hand that turns with what it holds lets go of it.
    pub recycled_contacts: bool,
}

impl PhysicsSettings {
    /// For a gripper at work: finer steps, hard contacts, friction that holds.
    pub fn grasping() -> Self {
        Self {
            step_s: 1.0 / 500.0,
            contact_frequency_hz: 240.0,
            prediction_m: 0.004,
            friction_while_separating: true,
            recycled_contacts: false,
            ..Self::default()
        }
    }
}

impl Default for PhysicsSettings {
    fn default() -> Self {
        Self {
            step_s: 1.0 / 240.0,
            solver_iterations: 4,
            angular_damping: 1.0,
            linear_damping: 0.05,
            contact_frequency_hz: 30.0,
            prediction_m: 0.002,
            friction_while_separating: false,
            recycled_contacts: true,
        }
    }
}

/// When a world counts as at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RestSettings {
    /// Fastest that a centre of mass may move.
    pub linear_m_s: f32,
    /// Fastest that an object may turn.
    pub angular_rad_s: f32,
    /// For how many steps in a row.
    pub steps: usize,
    /// Steps after which waiting ends.
    pub max_steps: usize,
    /// Steps after which `calming_damping` replaces the usual angular damping: what rolls on a level table has to stop somewhere.
    pub calming_after: usize,
    /// Angular damping while calming, 1/s.
    pub calming_damping: f32,
}

impl Default for RestSettings {
    fn default() -> Self {
        Self { linear_m_s: 0.004, angular_rad_s: 0.06, steps: 24, max_steps: 720, calming_after: 240, calming_damping: 12.0 }
    }
}

const GRAVITY_M_S2: f32 = 9.81;

/// The size of the things at hand, which the engine's tolerances are relative to.
const LENGTH_UNIT_M: f32 = 0.1;

/// Why a world did not come to rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unrest {
    /// An object fell too low.
    Lost {
        /// Which.
        index: usize,
    },
    /// An object still moves.
    Moving {
        /// Which.
        index: usize,
    },
}

/// Something in a world that can be touched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Touchable {
    /// Something that never moves, by the order in which it was added.
    Fixture(usize),
    /// An object, by its index.
    Object(usize),
    /// A part of the robot.
    Robot,
}

/// A world with furniture and objects.
pub struct World {
    inner: PhysicsWorld,
    objects: Vec<RigidBodyHandle>,
    fixtures: Vec<RigidBodyHandle>,
    settings: PhysicsSettings,
}

impl World {
    /// An empty world with gravity along −z.
    pub fn new(settings: PhysicsSettings) -> Self {
        let mut inner = PhysicsWorld { gravity: Vector::new(0.0, 0.0, -GRAVITY_M_S2), ..PhysicsWorld::default() };
        let parameters = &mut inner.integration_parameters;
        parameters.dt = settings.step_s;
        parameters.num_solver_iterations = settings.solver_iterations;
        parameters.length_unit = LENGTH_UNIT_M;
        parameters.normalized_prediction_distance = settings.prediction_m / LENGTH_UNIT_M;
        parameters.contact_softness.natural_frequency = settings.contact_frequency_hz;
        parameters.static_contact_softness.natural_frequency = 2.0 * settings.contact_frequency_hz;
        parameters.friction_in_bias_pass = settings.friction_while_separating;
        // Merged manifolds and stale contacts make vessels of many wedges jitter for ever; without both, all families come to rest.
        parameters.contact_clustering = false;
        parameters.normalized_contact_recycle_distance = 0.01;
        parameters.contact_recycling = settings.recycled_contacts;
        Self { inner, objects: Vec::new(), fixtures: Vec::new(), settings }
    }

    /// Adds something that never moves.
    pub fn add_fixture(&mut self, shape: SharedShape, world_from_fixture: &Isometry3<f64>, friction: f32) {
        let body = RigidBodyBuilder::fixed().pose(convert::pose(world_from_fixture));
        let (handle, _) = self.inner.insert(body, ColliderBuilder::new(shape).friction(friction));
        self.fixtures.push(handle);
    }

    /// Adds an object at rest; its index is the number of objects before it.
    pub fn add_object(&mut self, shape: &ObjectShape, world_from_object: &Isometry3<f64>) -> usize {
        let body = RigidBodyBuilder::dynamic()
            .pose(convert::pose(world_from_object))
            // Sleep would freeze what creeps, and let go of what is held still in the air.
            .can_sleep(false)
            .angular_damping(self.settings.angular_damping)
            .linear_damping(self.settings.linear_damping);
        let collider = ColliderBuilder::new(shape.collider()).mass(shape.mass_kg).friction(shape.friction);
        let (handle, _) = self.inner.insert(body, collider);
        self.objects.push(handle);
        self.objects.len() - 1
    }

    /// The engine itself, for the robot's joints and bodies.
    pub(crate) fn engine(&mut self) -> &mut PhysicsWorld {
        &mut self.inner
    }

    /// The step length, seconds.
    pub fn step_s(&self) -> f32 {
        self.settings.step_s
    }

    /// One step.
    pub fn step(&mut self) {
        self.inner.step();
    }

    /// Turns gravity away from −z by `tilt_rad` towards a direction of the level plane: what a jolt of the table feels like.
    pub fn tilt_gravity(&mut self, tilt_rad: f32, azimuth_rad: f32) {
        let level = GRAVITY_M_S2 * tilt_rad.sin();
        self.inner.gravity = Vector::new(level * azimuth_rad.cos(), level * azimuth_rad.sin(), -GRAVITY_M_S2 * tilt_rad.cos());
    }

    /// Where object `index` is.
    pub fn world_from_object(&self, index: usize) -> Isometry3<f64> {
        convert::isometry(self.inner.bodies[self.objects[index]].position())
    }

    /// Puts object `index` somewhere, at rest.
    pub fn place_object(&mut self, index: usize, world_from_object: &Isometry3<f64>) {
        let body = &mut self.inner.bodies[self.objects[index]];
        body.set_position(convert::pose(world_from_object), true);
        body.set_linvel(Vector::ZERO, true);
        body.set_angvel(Vector::ZERO, true);
    }

    /// Where all objects are, in the order they were added.
    pub fn poses(&self) -> Vec<Isometry3<f64>> {
        (0..self.objects.len()).map(|i| self.world_from_object(i)).collect()
    }

    /// The pairs of things that touched in the last step, each pair and all of them in order. Fixtures are not tested against each other.
    pub fn contacts(&self) -> Vec<[Touchable; 2]> {
        /// Contacts are foreseen before they happen; these do.
        const TOUCHING_M: f32 = 0.0005;
        let touches = |pair: &ContactPair| pair.find_deepest_contact().is_some_and(|(_, contact)| contact.dist <= TOUCHING_M);
        let what = |collider: ColliderHandle| {
            let body = self.inner.colliders.get(collider)?.parent()?;
            let at = |handles: &[RigidBodyHandle]| handles.iter().position(|h| *h == body);
            let fixture = || at(&self.fixtures).map(Touchable::Fixture);
            Some(at(&self.objects).map(Touchable::Object).or_else(fixture).unwrap_or(Touchable::Robot))
        };
        let touching = self.inner.contact_pairs().filter(|pair| touches(pair));
        let mut pairs: Vec<[Touchable; 2]> = touching
            .filter_map(|pair| {
                let mut both = [what(pair.collider1)?, what(pair.collider2)?];
                both.sort_unstable();
                Some(both)
            })
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        pairs
    }

    /// The fastest linear (m/s) and angular (rad/s) speed of any object.
    pub fn fastest(&self) -> (f32, f32) {
        self.speeds().fold((0.0, 0.0), |(linear, angular), (v, w)| (linear.max(v), angular.max(w)))
    }

    /// The first object that is faster than what counts as rest.
    pub fn first_moving(&self, rest: &RestSettings) -> Option<usize> {
        self.speeds().position(|(linear, angular)| linear > rest.linear_m_s || angular > rest.angular_rad_s)
    }

    fn speeds(&self) -> impl Iterator<Item = (f32, f32)> + '_ {
        self.objects.iter().map(|h| &self.inner.bodies[*h]).map(|body| (body.linvel().length(), body.angvel().length()))
    }

    /// Takes so many steps, or fewer where everything has come to rest before and `rest` is given.
    pub fn run(&mut self, steps: usize, rest: Option<&RestSettings>) {
        let mut still = 0;
        for _ in 0..steps {
            self.step();
            still = if rest.is_some_and(|rest| self.first_moving(rest).is_none()) { still + 1 } else { 0 };
            if rest.is_some_and(|rest| still >= rest.steps) {
                break;
            }
        }
    }

    /// Steps until everything rests, or until `rest.max_steps`; the number of steps taken, `None` when something still moves.
    pub fn settle(&mut self, rest: &RestSettings) -> Option<usize> {
        self.settle_above(rest, f64::NEG_INFINITY).ok()
    }

    /// Steps until everything rests; the number of steps taken.
    ///
    /// # Errors
    /// [`Unrest`] when an object falls below `lost_below_m`, or one still moves after `rest.max_steps`.
    pub fn settle_above(&mut self, rest: &RestSettings, lost_below_m: f64) -> Result<usize, Unrest> {
        const LOOK_EVERY: usize = 12;
        let mut still = 0;
        let mut rested = None;
        for taken in 1..=rest.max_steps {
            if taken == rest.calming_after {
                self.set_angular_damping(rest.calming_damping);
            }
            self.step();
            if taken % LOOK_EVERY == 0
                && let Some(index) = (0..self.objects.len()).find(|&i| self.world_from_object(i).translation.z < lost_below_m)
            {
                return Err(Unrest::Lost { index });
            }
            still = if self.first_moving(rest).is_none() { still + 1 } else { 0 };
            if still >= rest.steps {
                rested = Some(taken);
                break;
            }
        }
        self.set_angular_damping(self.settings.angular_damping);
        rested.ok_or_else(|| Unrest::Moving { index: self.first_moving(rest).unwrap_or(0) })
    }

    fn set_angular_damping(&mut self, damping: f32) {
        for handle in &self.objects {
            self.inner.bodies[*handle].set_angular_damping(damping);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::objects::Family;

    fn table(world: &mut World) {
        world.add_fixture(SharedShape::cuboid(1.0, 1.0, 0.05), &Isometry3::translation(0.0, 0.0, -0.05), 0.6);
    }

    #[test]
    fn what_stands_upright_stays_where_it_is() {
        let mut rng = Pcg64::seed_from_u64(4);
        for family in Family::ALL {
            let shape = family.sample(1.0, &mut rng);
            let mut world = World::new(PhysicsSettings::default());
            table(&mut world);
            let start = Isometry3::translation(0.0, 0.0, shape.half_extents_m.z);
            world.add_object(&shape, &start);
            let steps = world.settle(&RestSettings::default());
            let moved = (world.world_from_object(0).translation.vector - start.translation.vector).norm();
            let tilt = world.world_from_object(0).transform_vector(&Vector3::z()).angle(&Vector3::z());
            assert!(steps.is_some(), "{family:?} comes to rest");
            assert!(moved < 0.003 && tilt < 0.03, "{family:?} moved {moved} m and tilted {tilt} rad");
        }
    }

    #[test]
    fn what_stands_on_something_touches_that_alone() {
        let mut rng = Pcg64::seed_from_u64(4);
        let shape = Family::Box.sample(1.0, &mut rng);
        let mut world = World::new(PhysicsSettings::default());
        table(&mut world);
        let height = shape.half_extents_m.z;
        world.add_object(&shape, &Isometry3::translation(0.0, 0.0, height));
        world.add_object(&shape, &Isometry3::translation(0.5, 0.0, height + 0.3));
        world.settle_above(&RestSettings { max_steps: 20, ..RestSettings::default() }, f64::NEG_INFINITY).ok();
        assert_eq!(world.contacts(), [[Touchable::Fixture(0), Touchable::Object(0)]], "the other one still falls");
    }

    #[test]
    fn the_same_world_gives_the_same_bits() {
        let run = || {
            let mut rng = Pcg64::seed_from_u64(5);
            let mut world = World::new(PhysicsSettings::default());
            table(&mut world);
            for i in 0..4 {
                let shape = Family::ALL[i * 2].sample(1.0, &mut rng);
                let turn = nalgebra::UnitQuaternion::from_euler_angles(0.3 * i as f64, 0.5, 0.0);
                world.add_object(
                    &shape,
                    &Isometry3::from_parts(nalgebra::Translation3::new(0.01 * i as f64, 0.0, 0.2 + 0.3 * i as f64), turn),
                );
            }
            world.settle(&RestSettings::default());
            world.poses()
        };
        assert_eq!(run(), run());
    }
}
