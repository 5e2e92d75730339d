//! Puts a shape together from primitives, surface and collision part by part.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use parry3d::shape::SharedShape;
use rapier3d::math::{Pose, Rotation, Vector};
use repose_geometry::TriMesh;

use super::{Family, Shape, Top};
use crate::convert;
use crate::objects::revolution::{ProfilePoint, revolved, ring_points, wall_wedges};

/// What a finished object is made of and how it feels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Mass per volume of its parts, kg/m³.
    pub density_kg_m3: f32,
    /// Coulomb friction coefficient.
    pub friction: f32,
}

/// How far the faceted part of something round keeps back from the face that it stands on, metres.
const INSET_M: f32 = 0.0006;

/// A shape under construction, in any frame.
#[derive(Debug, Clone, Default)]
pub struct Body {
    mesh: TriMesh,
    parts: Vec<(Pose, SharedShape)>,
}

impl Body {
    /// Adds a box with the given centre, orientation and half edge lengths.
    pub fn cuboid(&mut self, center: Point3<f32>, rotation: UnitQuaternion<f32>, half: Vector3<f32>) {
        let placed = Isometry3::from_parts(Translation3::from(center.coords), rotation);
        self.mesh.append(&cuboid_mesh(half).transformed(&placed));
        self.parts.push((convert::pose(&placed.cast()), SharedShape::cuboid(half.x, half.y, half.z)));
    }

    /// Adds a solid of revolution whose profile is convex between each two of `cuts` (indices into the profile's points), and starts and
    /// ends with a flat face.
    ///
    /// It lies on the facets that it shows (the engine's true cylinders roll on and on) and stands on true cylinders (of a hull's face the
    /// engine knows four corners in a row, a sliver of a disc). Each keeps out of the other's way by less than a millimetre.
    pub fn solid(&mut self, profile: &[ProfilePoint], cuts: &[usize]) {
        self.mesh.append(&revolved(profile));
        let (bottom, top) = (profile[0][1], profile[profile.len() - 1][1]);
        let bounds: Vec<usize> = [0].into_iter().chain(cuts.iter().copied()).chain([profile.len() - 1]).collect();
        for pair in bounds.windows(2) {
            let section = &profile[pair[0]..=pair[1]];
            let inset: Vec<ProfilePoint> =
                section.iter().filter(|p| p[0] > 0.0).map(|&[r, z]| [r, z.clamp(bottom + INSET_M, top - INSET_M)]).collect();
            self.hull_part(&ring_points(&inset));
        }
        let (first, last) = (profile[1][0], profile[profile.len() - 2][0]);
        let (foot_end, head_start) = (cuts.first().map_or(top, |c| profile[*c][1]), cuts.last().map_or(bottom, |c| profile[*c][1]));
        self.disc_part(first, bottom, foot_end);
        if !cuts.is_empty() {
            self.disc_part(last, head_start, top);
        }
    }

    /// Adds an open vessel: a base disc up to `floor_m` above the bottom and a wall. `outer` runs from the bottom's rim upwards, `inner`
    /// from the floor's rim upwards, as many points each.
    pub fn vessel(&mut self, outer: &[ProfilePoint], inner: &[ProfilePoint], floor_m: f32) {
        let bottom = outer[0];
        let mut profile = vec![[0.0, bottom[1]]];
        profile.extend_from_slice(outer);
        profile.extend(inner.iter().rev());
        profile.push([0.0, floor_m]);
        self.mesh.append(&revolved(&profile));
        self.disc_part(bottom[0], bottom[1], floor_m);
        for (o, i) in outer.windows(2).zip(inner.windows(2)) {
            let lowest = [o[0][0], o[0][1].max(bottom[1] + INSET_M)];
            for wedge in wall_wedges([lowest, o[1]], [i[0], i[1]]) {
                self.hull_part(&wedge);
            }
        }
    }

    /// Adds a round bar through the points of a path (a handle); its ends are meant to lie inside other parts.
    pub fn bar(&mut self, path: &[Point3<f32>], radius: f32) {
        self.mesh.append(&tube_mesh(path, radius));
        for pair in path.windows(2) {
            self.parts.push((Pose::IDENTITY, SharedShape::capsule(convert::vector(&pair[0]), convert::vector(&pair[1]), radius)));
        }
    }

    /// The finished shape, its origin moved to the centre of its box; `top` is given in the frame of construction.
    pub fn finish(mut self, family: Family, material: Material, top: Option<Top>) -> Shape {
        let (low, high) = self
            .mesh
            .vertices
            .iter()
            .fold((Point3::new(f32::MAX, f32::MAX, f32::MAX), Point3::new(f32::MIN, f32::MIN, f32::MIN)), |(low, high), v| {
                (low.inf(v), high.sup(v))
            });
        let center = nalgebra::center(&low, &high);
        for v in &mut self.mesh.vertices {
            *v -= center.coords;
        }
        for (pose, _) in &mut self.parts {
            pose.translation -= convert::vector(&center);
        }
        let volume_m3: f32 = self.parts.iter().map(|(_, shape)| shape.mass_properties(1.0).mass()).sum();
        Shape {
            family,
            mesh: self.mesh,
            parts: self.parts,
            half_extents_m: ((high - low) / 2.0).cast(),
            // Thin and hollow things would otherwise weigh next to nothing, which no solver stacks well.
            mass_kg: (volume_m3 * material.density_kg_m3).clamp(0.03, 1.5),
            friction: material.friction,
            top: top.map(|t| Top { height_m: t.height_m - center.z, ..t }),
        }
    }

    /// A true cylinder about z between two heights, a little thinner than the facets of the same radius are.
    fn disc_part(&mut self, radius: f32, low: f32, high: f32) {
        const WITHIN_FACETS: f32 = 0.985;
        // The engine's cylinder stands along y.
        let z_from_y = Rotation::from_rotation_x(std::f32::consts::FRAC_PI_2);
        let center = Vector::new(0.0, 0.0, (low + high) / 2.0);
        self.parts.push((Pose::from_parts(center, z_from_y), SharedShape::cylinder((high - low) / 2.0, radius * WITHIN_FACETS)));
    }

    fn hull_part(&mut self, points: &[Point3<f32>]) {
        let points: Vec<Vector> = points.iter().map(convert::vector).collect();
        // Degenerate hulls (a wall drawn with no thickness) have nothing to collide with.
        if let Some(hull) = SharedShape::convex_hull(&points) {
            self.parts.push((Pose::IDENTITY, hull));
        }
    }
}

/// A box around the origin, faces outwards.
pub fn cuboid_mesh(half: Vector3<f32>) -> TriMesh {
    let vertices = (0..8)
        .map(|i| {
            let side = |k: usize| if i >> k & 1 == 1 { 1.0 } else { -1.0 };
            Point3::new(side(0) * half.x, side(1) * half.y, side(2) * half.z)
        })
        .collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    TriMesh { vertices, triangles: quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect() }
}

/// A tube of eight facets along a path, closed at both ends.
fn tube_mesh(path: &[Point3<f32>], radius: f32) -> TriMesh {
    const SIDES: u32 = 8;
    let mut mesh = TriMesh::default();
    for (i, p) in path.iter().enumerate() {
        let along = (path[(i + 1).min(path.len() - 1)] - path[i.saturating_sub(1)]).normalize();
        // Any fixed direction that no handle runs along keeps consecutive rings from twisting against each other.
        let across = along.cross(&Vector3::new(0.123, 0.987, 0.057).normalize()).normalize();
        let other = along.cross(&across);
        mesh.vertices.extend((0..SIDES).map(|k| {
            let angle = std::f32::consts::TAU * k as f32 / SIDES as f32;
            p + (across * angle.cos() + other * angle.sin()) * radius
        }));
    }
    for ring in 0..path.len() as u32 - 1 {
        for k in 0..SIDES {
            let (a, b) = (ring * SIDES + k, ring * SIDES + (k + 1) % SIDES);
            let (c, d) = (b + SIDES, a + SIDES);
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let last = (path.len() as u32 - 1) * SIDES;
    for k in 1..SIDES - 1 {
        mesh.triangles.extend([[0, k + 1, k], [last, last + k, last + k + 1]]);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signed_volume(mesh: &TriMesh) -> f32 {
        (0..mesh.triangles.len()).map(|i| mesh.corners(i)).map(|[a, b, c]| a.coords.dot(&b.coords.cross(&c.coords)) / 6.0).sum()
    }

    #[test]
    fn boxes_and_bars_face_outwards() {
        let volume = signed_volume(&cuboid_mesh(Vector3::new(0.1, 0.2, 0.3)));
        assert!((volume - 0.048).abs() < 1e-6);
        let bar = tube_mesh(&[Point3::origin(), Point3::new(0.05, 0.0, 0.0), Point3::new(0.08, 0.0, 0.04)], 0.005);
        assert!(signed_volume(&bar) > 0.0);
    }
}
