//! What the arm looks like: a capsule or two for each link, where the joints put it. The hand has its own boxes.

use nalgebra::{Point3, Vector3};
use repose_geometry::TriMesh;
use repose_panda::{Joints, Link, LinkFrames, kinematics::Frame};

/// A link, the ends of a capsule's axis in its frame, and the capsule's radius, metres.
type Row = (Link, [f64; 3], [f64; 3], f64);

/// The capsules of Franka's robot description (`franka_description`, coarse collision model), without its safety distance.
const CAPSULES: [Row; 11] = [
    (Link::Link0, [-0.09, 0.0, 0.06], [-0.06, 0.0, 0.06], 0.06),
    (Link::Link1, [0.0, 0.0, -0.333], [0.0, 0.0, -0.05], 0.06),
    (Link::Link2, [0.0, -0.06, 0.0], [0.0, 0.06, 0.0], 0.06),
    (Link::Link3, [0.0, 0.0, -0.22], [0.0, 0.0, -0.07], 0.06),
    (Link::Link4, [0.0, -0.06, 0.0], [0.0, 0.06, 0.0], 0.06),
    (Link::Link5, [0.0, 0.0, -0.31], [0.0, 0.0, -0.21], 0.06),
    (Link::Link5, [0.0, 0.08, -0.20], [0.0, 0.08, -0.06], 0.025),
    (Link::Link6, [0.0, 0.0, -0.07], [0.0, 0.0, 0.01], 0.05),
    (Link::Link7, [0.0, 0.0, -0.06], [0.0, 0.0, 0.08], 0.04),
    (Link::Link7, [0.055, 0.0, 0.082], [0.065, 0.0, 0.082], 0.03),
    (Link::Hand, [0.0, -0.05, 0.04], [0.0, 0.05, 0.04], 0.04),
];

/// Corners around a capsule, and rings along each of its rounded ends.
const AROUND: usize = 16;
const RINGS: usize = 4;

/// The arm at its joints, base frame.
pub fn arm_mesh(joints: &Joints) -> TriMesh {
    let frames = LinkFrames::at(joints);
    let frame = |link: Link| match link {
        Link::Link0 => Frame::BASE,
        Link::Hand | Link::LeftFinger | Link::RightFinger => frames.hand,
        moved => frames.links[moved as usize - 1],
    };
    let mut mesh = TriMesh { vertices: Vec::new(), triangles: Vec::new() };
    for (link, from, to, radius_m) in CAPSULES {
        let [from, to] = [from, to].map(|end| frame(link).carry(&Vector3::from(end)));
        mesh.append(&capsule_mesh(&from, &to, radius_m));
    }
    mesh
}

/// A capsule around the axis between two points.
fn capsule_mesh(from: &Point3<f64>, to: &Point3<f64>, radius_m: f64) -> TriMesh {
    let along = (to - from).try_normalize(1e-9).unwrap_or_else(Vector3::z);
    let aside = if along.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let u = along.cross(&aside).normalize();
    let v = along.cross(&u);
    // Rings from one tip to the other; a quarter of a turn belongs to each end.
    let ring = |k: usize| {
        let (end, angle) = if k < RINGS { (from, k as f64 / RINGS as f64 - 1.0) } else { (to, (k - RINGS) as f64 / RINGS as f64) };
        let (rise, width) = (angle * std::f64::consts::FRAC_PI_2).sin_cos();
        (0..AROUND).map(move |i| {
            let (sin, cos) = (std::f64::consts::TAU * i as f64 / AROUND as f64).sin_cos();
            (end + radius_m * (along * rise + (u * cos + v * sin) * width)).cast::<f32>()
        })
    };
    let vertices: Vec<Point3<f32>> = (0..=2 * RINGS).flat_map(ring).collect();
    let at = |k: usize, i: usize| (k * AROUND + i % AROUND) as u32;
    let quads = (0..2 * RINGS).flat_map(|k| (0..AROUND).map(move |i| (k, i)));
    let triangles = quads.flat_map(|(k, i)| [[at(k, i), at(k + 1, i + 1), at(k, i + 1)], [at(k, i), at(k + 1, i), at(k + 1, i + 1)]]);
    TriMesh { vertices, triangles: triangles.collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_panda::{READY, spheres_in_base};

    #[test]
    fn a_capsule_is_as_wide_and_long_as_it_is_said_to_be() {
        let mesh = capsule_mesh(&Point3::new(0.0, 0.1, 0.0), &Point3::new(0.0, 0.3, 0.0), 0.05);
        let bounds = mesh.aabb().expect("vertices");
        assert!((bounds.min - Point3::new(-0.05, 0.05, -0.05)).norm() < 1e-3 && (bounds.max - Point3::new(0.05, 0.35, 0.05)).norm() < 1e-3);
    }

    #[test]
    fn the_arm_that_is_seen_is_where_the_arm_of_collision_checks_is() {
        let spheres = spheres_in_base(&LinkFrames::at(&READY), 0.08);
        for vertex in arm_mesh(&READY).vertices {
            let outside_m = spheres.iter().map(|s| (s.center - vertex.cast::<f64>()).norm() - s.radius_m).fold(f64::INFINITY, f64::min);
            assert!(outside_m < 0.06, "{vertex} is {outside_m} m outside");
        }
    }
}
