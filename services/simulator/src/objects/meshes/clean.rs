//! Makes a triangle soup a surface: corners welded, slivers and copies dropped, all faces outward.

use std::collections::BTreeMap;

use nalgebra::Point3;
use repose_geometry::TriMesh;

/// A cleaned surface, and what was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Cleaned {
    /// Every vertex is used, every triangle has an area and is there once; connected pieces are oriented alike, and outward by volume.
    pub mesh: TriMesh,
    /// Triangles dropped: without area, or there before.
    pub dropped: usize,
    /// Triangles turned over.
    pub turned: usize,
    /// Edges that do not have exactly two triangles: 0 for a closed surface.
    pub open_edges: usize,
}

/// Cleans a mesh; corners closer than `weld` (in its units) become one.
pub fn cleaned(mesh: &TriMesh, weld: f32) -> Cleaned {
    let (mesh, dropped) = welded(mesh, weld);
    let edges = edges_of(&mesh);
    let open_edges = edges.values().filter(|users| users.len() != 2).count();
    let (mesh, turned) = oriented(mesh, &edges);
    Cleaned { mesh, dropped, turned, open_edges }
}

/// Groups of triangles that hang together by edges, each in ascending order.
pub fn components(mesh: &TriMesh) -> Vec<Vec<usize>> {
    let edges = edges_of(mesh);
    let mut component = vec![usize::MAX; mesh.triangles.len()];
    let mut found: Vec<Vec<usize>> = Vec::new();
    for start in 0..mesh.triangles.len() {
        if component[start] != usize::MAX {
            continue;
        }
        let mut members = vec![start];
        component[start] = found.len();
        let mut next = 0;
        while next < members.len() {
            for key in edge_keys(&mesh.triangles[members[next]]) {
                for &other in &edges[&key] {
                    if component[other] == usize::MAX {
                        component[other] = found.len();
                        members.push(other);
                    }
                }
            }
            next += 1;
        }
        members.sort_unstable();
        found.push(members);
    }
    found
}

/// The volume that a surface encloses (by the divergence theorem, about its own middle so that holes matter little), in its units cubed.
pub fn signed_volume(mesh: &TriMesh) -> f32 {
    let all: Vec<usize> = (0..mesh.triangles.len()).collect();
    volume_of(mesh, &all)
}

fn volume_of(mesh: &TriMesh, triangles: &[usize]) -> f32 {
    let mut middle = nalgebra::Vector3::zeros();
    for &t in triangles {
        middle += mesh.corners(t).iter().map(|p| p.coords).sum::<nalgebra::Vector3<f32>>() / (3.0 * triangles.len() as f32);
    }
    let tetrahedron = |&t: &usize| {
        let [a, b, c] = mesh.corners(t).map(|p| p.coords - middle);
        a.dot(&b.cross(&c)) / 6.0
    };
    triangles.iter().map(tetrahedron).sum()
}

fn welded(mesh: &TriMesh, weld: f32) -> (TriMesh, usize) {
    let cell = |p: &Point3<f32>| [p.x, p.y, p.z].map(|c| (f64::from(c) / f64::from(weld)).round() as i64);
    let mut index_of: BTreeMap<[i64; 3], u32> = BTreeMap::new();
    let mut vertices: Vec<Point3<f32>> = Vec::new();
    let mut seen: std::collections::BTreeSet<[u32; 3]> = std::collections::BTreeSet::new();
    let mut triangles = Vec::with_capacity(mesh.triangles.len());
    let mut dropped = 0;
    for t in &mesh.triangles {
        let corners = t.map(|i| {
            let p = mesh.vertices[i as usize];
            *index_of.entry(cell(&p)).or_insert_with(|| {
                vertices.push(p);
                vertices.len() as u32 - 1
            })
        });
        let mut sorted = corners;
        sorted.sort_unstable();
        let [a, b, c] = corners.map(|i| vertices[i as usize]);
        let has_area = sorted[0] != sorted[1] && sorted[1] != sorted[2] && (b - a).cross(&(c - a)).norm() > weld * weld;
        if has_area && seen.insert(sorted) {
            triangles.push(corners);
        } else {
            dropped += 1;
        }
    }
    // Corners of dropped triangles may be left without any.
    let mut kept = vec![u32::MAX; vertices.len()];
    let mut used = Vec::with_capacity(vertices.len());
    for t in &mut triangles {
        for i in t.iter_mut() {
            let slot = &mut kept[*i as usize];
            if *slot == u32::MAX {
                *slot = used.len() as u32;
                used.push(vertices[*i as usize]);
            }
            *i = *slot;
        }
    }
    (TriMesh { vertices: used, triangles }, dropped)
}

/// Turns triangles over until neighbours agree, then whole pieces until their volume is positive.
fn oriented(mut mesh: TriMesh, edges: &BTreeMap<[u32; 2], Vec<usize>>) -> (TriMesh, usize) {
    let runs = |t: &[u32; 3], [a, b]: [u32; 2]| (0..3).any(|k| t[k] == a && t[(k + 1) % 3] == b);
    let original = mesh.triangles.clone();
    for members in components(&mesh) {
        let mut settled: BTreeMap<usize, bool> = BTreeMap::new();
        let mut queue = vec![members[0]];
        settled.insert(members[0], true);
        while let Some(t) = queue.pop() {
            for key in edge_keys(&mesh.triangles[t]) {
                // Where more than two meet there is no telling which two belong together.
                let [a, b] = edges[&key][..] else { continue };
                let other = if a == t { b } else { a };
                if settled.insert(other, true).is_none() {
                    if runs(&mesh.triangles[other], key) == runs(&mesh.triangles[t], key) {
                        mesh.triangles[other].swap(1, 2);
                    }
                    queue.push(other);
                }
            }
        }
        if volume_of(&mesh, &members) < 0.0 {
            for t in members {
                mesh.triangles[t].swap(1, 2);
            }
        }
    }
    let turned = mesh.triangles.iter().zip(&original).filter(|(a, b)| a != b).count();
    (mesh, turned)
}

fn edge_keys(t: &[u32; 3]) -> [[u32; 2]; 3] {
    [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]].map(|[a, b]| [a.min(b), a.max(b)])
}

fn edges_of(mesh: &TriMesh) -> BTreeMap<[u32; 2], Vec<usize>> {
    let mut edges: BTreeMap<[u32; 2], Vec<usize>> = BTreeMap::new();
    for (i, t) in mesh.triangles.iter().enumerate() {
        for key in edge_keys(t) {
            edges.entry(key).or_default().push(i);
        }
    }
    edges
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::objects::body::cuboid_mesh;

    /// A box as an STL has it: each triangle with corners of its own.
    fn soup() -> TriMesh {
        let cube = cuboid_mesh(Vector3::new(0.02, 0.03, 0.04));
        let vertices: Vec<Point3<f32>> = (0..12).flat_map(|i| cube.corners(i)).collect();
        TriMesh { vertices, triangles: (0..12).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect() }
    }

    #[test]
    fn a_soup_with_copies_slivers_and_turned_faces_becomes_the_box() {
        let mut mesh = soup();
        mesh.triangles[3].swap(0, 1);
        mesh.triangles[8].swap(1, 2);
        mesh.triangles.push(mesh.triangles[0]);
        mesh.triangles.push([0, 0, 1]);
        mesh.vertices.push(Point3::new(9.0, 9.0, 9.0));
        let clean = cleaned(&mesh, 1e-6);
        assert_eq!((clean.mesh.vertices.len(), clean.mesh.triangles.len()), (8, 12));
        assert_eq!((clean.dropped, clean.turned, clean.open_edges), (2, 2, 0));
        assert!((signed_volume(&clean.mesh) - 0.04 * 0.06 * 0.08).abs() < 1e-8);
    }

    #[test]
    fn an_inside_out_box_is_turned_and_a_hole_is_said() {
        let mut mesh = soup();
        for t in &mut mesh.triangles {
            t.swap(0, 1);
        }
        mesh.triangles.pop();
        let clean = cleaned(&mesh, 1e-6);
        assert_eq!((clean.turned, clean.open_edges), (11, 3));
        assert!(signed_volume(&clean.mesh) > 0.0);
    }

    #[test]
    fn two_boxes_are_two_components() {
        let mut mesh = soup();
        let mut other = soup();
        for v in &mut other.vertices {
            v.x += 0.5;
        }
        mesh.append(&other);
        let clean = cleaned(&mesh, 1e-6);
        assert_eq!(components(&clean.mesh).iter().map(Vec::len).collect::<Vec<_>>(), [12, 12]);
    }
}
