//! Triangle meshes: what scenes are rendered from and what true extents are read off.

use nalgebra::{Isometry3, Point3};

use crate::Aabb;

/// Vertices and triangles, counter-clockwise seen from outside, in metres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TriMesh {
    /// Corner positions.
    pub vertices: Vec<Point3<f32>>,
    /// Three indices into `vertices` each.
    pub triangles: Vec<[u32; 3]>,
}

impl TriMesh {
    /// Adds another mesh's triangles to this one.
    pub fn append(&mut self, other: &Self) {
        let offset = self.vertices.len() as u32;
        self.vertices.extend_from_slice(&other.vertices);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + offset)));
    }

    /// The mesh moved by a rigid transform.
    pub fn transformed(&self, to_from: &Isometry3<f32>) -> Self {
        Self { vertices: self.vertices.iter().map(|v| to_from * v).collect(), triangles: self.triangles.clone() }
    }

    /// The axis-aligned box of all vertices; `None` without any.
    pub fn aabb(&self) -> Option<Aabb> {
        Aabb::of(self.vertices.iter())
    }

    /// The three corners of triangle `i`.
    pub fn corners(&self, i: usize) -> [Point3<f32>; 3] {
        self.triangles[i].map(|v| self.vertices[v as usize])
    }
}
