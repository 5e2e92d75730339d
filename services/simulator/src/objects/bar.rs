//! Bars along paths (handles, grips, shafts): a convex cross-section swept along a flat path, mitred at its corners.
//!
//! Each straight piece is its own convex hull, corner for corner what is drawn.

use nalgebra::{Point3, Unit, Vector2, Vector3};
use repose_geometry::TriMesh;

/// The cross-section of a bar.
#[derive(Debug, Clone, PartialEq)]
pub struct BarSection {
    /// Counter-clockwise; x is across the path's plane, y in it.
    points: Vec<Vector2<f32>>,
}

impl BarSection {
    /// A round bar.
    pub fn round(radius: f32) -> Self {
        Self::oval(radius, radius)
    }

    /// An oval: half its width across the path's plane, half its thickness in it.
    pub fn oval(half_width: f32, half_thickness: f32) -> Self {
        let points = (0..8).map(|k| {
            let turn = std::f32::consts::TAU * (k as f32 + 0.5) / 8.0;
            // Facets, not corners, at the given distances.
            Vector2::new(turn.cos() * half_width, turn.sin() * half_thickness) / (std::f32::consts::PI / 8.0).cos()
        });
        Self { points: points.collect() }
    }

    /// A strap with square edges: half its width across the path's plane, half its thickness in it.
    pub fn flat(half_width: f32, half_thickness: f32) -> Self {
        let corner = |x: f32, y: f32| Vector2::new(x * half_width, y * half_thickness);
        Self { points: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)] }
    }
}

/// The closed surface of a bar along `path`, which lies in a plane with normal `across`; consecutive points differ. Ring `i` of
/// corners belongs to path point `i`.
pub fn bar_mesh(path: &[Point3<f32>], across: &Unit<Vector3<f32>>, section: &BarSection) -> TriMesh {
    let sides = section.points.len() as u32;
    let mut mesh = TriMesh::default();
    let direction = |i: usize| (path[i + 1] - path[i]).normalize();
    let last = path.len() - 1;
    for (i, p) in path.iter().enumerate() {
        let (before, after) = (direction(i.saturating_sub(1).min(last - 1)), direction(i.min(last - 1)));
        let along = (before + after).normalize();
        // At a corner the ring lies in the bisecting plane, longer by the mitre.
        let mitre = 1.0 / along.dot(&before).max(0.5);
        let outwards = along.cross(across).normalize() * mitre;
        mesh.vertices.extend(section.points.iter().map(|q| p + across.into_inner() * q.x + outwards * q.y));
    }
    for ring in 0..last as u32 {
        for k in 0..sides {
            let (a, b) = (ring * sides + k, ring * sides + (k + 1) % sides);
            let (c, d) = (b + sides, a + sides);
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let top = last as u32 * sides;
    for k in 1..sides - 1 {
        mesh.triangles.extend([[0, k + 1, k], [top, top + k, top + k + 1]]);
    }
    mesh
}

/// The corners of each straight piece, for convex hulls.
pub fn bar_pieces<'a>(mesh: &'a TriMesh, section: &BarSection) -> impl Iterator<Item = &'a [Point3<f32>]> {
    let sides = section.points.len();
    (0..mesh.vertices.len() / sides - 1).map(move |i| &mesh.vertices[i * sides..(i + 2) * sides])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_straight_bar_faces_outwards_and_a_bent_one_keeps_its_thickness() {
        let volume = |mesh: &TriMesh| -> f32 {
            (0..mesh.triangles.len()).map(|i| mesh.corners(i)).map(|[a, b, c]| a.coords.dot(&b.coords.cross(&c.coords)) / 6.0).sum()
        };
        let section = BarSection::flat(0.004, 0.002);
        let straight = bar_mesh(&[Point3::origin(), Point3::new(0.1, 0.0, 0.0)], &Vector3::y_axis(), &section);
        assert!((volume(&straight) - 0.1 * 0.008 * 0.004).abs() < 1e-8);
        let bent = [Point3::origin(), Point3::new(0.05, 0.0, 0.0), Point3::new(0.05, 0.0, 0.05)];
        let bent = bar_mesh(&bent, &Vector3::y_axis(), &section);
        assert!((volume(&bent) - 0.1 * 0.008 * 0.004).abs() < 1e-8);
        assert_eq!(bar_pieces(&bent, &section).count(), 2);
    }
}
