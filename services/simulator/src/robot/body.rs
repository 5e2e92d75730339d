//! The Panda to look at: closed meshes of its links, hand and fingers, where its joints put them.
//!
//! A link is what its spheres ([`repose_panda::spheres`]) have between them: spheres that overlap deeply are two places of one rounded piece,
//! and their hull is drawn. The hulls stand out of the spheres by up to 12 mm, as the real arm's surface does in places. The fingers are
//! the boxes that grasp.

use std::sync::LazyLock;

use nalgebra::{Isometry3, Point3, Vector3};
use parry3d::transformation::try_convex_hull;
use rapier3d::math::Vector;
use repose_geometry::TriMesh;
use repose_geometry::sampling::directions;
use repose_panda::spheres::FINGER_M;
use repose_panda::{Joints, LINKS, Link, LinkFrames, PlacedSphere, visible_spheres_in_link};

use super::hand::FINGER_HALF_M;
use crate::objects::body::cuboid_mesh;
use crate::render::Drawable;

/// Points on a sphere whose hull stands for it: 1 mm inside it at most, for the arm's largest.
const SPHERE_POINTS: usize = 120;
/// Two spheres of a link are one piece where their centres are at most this many radii of the smaller one apart.
const ONE_PIECE_RADII: f64 = 1.3;
const ARM_COLOR: [u8; 3] = [235, 235, 235];
const FINGER_COLOR: [u8; 3] = [120, 122, 126];

/// The meshes of links 0 to 7 and of the hand, in their frames and in the order of [`LINKS`].
static MESHES: LazyLock<Vec<TriMesh>> =
    LazyLock::new(|| LINKS.iter().take_while(|link| **link <= Link::Hand).map(|l| link_mesh(*l)).collect());

/// A finger, in its own frame: it opens towards +y.
static FINGER: LazyLock<TriMesh> = LazyLock::new(|| {
    let [_, fy, fz] = FINGER_HALF_M;
    cuboid_mesh(Vector3::from(FINGER_HALF_M)).transformed(&Isometry3::translation(0.0, fy, fz))
});

/// The whole robot, its base at the world's origin, each finger so far from the middle (metres).
pub fn drawables(joints: &Joints, fingers_m: [f32; 2]) -> Vec<Drawable<'static>> {
    let frames = LinkFrames::at(joints);
    let hand = frames.hand.isometry();
    let poses = std::iter::once(Isometry3::identity()).chain(frames.links.iter().map(|frame| frame.isometry())).chain([hand]);
    let links = MESHES.iter().zip(poses).map(|(mesh, pose)| Drawable { mesh, world_from_mesh: pose, label: 0, color: ARM_COLOR });
    let half_turn = Isometry3::rotation(Vector3::z() * std::f64::consts::PI);
    let fingers = [Isometry3::identity(), half_turn].into_iter().zip(fingers_m).map(|(turn, from_middle_m)| {
        let hand_from_finger = turn * Isometry3::translation(0.0, f64::from(from_middle_m), FINGER_M);
        Drawable { mesh: &FINGER, world_from_mesh: hand * hand_from_finger, label: 0, color: FINGER_COLOR }
    });
    links.chain(fingers).collect()
}

/// The pieces of a link.
fn link_mesh(link: Link) -> TriMesh {
    let spheres: Vec<PlacedSphere> = visible_spheres_in_link(link).collect();
    let mut mesh = TriMesh::default();
    for (i, a) in spheres.iter().enumerate() {
        let is_piece = |b: &PlacedSphere| (a.center - b.center).norm() <= ONE_PIECE_RADII * a.radius_m.min(b.radius_m);
        let mut others = spheres.iter().enumerate().filter(|(j, b)| *j != i && is_piece(b)).peekable();
        if others.peek().is_none() {
            mesh.append(&hull(&on_sphere(a).collect::<Vec<_>>()));
        }
        for (_, b) in others.filter(|(j, _)| *j > i) {
            mesh.append(&hull(&on_sphere(a).chain(on_sphere(b)).collect::<Vec<_>>()));
        }
    }
    mesh
}

/// Points spread evenly over a sphere.
fn on_sphere(sphere: &PlacedSphere) -> impl Iterator<Item = Vector> {
    directions(SPHERE_POINTS).map(move |direction| {
        let at = sphere.center + sphere.radius_m * direction;
        Vector::new(at.x as f32, at.y as f32, at.z as f32)
    })
}

/// The convex hull of points; nothing where they have no volume.
fn hull(points: &[Vector]) -> TriMesh {
    try_convex_hull(points).map_or_else(
        |_| TriMesh::default(),
        |(corners, triangles)| TriMesh { vertices: corners.iter().map(|v| Point3::new(v.x, v.y, v.z)).collect(), triangles },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_panda::{READY, visible_spheres_in_base};

    #[test]
    fn every_sphere_shows_and_the_surface_stands_out_of_none_further_than_the_real_arms() {
        let opening_m = 0.06;
        let spheres = visible_spheres_in_base(&LinkFrames::at(&READY), opening_m);
        let drawn = drawables(&READY, [0.03, 0.03]);
        assert_eq!(drawn.len(), LINKS.len());
        // Hulls stand out where they span, between their corners.
        let places = |[a, b, c]: [Point3<f32>; 3]| [a, nalgebra::center(&a, &b), Point3::from((a.coords + b.coords + c.coords) / 3.0)];
        let of_mesh = |mesh: &'static TriMesh| (0..mesh.triangles.len()).flat_map(move |i| places(mesh.corners(i)));
        let surface: Vec<Point3<f64>> =
            drawn.iter().flat_map(|d| of_mesh(d.mesh).map(|p| d.world_from_mesh * p.cast::<f64>()).collect::<Vec<_>>()).collect();
        let outside_m = |p: &Point3<f64>| spheres.iter().map(|s| (p - s.center).norm() - s.radius_m).fold(f64::INFINITY, f64::min);
        let furthest_m = surface.iter().map(outside_m).fold(0.0, f64::max);
        assert!(furthest_m < 0.015, "{furthest_m} m");
        for sphere in &spheres[..Link::LeftFinger.sphere_range().start] {
            let nearest_m = surface.iter().map(|p| ((p - sphere.center).norm() - sphere.radius_m).abs()).fold(f64::INFINITY, f64::min);
            assert!(nearest_m < 0.01, "a sphere of {} m at {} is {nearest_m} m from the surface", sphere.radius_m, sphere.center);
        }
    }
}
