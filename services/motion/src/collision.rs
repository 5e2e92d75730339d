//! Whether the arm, with or without something in its hand, is free at given joint angles.
//!
//! The robot is its 59 spheres; what it carries is the observed points of the object, each a small sphere, fixed to the grasp centre.
//! The foot is left out against the scene: it never moves, and the table may well touch it.

use nalgebra::{Isometry3, Point3, Vector3};
use repose_geometry::cloud;
use repose_panda::{Frame, Joints, LIMITS, Link, LinkFrames, SPHERE_LINKS, self_collides, spheres_in_base};

use crate::obstacles::Obstacles;

/// An object between the fingers.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldObject {
    points_in_tcp: Vec<Vector3<f64>>,
    radius_m: f64,
}

impl HeldObject {
    /// The object whose observed points (world frame) are held by a hand at `world_from_tcp`.
    ///
    /// The points are thinned to one a `spacing_m`; each stands for a ball of `radius_m`.
    pub fn new(points_in_world: &[Point3<f32>], world_from_tcp: &Isometry3<f64>, spacing_m: f32, radius_m: f64) -> Self {
        let tcp_from_world = world_from_tcp.inverse();
        let thinned = cloud::voxel_downsampled(points_in_world, spacing_m);
        Self { points_in_tcp: thinned.iter().map(|p| (tcp_from_world * p.cast::<f64>()).coords).collect(), radius_m }
    }
}

/// What is in the way.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Contact {
    /// A joint (from 0) is outside its position limits.
    #[error("joint {0} is outside its limits")]
    Limits(usize),
    /// The arm touches itself.
    #[error("the arm touches itself")]
    Itself,
    /// A link touches the scene.
    #[error("{0:?} touches the scene")]
    Scene(Link),
    /// The held object touches the scene.
    #[error("the held object touches the scene")]
    HeldScene,
    /// The held object touches the arm.
    #[error("the held object touches {0:?}")]
    HeldArm(Link),
}

/// Judges configurations against a set of obstacles.
#[derive(Debug, Clone, Copy)]
pub struct CollisionChecker<'a> {
    /// Where the robot stands.
    pub world_from_base: Frame,
    /// The obstacles, each of which must not be touched.
    pub obstacles: &'a [&'a Obstacles],
    /// What is added to every sphere of the robot against the scene, metres.
    pub padding_m: f64,
    /// How far the fingers are apart, metres.
    pub finger_opening_m: f64,
    /// What is in the hand.
    pub held: Option<&'a HeldObject>,
}

impl CollisionChecker<'_> {
    /// Whether nothing is in the way at these joint angles.
    pub fn is_free(&self, joints: &Joints) -> bool {
        self.contact(joints).is_none()
    }

    /// The first thing that is in the way, or `None`.
    pub fn contact(&self, joints: &Joints) -> Option<Contact> {
        if let Some(joint) = LIMITS.outside(joints, 0.0) {
            return Some(Contact::Limits(joint));
        }
        let frames = LinkFrames::at(joints);
        let spheres = spheres_in_base(&frames, self.finger_opening_m);
        // The hand is what gets near things: asking from there inwards finds contacts sooner.
        for (sphere, link) in spheres.iter().zip(SPHERE_LINKS).skip(Link::Link0.sphere_range().end).rev() {
            let center = self.world_from_base.carry(&sphere.center.coords);
            if self.obstacles.iter().any(|o| o.touches(&center, sphere.radius_m + self.padding_m)) {
                return Some(Contact::Scene(link));
            }
        }
        if self_collides(&spheres) {
            return Some(Contact::Itself);
        }
        let held = self.held?;
        let tcp = frames.tcp();
        let arm = Link::Link0.sphere_range().start..Link::Link5.sphere_range().end;
        for point in &held.points_in_tcp {
            let in_base = tcp.carry(point);
            let in_world = self.world_from_base.carry(&in_base.coords);
            if self.obstacles.iter().any(|o| o.touches(&in_world, held.radius_m)) {
                return Some(Contact::HeldScene);
            }
            for (sphere, link) in spheres[arm.clone()].iter().zip(SPHERE_LINKS) {
                if (sphere.center - in_base).norm() < sphere.radius_m + held.radius_m {
                    return Some(Contact::HeldArm(link));
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::obstacles::ObstacleSettings;
    use repose_panda::{READY, base_from_tcp};

    fn checker<'a>(obstacles: &'a [&'a Obstacles], held: Option<&'a HeldObject>) -> CollisionChecker<'a> {
        CollisionChecker { world_from_base: Frame::BASE, obstacles, padding_m: 0.005, finger_opening_m: 0.08, held }
    }

    #[test]
    fn a_point_at_the_fingertip_is_a_contact_and_one_out_of_reach_is_not() {
        let tip = base_from_tcp(&READY) * Point3::new(0.0, 0.048, 0.0);
        let near = Obstacles::new(&[tip.cast::<f32>()], &[], &ObstacleSettings::default());
        assert_eq!(checker(&[&near], None).contact(&READY), Some(Contact::Scene(Link::LeftFinger)));
        let far = Obstacles::new(&[Point3::new(-1.0, 0.0, 0.5)], &[], &ObstacleSettings::default());
        assert!(checker(&[&far], None).is_free(&READY));
    }

    #[test]
    fn what_is_held_counts_as_part_of_the_robot() {
        let world_from_tcp = base_from_tcp(&READY);
        let below = world_from_tcp * Point3::new(0.0, 0.0, 0.15);
        let bottle = HeldObject::new(&[below.cast::<f32>()], &world_from_tcp, 0.01, 0.005);
        let point = Obstacles::new(&[below.cast::<f32>()], &[], &ObstacleSettings::default());
        assert!(checker(&[&point], None).is_free(&READY));
        assert_eq!(checker(&[&point], Some(&bottle)).contact(&READY), Some(Contact::HeldScene));
    }
}
