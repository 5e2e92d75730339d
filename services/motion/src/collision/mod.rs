//! Whether the arm, with or without something in its hand, is free at given joint angles and along edges between them.
//!
//! The robot is its 59 spheres; what it carries is the observed points of the object, each a small sphere, fixed to the grasp centre.
//! The foot is left out against the scene: it never moves, and the table may well touch it. Edges and many configurations go through the
//! vector kernel ([`block`]); [`CollisionChecker::contact`] says in double precision what is in the way.

mod block;
mod body;
mod edge;
mod held;

use repose_panda::{JointLimits, Joints, LIMITS, Link, LinkFrame, LinkFrames, SPHERE_LINKS, self_collides, spheres_in_base};
use repose_simd::InstructionSet;

use crate::obstacles::{ObstacleShape, Obstacles};
use block::{BLOCK, CollisionQuery, CollisionScene, Configurations, Near, ask};
use body::ArmBody;
pub use edge::EdgeSettings;
pub use held::{HeldCloud, neighbouring};

/// What is in the way.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Contact {
    /// A joint (from 0) is outside the position limits.
    #[error("joint {0} is outside the limits that motions are planned within")]
    Limits(usize),
    /// The arm touches itself.
    #[error("the arm touches itself")]
    Itself,
    /// A link touches the scene.
    #[error("{0:?} touches the scene")]
    Scene(Link),
    /// A link enters a keep-out zone (from 0, as they are configured).
    #[error("{0:?} enters keep_out[{1}]")]
    Zone(Link, usize),
    /// What is held enters a keep-out zone.
    #[error("the held object enters keep_out[{0}]")]
    HeldZone(usize),
    /// The held object touches the scene.
    #[error("the held object touches the scene")]
    HeldScene,
    /// The held object touches the arm.
    #[error("the held object touches {0:?}")]
    HeldArm(Link),
}

/// How far the palm stands out of its spheres, metres: it is a box of 63 by 204 by 66 mm, whose edges are up to 8 mm outside of them, and its four
/// corners 14, of which the usual padding covers the rest.
pub const PALM_OUT_M: f64 = 0.008;

/// The arm as the collision checker models it: base pose, padding, finger opening, joint limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmCollisionSettings {
    /// Where the robot stands.
    pub world_from_base: LinkFrame,
    /// What is added to every sphere of the robot against the scene, metres. Default 0.003.
    pub padding_m: f64,
    /// What is added to the palm's spheres beside that, metres. Default 0; [`PALM_OUT_M`] for who works closely beside things.
    pub palm_out_m: f64,
    /// How far the fingers are apart, metres. Default 0.08.
    pub finger_opening_m: f64,
    /// The position limits. Default: the official ones.
    pub limits: JointLimits,
}

impl Default for ArmCollisionSettings {
    fn default() -> Self {
        let finger_opening_m = repose_panda::FINGER_OPENING_MAX_M;
        Self { world_from_base: LinkFrame::BASE, padding_m: 0.003, palm_out_m: 0.0, finger_opening_m, limits: LIMITS }
    }
}

/// Judges configurations and edges against a set of obstacles.
#[derive(Debug, Clone)]
pub struct CollisionChecker<'a> {
    arm: ArmCollisionSettings,
    obstacles: &'a [&'a Obstacles],
    held: Option<HeldCloud>,
    edge: EdgeSettings,
    shapes: Vec<&'a ObstacleShape>,
    body: ArmBody,
    instruction_set: InstructionSet,
}

impl<'a> CollisionChecker<'a> {
    /// A checker of the arm, with `held` in its hand, against obstacles each of which must not be touched.
    pub fn new(arm: ArmCollisionSettings, obstacles: &'a [&'a Obstacles], held: Option<&HeldCloud>) -> Self {
        Self {
            arm,
            obstacles,
            held: held.cloned(),
            edge: EdgeSettings::default(),
            shapes: obstacles.iter().flat_map(|o| o.shapes()).collect(),
            body: ArmBody::new(&arm, held),
            instruction_set: InstructionSet::detect(),
        }
    }

    /// The same with another instruction set of this machine: results of different ones differ in their last bits.
    #[must_use]
    pub fn with_instruction_set(self, set: InstructionSet) -> Self {
        Self { instruction_set: set, ..self }
    }

    /// The arm's position limits.
    pub fn limits(&self) -> &JointLimits {
        &self.arm.limits
    }

    /// Whether there is something in the hand.
    pub fn holds(&self) -> bool {
        self.held.is_some()
    }

    /// Whether nothing is in the way at these joint angles.
    pub fn is_free(&self, joints: &Joints) -> bool {
        self.are_free(std::slice::from_ref(joints))[0]
    }

    /// Whether nothing is in the way at each of these joint angles.
    pub fn are_free(&self, configurations: &[Joints]) -> Vec<bool> {
        let world = self.world();
        let mut near = Near::everything(&world);
        let mut free = Vec::with_capacity(configurations.len());
        for block in configurations.chunks(BLOCK) {
            let lanes: Configurations = std::array::from_fn(|i| std::array::from_fn(|k| block[k.min(block.len() - 1)][i] as f32));
            let mut question = CollisionQuery { configurations: &lanes, motion_m: &[], any_block_ends: block.len() == 1, near: &mut near };
            let verdict = ask(self.instruction_set, &world, &mut question);
            let judged = block.iter().enumerate().map(|(k, q)| verdict.blocked >> k & 1 == 0 && self.arm.limits.contains(q, 0.0));
            free.extend(judged);
        }
        free
    }

    /// The first thing that is in the way, or `None`.
    pub fn contact(&self, joints: &Joints) -> Option<Contact> {
        if let Some(joint) = self.arm.limits.outside(joints, 0.0) {
            return Some(Contact::Limits(joint));
        }
        let frames = LinkFrames::at(joints);
        let spheres = spheres_in_base(&frames, self.arm.finger_opening_m);
        // The hand is what gets near things: asking from there inwards finds contacts sooner.
        for (sphere, link) in spheres.iter().zip(SPHERE_LINKS).skip(Link::Link0.sphere_range().end).rev() {
            let center = self.arm.world_from_base.carry(&sphere.center.coords);
            let out_m = if link == Link::Hand { self.arm.palm_out_m } else { 0.0 };
            let radius_m = sphere.radius_m + self.arm.padding_m + out_m;
            if let Some(obstacles) = self.obstacles.iter().find(|o| o.touches(&center, radius_m)) {
                let zone = obstacles.zone_touched(&center, radius_m);
                return Some(zone.map_or(Contact::Scene(link), |zone| Contact::Zone(link, zone)));
            }
        }
        if self_collides(&spheres) {
            return Some(Contact::Itself);
        }
        let held = self.held.as_ref()?;
        let tcp = frames.tcp();
        let arm = Link::Link0.sphere_range().start..Link::Link5.sphere_range().end;
        for point in &held.points_in_tcp {
            let in_base = tcp.carry(point);
            let in_world = self.arm.world_from_base.carry(&in_base.coords);
            if let Some(obstacles) = self.obstacles.iter().find(|o| o.touches(&in_world, held.radius_m)) {
                return Some(obstacles.zone_touched(&in_world, held.radius_m).map_or(Contact::HeldScene, Contact::HeldZone));
            }
            for (sphere, link) in spheres[arm.clone()].iter().zip(SPHERE_LINKS) {
                if (sphere.center - in_base).norm() < sphere.radius_m + held.radius_m {
                    return Some(Contact::HeldArm(link));
                }
            }
        }
        None
    }

    fn world(&self) -> CollisionScene<'_> {
        CollisionScene { world_from_base: &self.arm.world_from_base, body: &self.body, obstacles: self.obstacles, shapes: &self.shapes }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::obstacles::ObstacleSettings;
    use nalgebra::{Isometry3, Point3, Vector3};
    use proptest::prelude::*;
    use repose_panda::{READY, base_from_tcp};

    fn checker<'a>(obstacles: &'a [&'a Obstacles], held: Option<&'a HeldCloud>) -> CollisionChecker<'a> {
        CollisionChecker::new(ArmCollisionSettings { padding_m: 0.005, ..ArmCollisionSettings::default() }, obstacles, held)
    }

    #[test]
    fn a_point_at_the_fingertip_is_a_contact_and_one_out_of_reach_is_not() {
        let tip = base_from_tcp(&READY) * Point3::new(0.0, 0.048, 0.0);
        let near = Obstacles::new(&[tip.cast::<f32>()], &[], &ObstacleSettings::default());
        assert_eq!(checker(&[&near], None).contact(&READY), Some(Contact::Scene(Link::LeftFinger)));
        assert!(!checker(&[&near], None).is_free(&READY));
        let far = Obstacles::new(&[Point3::new(-1.0, 0.0, 0.5)], &[], &ObstacleSettings::default());
        assert!(checker(&[&far], None).is_free(&READY));
    }

    #[test]
    fn what_is_held_counts_as_part_of_the_robot() {
        let world_from_tcp = base_from_tcp(&READY);
        let below = world_from_tcp * Point3::new(0.0, 0.0, 0.15);
        let bottle = HeldCloud::new(&[below.cast::<f32>()], &world_from_tcp, 0.005);
        let point = Obstacles::new(&[below.cast::<f32>()], &[], &ObstacleSettings::default());
        assert!(checker(&[&point], None).is_free(&READY));
        assert_eq!(checker(&[&point], Some(&bottle)).contact(&READY), Some(Contact::HeldScene));
        assert!(!checker(&[&point], Some(&bottle)).is_free(&READY));
    }

    fn joints() -> impl Strategy<Value = Joints> {
        prop::array::uniform7(0.01..0.99f64).prop_map(|u| LIMITS.between(&u))
    }

    /// A few solids and a sprinkle of points around the arm.
    fn worlds() -> impl Strategy<Value = (Obstacles, Obstacles)> {
        let place = || prop::array::uniform3(-0.7..0.7f64);
        let solid = (place(), place(), prop::array::uniform3(0.02..0.3f64), any::<bool>()).prop_map(|(at, turn, size, round)| {
            let pose = Isometry3::new(Vector3::from(at) + Vector3::z() * 0.4, Vector3::from(turn));
            if round { ObstacleShape::cylinder(pose, size[0] / 2.0, size[1]) } else { ObstacleShape::cuboid(pose, Vector3::from(size)) }
        });
        let points = prop::collection::vec(prop::array::uniform3(-0.8..0.8f32), 0..40);
        (prop::collection::vec(solid, 0..70), points).prop_map(|(solids, points)| {
            let points: Vec<Point3<f32>> = points.into_iter().map(Point3::from).collect();
            (Obstacles::solids(solids), Obstacles::new(&points, &[], &ObstacleSettings::default()))
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn every_instruction_set_agrees_with_double_precision(
            (solids, cloud) in worlds(), many in prop::collection::vec(joints(), 20), held in prop::bool::ANY,
        ) {
            let bottle = HeldCloud::new(&[Point3::new(0.0, 0.0, 0.1), Point3::new(0.0, 0.02, 0.05)], &Isometry3::identity(), 0.004);
            let obstacles = [&solids, &cloud];
            let arm = ArmCollisionSettings { world_from_base: LinkFrame::of(&Isometry3::new(Vector3::new(0.1, -0.05, 0.02), Vector3::z() * 0.4)), ..ArmCollisionSettings::default() };
            let held = held.then_some(&bottle);
            let exact = CollisionChecker::new(arm, &obstacles, held);
            // Padding is the arm's; what is held has a radius of its own to widen.
            let swollen = held.map(|h| HeldCloud { radius_m: h.radius_m + 1e-4, ..h.clone() });
            let wider = CollisionChecker::new(ArmCollisionSettings { padding_m: arm.padding_m + 1e-4, ..arm }, &obstacles, swollen.as_ref());
            for set in InstructionSet::available() {
                let free = CollisionChecker::new(arm, &obstacles, held).with_instruction_set(set).are_free(&many);
                for (q, free) in many.iter().zip(free) {
                    // Nearer than single precision tells apart, either answer will do; `touches itself` has no padding to widen.
                    prop_assert!(!free || exact.contact(q).is_none(), "{set:?} {:?}", exact.contact(q));
                    prop_assert!(free || wider.contact(q).is_some() || is_close_to_itself(q, held), "{set:?}");
                }
            }
        }

        #[test]
        fn a_free_edge_is_free_wherever_it_is_asked((solids, cloud) in worlds(), a in joints(), b in joints(), reach in 0.05..1.0f64) {
            let obstacles = [&solids, &cloud];
            let exact = CollisionChecker::new(ArmCollisionSettings::default(), &obstacles, None);
            let b = crate::path::joint_path::between(&a, &b, reach);
            for set in InstructionSet::available() {
                if exact.clone().with_instruction_set(set).edge_is_free(&a, &b) {
                    for k in 0..=200 {
                        let q = crate::path::joint_path::between(&a, &b, f64::from(k) / 200.0);
                        prop_assert_eq!(exact.contact(&q), None);
                    }
                }
            }
        }
    }

    /// Whether the arm nearly touches itself: a slight swell of the spheres would make it.
    fn is_close_to_itself(q: &Joints, held: Option<&HeldCloud>) -> bool {
        let spheres = spheres_in_base(&LinkFrames::at(q), ArmCollisionSettings::default().finger_opening_m).map(|mut s| {
            s.radius_m += 1e-4;
            s
        });
        let swollen = held.map(|h| HeldCloud { radius_m: h.radius_m + 1e-4, ..h.clone() });
        let world = ArmCollisionSettings { padding_m: 0.0, ..ArmCollisionSettings::default() };
        self_collides(&spheres) || swollen.is_some_and(|h| CollisionChecker::new(world, &[], Some(&h)).contact(q).is_some())
    }
}
