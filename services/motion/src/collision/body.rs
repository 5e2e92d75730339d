//! The arm as the vector kernel wants it: groups of spheres that move together, each with a ball around it and its levers.
//!
//! A group is one link, the gripper, or a handful of neighbouring points of the held object. The ball around a group is asked first; most
//! groups are far from everything and end there. The foot never moves: it is asked only against the rest of the arm.

use nalgebra::{Isometry3, Vector3};
use repose_panda::lane_frames::LANE_ROUNDING_M;
use repose_panda::spheres::{FINGER_M, Link};
use repose_panda::{JOINT_COUNT, SELF_COLLISION_PAIRS, flange_from_hand, hand_from_tcp, kinematics, levers, spheres_in_link};

use super::ArmCollisionSettings;
use super::held::{HELD_GROUP, HeldCloud};

/// A sphere of a group, in the group's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sphere {
    pub center: [f32; 3],
    /// Radius against the world, padding included, metres.
    pub world_m: f32,
    /// Radius against the rest of the arm, metres.
    pub self_m: f32,
}

/// Spheres that move together.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Group {
    /// Which of the frames of links 1 to 7 it moves with, from 0; none for the foot.
    pub frame: Option<usize>,
    pub spheres: Vec<Sphere>,
    /// A ball around all spheres.
    pub ball: Sphere,
    /// The largest lever of its spheres for each joint, metres.
    pub levers: [f32; JOINT_COUNT],
}

/// Two groups that can touch, and the first joint between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GroupPair {
    pub near: usize,
    pub far: usize,
    /// Joints from this one on move `far` against `near`.
    pub joint: usize,
}

/// The arm and the object it holds, as groups of spheres.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ArmBody {
    /// What moves, in the order in which it is asked: the gripper and what it holds first, as they get nearest to things; the foot last.
    pub groups: Vec<Group>,
    pub pairs: Vec<GroupPair>,
}

impl ArmBody {
    pub fn new(arm: &ArmCollisionSettings, held: Option<&HeldCloud>) -> Self {
        let padding_m = arm.padding_m;
        let mut groups = vec![gripper(arm)];
        let link7_from_tcp = link7_from_hand() * hand_from_tcp();
        if let Some(held) = held {
            let points: Vec<Vector3<f64>> =
                held.points_in_tcp.iter().map(|p| (link7_from_tcp * nalgebra::Point3::from(*p)).coords).collect();
            halved(&points, &mut |cluster| {
                groups.push(Group::new(7, cluster.iter().map(|p| (*p, held.radius_m, 0.0))));
            });
        }
        let held_groups = 1..groups.len();
        let links = [Link::Link7, Link::Link6, Link::Link5, Link::Link4, Link::Link3, Link::Link2, Link::Link1, Link::Link0];
        let first_link = groups.len();
        for link in links {
            groups.push(Group::new(link as usize, spheres_in_link(link).map(|s| (s.center.coords, s.radius_m, padding_m))));
        }
        let group_of = |link: Link| if link as usize > 7 { 0 } else { first_link + 7 - link as usize };
        let mut pairs: Vec<GroupPair> = Vec::new();
        for (near, far) in SELF_COLLISION_PAIRS {
            let pair = GroupPair { near: group_of(*near), far: group_of(*far), joint: *near as usize };
            if !pairs.contains(&pair) {
                pairs.push(pair);
            }
        }
        for far in held_groups {
            let near_links = [Link::Link0, Link::Link1, Link::Link2, Link::Link3, Link::Link4, Link::Link5];
            pairs.extend(near_links.map(|near| GroupPair { near: group_of(near), far, joint: near as usize }));
        }
        Self { groups, pairs }
    }
}

impl Group {
    /// Spheres of a link (0 to 7) given by centre in the link's frame, radius, and what is added to that against the world.
    fn new(link: usize, spheres: impl Iterator<Item = (Vector3<f64>, f64, f64)>) -> Self {
        let spheres: Vec<(Vector3<f64>, f64, f64)> = spheres.collect();
        let mut longest = [0.0f64; JOINT_COUNT];
        for (center, ..) in &spheres {
            let levers = levers(link, center);
            (0..JOINT_COUNT).for_each(|i| longest[i] = longest[i].max(levers[i]));
        }
        let low = spheres.iter().fold(Vector3::repeat(f64::INFINITY), |low, (c, ..)| low.inf(c));
        let high = spheres.iter().fold(Vector3::repeat(f64::NEG_INFINITY), |high, (c, ..)| high.sup(c));
        let middle = (low + high) / 2.0;
        let around = spheres.iter().map(|(c, r, _)| (c - middle).norm() + r).fold(0.0, f64::max);
        let most_m = spheres.iter().map(|(_, _, padding_m)| *padding_m).fold(0.0, f64::max);
        let sphere = |center: &Vector3<f64>, radius_m: f64, padding_m: f64| Sphere {
            center: center.map(|v| v as f32).into(),
            world_m: (radius_m + padding_m) as f32 + LANE_ROUNDING_M,
            self_m: radius_m as f32 + LANE_ROUNDING_M,
        };
        Self {
            frame: link.checked_sub(1),
            ball: sphere(&middle, around, most_m),
            spheres: spheres.iter().map(|(c, r, padding_m)| sphere(c, *r, *padding_m)).collect(),
            levers: longest.map(|v| v as f32 * (1.0 + 1e-5)),
        }
    }
}

fn link7_from_hand() -> Isometry3<f64> {
    Isometry3::translation(0.0, 0.0, kinematics::FLANGE_M) * flange_from_hand()
}

fn gripper(arm: &ArmCollisionSettings) -> Group {
    let link7_from_hand = link7_from_hand();
    let finger = |side: f64| link7_from_hand * Isometry3::translation(0.0, side * arm.finger_opening_m / 2.0, FINGER_M);
    let parts = [
        (Link::Hand, link7_from_hand, arm.padding_m + arm.palm_out_m),
        (Link::LeftFinger, finger(1.0), arm.padding_m),
        (Link::RightFinger, finger(-1.0), arm.padding_m),
    ];
    let spheres = parts
        .into_iter()
        .flat_map(|(link, pose, padding_m)| spheres_in_link(link).map(move |s| ((pose * s.center).coords, s.radius_m, padding_m)));
    Group::new(7, spheres)
}

/// Halves the points until few are left together: near ones, where they are [`neighbouring`](super::held::neighbouring).
fn halved<T>(points: &[T], each: &mut impl FnMut(&[T])) {
    if points.len() > HELD_GROUP {
        let (first, second) = points.split_at(points.len() / 2);
        halved(first, each);
        halved(second, each);
    } else if !points.is_empty() {
        each(points);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_panda::{LinkFrames, READY, SPHERE_COUNT, spheres_in_base};

    fn arm(padding_m: f64) -> ArmCollisionSettings {
        ArmCollisionSettings { padding_m, finger_opening_m: 0.06, ..ArmCollisionSettings::default() }
    }

    #[test]
    fn the_palm_stands_out_of_its_spheres_against_the_world_and_not_against_the_arm() {
        let [plain, out] = [0.0, 0.008].map(|palm_out_m| ArmBody::new(&ArmCollisionSettings { palm_out_m, ..arm(0.003) }, None));
        let palm = spheres_in_link(Link::Hand).count();
        for (i, (a, b)) in plain.groups[0].spheres.iter().zip(&out.groups[0].spheres).enumerate() {
            let more_m = if i < palm { 0.008 } else { 0.0 };
            assert!((b.world_m - a.world_m - more_m).abs() < 1e-6 && a.self_m == b.self_m, "sphere {i}");
        }
        assert!(out.groups[0].ball.world_m > plain.groups[0].ball.world_m + 0.0079);
    }

    #[test]
    fn the_groups_hold_the_spheres_of_the_arm() {
        let body = ArmBody::new(&arm(0.0), None);
        let frames = LinkFrames::at(&READY);
        let mut placed: Vec<[f64; 3]> = Vec::new();
        for group in &body.groups {
            for sphere in &group.spheres {
                let center = Vector3::from(sphere.center.map(f64::from));
                placed.push(group.frame.map_or(center, |f| frames.links[f].carry(&center).coords).into());
            }
        }
        assert_eq!(placed.len(), SPHERE_COUNT);
        for sphere in spheres_in_base(&frames, 0.06) {
            let apart = |p: &[f64; 3]| (Vector3::from(*p) - sphere.center.coords).norm();
            assert!(placed.iter().any(|p| apart(p) < 1e-6), "{sphere:?}");
        }
    }

    #[test]
    fn every_point_that_is_held_is_in_one_small_group() {
        let points = (0..100).map(|k| nalgebra::Point3::new((k % 10) as f32 * 0.01, (k / 10) as f32 * 0.01, 0.0)).collect();
        let held = HeldCloud::new(&crate::collision::neighbouring(points), &Isometry3::identity(), 0.004);
        let with = ArmBody::new(&arm(0.003), Some(&held));
        let without = ArmBody::new(&arm(0.003), None);
        let count = |body: &ArmBody| body.groups.iter().map(|g| g.spheres.len()).sum::<usize>();
        assert_eq!(count(&with) - count(&without), 100);
        assert!(with.groups[1..with.groups.len() - 8].iter().all(|g| g.spheres.len() <= HELD_GROUP && g.ball.world_m < 0.05));
    }
}
