//! Surfaces that a profile sweeps around an outline, and where to cut them into convex pieces.
//!
//! A solid's piece between two cuts is the hull of its rings; a wall's is one wedge per facet. Neighbouring pieces are joined while
//! their common hull strays from the profile by less than [`STRAY_M`]: a curved bowl then needs a few dozen wedges, not hundreds.

use std::ops::RangeInclusive;

use nalgebra::{Point2, Point3};
use repose_geometry::TriMesh;

use super::outline::{Outline, ProfilePoint};

/// How far the hull of a piece may stand out of the profile, metres.
pub const STRAY_M: f32 = 0.0005;

/// The closed surface that a profile sweeps. The profile runs from the axis around the outside (upwards) and back to the axis; points on
/// the axis have radius 0 and only the first and the last may.
pub fn swept(outline: &Outline, profile: &[ProfilePoint]) -> TriMesh {
    surface(outline, profile, false)
}

/// The closed surface of a ring: the profile runs around the wall, counter-clockwise seen with z up and the axis to the left, and is closed.
pub fn swept_ring(outline: &Outline, profile: &[ProfilePoint]) -> TriMesh {
    surface(outline, profile, true)
}

fn surface(outline: &Outline, profile: &[ProfilePoint], closed: bool) -> TriMesh {
    let sides = outline.sides();
    let mut mesh = TriMesh::default();
    let mut rings: Vec<Vec<u32>> = Vec::with_capacity(profile.len());
    for &at in profile {
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend(outline.ring(at));
        rings.push(if at[0] == 0.0 { vec![first; sides] } else { (first..first + sides as u32).collect() });
    }
    if closed {
        rings.extend(rings.first().cloned());
    }
    for pair in rings.windows(2) {
        for k in 0..sides {
            let next = (k + 1) % sides;
            let (a, b, c, d) = (pair[0][k], pair[0][next], pair[1][next], pair[1][k]);
            mesh.triangles.extend([[a, b, c], [a, c, d]].into_iter().filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]));
        }
    }
    mesh
}

/// Convex pieces of a solid's outer profile (upwards), as ranges of its points.
pub fn solid_sections(outer: &[ProfilePoint]) -> Vec<RangeInclusive<usize>> {
    sections(outer.len(), |i, k, j| to_the_right(outer[i], outer[j], outer[k]) > -STRAY_M)
}

/// Convex pieces of a wall between an outer and an inner profile (upwards, as many points each), as ranges of their points.
pub fn wall_sections(outer: &[ProfilePoint], inner: &[ProfilePoint]) -> Vec<RangeInclusive<usize>> {
    sections(outer.len(), |i, k, j| {
        to_the_right(outer[i], outer[j], outer[k]) > -STRAY_M && to_the_right(inner[i], inner[j], inner[k]) < STRAY_M
    })
}

/// The corners of the wedge of facet `k` of a wall's piece.
pub fn wedge(outline: &Outline, outer: &[ProfilePoint], inner: &[ProfilePoint], k: usize) -> Vec<Point3<f32>> {
    outer.iter().chain(inner).flat_map(|&at| [outline.corner(at, k), outline.corner(at, k + 1)]).collect()
}

/// The wall's inner profile: `outer` (upwards, from the foot to the rim) moved inwards by `wall`, cut at the height `floor`, and the
/// outer points that belong to it; as many points each, the first pair at the floor, the last at the rim.
pub fn hollowed(outer: &[ProfilePoint], wall: f32, floor: f32) -> (Vec<ProfilePoint>, Vec<ProfilePoint>) {
    let offset = inwards(outer, wall);
    let first = offset.iter().position(|p| p[1] > floor + 1e-5).unwrap_or(offset.len() - 1).max(1);
    let between = |a: ProfilePoint, b: ProfilePoint| {
        let t = if b[1] > a[1] { ((floor - a[1]) / (b[1] - a[1])).clamp(0.0, 1.0) } else { 1.0 };
        [a[0] + (b[0] - a[0]) * t, floor]
    };
    let inner_floor = between(offset[first - 1], offset[first]);
    // A wall that leaves the foot at a shallow angle starts below the floor's height.
    let outer_floor = if outer[first][1] > floor { between(outer[first - 1], outer[first]) } else { outer[first - 1] };
    let mut pairs = (vec![outer_floor], vec![inner_floor]);
    pairs.0.extend_from_slice(&outer[first..]);
    pairs.1.extend_from_slice(&offset[first..]);
    pairs
}

/// Each point of a profile moved inwards by `distance`, corners mitred; the last stays at its height.
fn inwards(outer: &[ProfilePoint], distance: f32) -> Vec<ProfilePoint> {
    let normals: Vec<_> = outer
        .windows(2)
        .map(|pair| {
            let along = Point2::from(pair[1]) - Point2::from(pair[0]);
            nalgebra::Vector2::new(along.y, -along.x).normalize()
        })
        .collect();
    let last = outer.len() - 1;
    (0..=last)
        .map(|k| {
            let (before, after) = (normals[k.saturating_sub(1)], normals[k.min(last - 1)]);
            if k == last {
                return [outer[k][0] - distance / before.x.max(0.4), outer[k][1]];
            }
            let mitre = (before + after) / (1.0 + before.dot(&after)).max(0.5);
            [outer[k][0] - mitre.x * distance, outer[k][1] - mitre.y * distance]
        })
        .collect()
}

/// Greedy pieces: each is as long as `fits(first, between, last)` holds for all points between its ends.
fn sections(points: usize, fits: impl Fn(usize, usize, usize) -> bool) -> Vec<RangeInclusive<usize>> {
    let mut found = Vec::new();
    let mut from = 0;
    while from + 1 < points {
        let mut to = from + 1;
        while to + 1 < points && (from + 1..=to).all(|k| (from..k).all(|i| fits(i, k, to + 1))) {
            to += 1;
        }
        found.push(from..=to);
        from = to;
    }
    found
}

/// How far `p` is to the right of the line from `a` to `b` (outside, for a profile that runs upwards), metres.
fn to_the_right(a: ProfilePoint, b: ProfilePoint, p: ProfilePoint) -> f32 {
    let (along, to) = (Point2::from(b) - Point2::from(a), Point2::from(p) - Point2::from(a));
    let length = along.norm();
    if length > 1e-9 { -along.perp(&to) / length } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signed_volume(mesh: &TriMesh) -> f32 {
        (0..mesh.triangles.len()).map(|i| mesh.corners(i)).map(|[a, b, c]| a.coords.dot(&b.coords.cross(&c.coords)) / 6.0).sum()
    }

    #[test]
    fn a_cylinder_faces_outwards_and_has_its_volume() {
        let mesh = swept(&Outline::circle(), &[[0.0, 0.0], [0.03, 0.0], [0.03, 0.1], [0.0, 0.1]]);
        let exact = std::f32::consts::PI * 0.03 * 0.03 * 0.1;
        assert!((signed_volume(&mesh) / exact - 1.0).abs() < 0.02);
    }

    #[test]
    fn a_ring_faces_outwards_and_has_its_volume() {
        let mesh = swept_ring(&Outline::circle(), &[[0.02, 0.0], [0.03, 0.0], [0.03, 0.01], [0.02, 0.01]]);
        let exact = std::f32::consts::PI * (0.03f32.powi(2) - 0.02f32.powi(2)) * 0.01;
        assert!((signed_volume(&mesh) / exact - 1.0).abs() < 0.02);
    }

    #[test]
    fn a_convex_profile_is_one_piece_and_a_bottle_is_cut_at_its_neck() {
        assert_eq!(solid_sections(&[[0.03, 0.0], [0.04, 0.01], [0.04, 0.1], [0.03, 0.11]]), vec![0..=3]);
        assert_eq!(solid_sections(&[[0.04, 0.0], [0.04, 0.1], [0.015, 0.13], [0.015, 0.2]]), vec![0..=2, 2..=3]);
        // A step: the flat piece between the two has no height.
        assert_eq!(solid_sections(&[[0.04, 0.0], [0.04, 0.1], [0.02, 0.1], [0.02, 0.2]]), vec![0..=2, 2..=3]);
    }

    #[test]
    fn a_hollowed_cup_has_its_wall_and_its_floor() {
        let (outer, inner) = hollowed(&[[0.03, 0.0], [0.04, 0.1]], 0.004, 0.006);
        assert_eq!(outer.len(), inner.len());
        assert!((inner[0][1] - 0.006).abs() < 1e-6 && (outer[0][1] - 0.006).abs() < 1e-6);
        assert_eq!(inner[1][1], 0.1);
        for (o, i) in outer.iter().zip(&inner) {
            assert!((o[0] - i[0] - 0.004).abs() < 0.0005, "{o:?} {i:?}");
        }
    }
}
