//! Surfaces of revolution about z, and the convex wedges of a hollow one's wall.

use nalgebra::Point3;
use repose_geometry::TriMesh;

/// Facets around the axis, of pictures and of hollow walls alike: at 5 cm of radius the flat of a facet is 0.4 mm inside the circle.
pub const FACETS: usize = 24;

/// A point of a profile: distance from the axis and height, metres.
pub type ProfilePoint = [f32; 2];

/// The closed surface that a profile sweeps. The profile runs from the axis around the outside (upwards) and back to the axis; points on
/// the axis have radius 0 and only the first and the last may.
pub fn revolved(profile: &[ProfilePoint]) -> TriMesh {
    let mut mesh = TriMesh::default();
    let mut rings: Vec<Vec<u32>> = Vec::with_capacity(profile.len());
    for &[radius, height] in profile {
        let first = mesh.vertices.len() as u32;
        if radius == 0.0 {
            mesh.vertices.push(Point3::new(0.0, 0.0, height));
            rings.push(vec![first; FACETS]);
        } else {
            mesh.vertices.extend((0..FACETS).map(|k| on_circle(radius, height, k)));
            rings.push((first..first + FACETS as u32).collect());
        }
    }
    for pair in rings.windows(2) {
        for k in 0..FACETS {
            let next = (k + 1) % FACETS;
            let (a, b, c, d) = (pair[0][k], pair[0][next], pair[1][next], pair[1][k]);
            mesh.triangles.extend([[a, b, c], [a, c, d]].into_iter().filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]));
        }
    }
    mesh
}

/// The eight corners of each wedge of a wall between two heights, for convex hulls: `outer` and `inner` give the radius and height at
/// the lower and the upper end.
pub fn wall_wedges(outer: [ProfilePoint; 2], inner: [ProfilePoint; 2]) -> Vec<Vec<Point3<f32>>> {
    (0..FACETS)
        .map(|k| {
            [outer[0], outer[1], inner[0], inner[1]]
                .into_iter()
                .flat_map(|[radius, height]| [on_circle(radius, height, k), on_circle(radius, height, k + 1)])
                .collect()
        })
        .collect()
}

/// The corner number `k` of the facets around the axis.
pub fn on_circle(radius: f32, height: f32, k: usize) -> Point3<f32> {
    let angle = std::f32::consts::TAU * (k % FACETS) as f32 / FACETS as f32;
    Point3::new(radius * angle.cos(), radius * angle.sin(), height)
}

/// All points of the rings of a profile: the hull of a solid of revolution whose profile is convex.
pub fn ring_points(profile: &[ProfilePoint]) -> Vec<Point3<f32>> {
    profile
        .iter()
        .flat_map(|&[radius, height]| (0..if radius == 0.0 { 1 } else { FACETS }).map(move |k| on_circle(radius, height, k)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signed_volume(mesh: &TriMesh) -> f32 {
        (0..mesh.triangles.len()).map(|i| mesh.corners(i)).map(|[a, b, c]| a.coords.dot(&b.coords.cross(&c.coords)) / 6.0).sum()
    }

    #[test]
    fn a_cylinder_faces_outwards_and_has_its_volume() {
        let mesh = revolved(&[[0.0, 0.0], [0.03, 0.0], [0.03, 0.1], [0.0, 0.1]]);
        let exact = std::f32::consts::PI * 0.03 * 0.03 * 0.1;
        assert!((signed_volume(&mesh) / exact - 1.0).abs() < 0.02);
    }

    #[test]
    fn a_cup_holds_less_than_the_solid() {
        let mesh = revolved(&[[0.0, 0.0], [0.04, 0.0], [0.04, 0.1], [0.036, 0.1], [0.036, 0.004], [0.0, 0.004]]);
        let walls = std::f32::consts::PI * (0.04 * 0.04 * 0.1 - 0.036 * 0.036 * 0.096);
        assert!((signed_volume(&mesh) / walls - 1.0).abs() < 0.02);
    }
}
