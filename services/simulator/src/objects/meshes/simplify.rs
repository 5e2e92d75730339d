//! Fewer triangles for drawing: quadric edge collapses (meshoptimizer) within a tolerance.

use meshopt::{SimplifyOptions, VertexDataAdapter, simplify};
use repose_geometry::TriMesh;

/// The mesh with about `triangles` triangles, or as few as stay within `tolerance` (in its units) of it. Deterministic.
pub fn simplified(mesh: &TriMesh, triangles: usize, tolerance: f32) -> TriMesh {
    if mesh.triangles.len() <= triangles {
        return mesh.clone();
    }
    let bytes: Vec<u8> = mesh.vertices.iter().flat_map(|v| [v.x, v.y, v.z]).flat_map(f32::to_ne_bytes).collect();
    let Ok(vertices) = VertexDataAdapter::new(&bytes, 12, 0) else { return mesh.clone() };
    let indices: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    let kept = simplify(&indices, &vertices, 3 * triangles, tolerance, SimplifyOptions::ErrorAbsolute, None);
    let mut index_of = vec![u32::MAX; mesh.vertices.len()];
    let mut thin = TriMesh::default();
    for t in kept.chunks_exact(3) {
        let corners = [t[0], t[1], t[2]].map(|i| {
            let slot = &mut index_of[i as usize];
            if *slot == u32::MAX {
                *slot = thin.vertices.len() as u32;
                thin.vertices.push(mesh.vertices[i as usize]);
            }
            *slot
        });
        thin.triangles.push(corners);
    }
    thin
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::loft::swept;
    use crate::objects::outline::Outline;

    #[test]
    fn a_fine_cylinder_keeps_its_form_with_a_tenth_of_its_triangles() {
        let rings = (0..=40).map(|k| [0.04, 0.002 * k as f32]);
        let profile: Vec<[f32; 2]> = [[0.0, 0.0]].into_iter().chain(rings).chain([[0.0, 0.08]]).collect();
        let fine = swept(&Outline::circle_of(48), &profile);
        let thin = simplified(&fine, 300, 0.001);
        assert!(thin.triangles.len() <= 330 && thin.triangles.len() * 10 < fine.triangles.len(), "{}", thin.triangles.len());
        let volume = |mesh| super::super::clean::signed_volume(mesh);
        assert!((volume(&thin) / volume(&fine) - 1.0).abs() < 0.02);
        assert_eq!(simplified(&fine, 100_000, 0.001), fine);
    }
}
