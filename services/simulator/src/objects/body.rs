//! Puts a shape together from primitives, surface and collision part by part.
//!
//! Every primitive adds a closed surface and the convex parts that fill it, within a millimetre of each other.

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use parry3d::shape::SharedShape;
use parry3d::transformation::try_convex_hull;
use rapier3d::math::{Pose, Rotation, Vector};
use repose_geometry::TriMesh;

use super::bar::{BarSection, bar_mesh, bar_pieces};
use super::loft::{hollowed, solid_sections, swept, swept_ring, wall_sections, wedge};
use super::outline::{Outline, ProfilePoint, radius_at};
use super::{ObjectShape, Top, VesselInterior};
use crate::convert;

/// How far the faceted part of something round keeps back from the faces that it stands on, metres.
const INSET_M: f32 = 0.0005;

/// A shape under construction, in any frame.
#[derive(Debug, Clone, Default)]
pub struct Body {
    mesh: TriMesh,
    parts: Vec<(Pose, SharedShape)>,
}

/// What a finished object is beside its geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct Finish<'a> {
    /// What it is, as labels and logs say it.
    pub name: &'a str,
    /// Mass, kilograms.
    pub mass_kg: f32,
    /// Coulomb friction coefficient.
    pub friction: f32,
    /// Where another can stand, in the frame of construction.
    pub top: Option<Top>,
    /// The inside of a vessel, in the frame of construction.
    pub opening: Option<VesselInterior>,
}

impl Body {
    /// Adds a box with the given centre, orientation and half edge lengths.
    pub fn cuboid(&mut self, center: Point3<f32>, rotation: UnitQuaternion<f32>, half: Vector3<f32>) {
        let placed = Isometry3::from_parts(Translation3::from(center.coords), rotation);
        self.mesh.append(&cuboid_mesh(half).transformed(&placed));
        self.parts.push((convert::pose(&placed.cast()), SharedShape::cuboid(half.x, half.y, half.z)));
    }

    /// Adds a box with edges along the axes between two corners.
    pub fn brick(&mut self, low: [f32; 3], high: [f32; 3]) {
        let (low, high) = (Point3::from(low), Point3::from(high));
        self.cuboid(nalgebra::center(&low, &high), UnitQuaternion::identity(), (high - low) / 2.0);
    }

    /// Adds the convex hull of points (a wedge, a roof). Points without volume add nothing.
    pub fn hull(&mut self, points: &[Point3<f32>]) {
        let points: Vec<Vector> = points.iter().map(convert::vector).collect();
        if let (Ok((corners, triangles)), Some(shape)) = (try_convex_hull(&points), SharedShape::convex_hull(&points)) {
            self.mesh.append(&TriMesh { vertices: corners.iter().map(|v| Point3::new(v.x, v.y, v.z)).collect(), triangles });
            self.parts.push((Pose::IDENTITY, shape));
        }
    }

    /// Adds a solid whose profile runs from the axis at the bottom, upwards around the outside, to the axis at the top. It has a flat
    /// face where the first or the last two points share their height.
    ///
    /// It lies on the facets that it shows (the engine's true cylinders roll on and on) and stands on true cylinders or quadrilaterals
    /// (of a hull's face the engine knows four corners in a row, a sliver of a disc). Each keeps out of the other's way by less than a
    /// millimetre.
    pub fn solid(&mut self, outline: &Outline, profile: &[ProfilePoint]) {
        self.mesh.append(&swept(outline, profile));
        self.solid_parts(outline, profile);
    }

    /// Adds an open vessel: `outer` runs from the foot upwards to the rim; the wall is `wall` thick and the floor `floor` above the bottom.
    /// Returns what is clear inside.
    pub fn vessel(&mut self, outline: &Outline, outer: &[ProfilePoint], wall: f32, floor: f32) -> VesselInterior {
        let bottom = outer[0][1];
        let floor = bottom + floor;
        let (wall_outer, inner) = hollowed(outer, wall, floor);
        let axis = [0.0, bottom];
        let surface: Vec<ProfilePoint> =
            [axis].into_iter().chain(outer.iter().copied()).chain(inner.iter().rev().copied()).chain([[0.0, floor]]).collect();
        self.mesh.append(&swept(outline, &surface));
        // The base: what the outer profile encloses below the floor.
        let below = outer.iter().copied().filter(|p| p[1] < floor - 1e-5);
        let edge = [radius_at(outer, floor), floor];
        let base: Vec<ProfilePoint> = [axis].into_iter().chain(below).chain([edge, [0.0, floor]]).collect();
        self.solid_parts(outline, &base);
        // The wall reaches into the base, or the base's inset would leave a slot between the two; but not down to what it stands on.
        let rooted = |wall: &[ProfilePoint]| -> Vec<ProfilePoint> {
            let low = wall[0][1] - INSET_M;
            wall.iter().map(|&[r, z]| [r, (if z == wall[0][1] { low } else { z }).max(bottom + INSET_M)]).collect()
        };
        self.wall_parts(outline, &rooted(&wall_outer), &rooted(&inner));
        let rim = inner[inner.len() - 1];
        let narrowest = inner.iter().map(|p| p[0]).fold(f32::MAX, f32::min);
        let inradius = outline.inradius();
        VesselInterior {
            center_m: [0.0, 0.0],
            floor_m: floor,
            rim_m: rim[1],
            radius_m: narrowest * inradius,
            mouth_radius_m: rim[0] * inradius,
            half_extents_m: outline.inner_half_extents().map(|half| half * narrowest),
        }
    }

    /// Adds a ring, open below and above: outer and inner profile (upwards, as many points each, ends at the same heights).
    pub fn ring(&mut self, outline: &Outline, outer: &[ProfilePoint], inner: &[ProfilePoint]) {
        let around: Vec<ProfilePoint> = outer.iter().copied().chain(inner.iter().rev().copied()).collect();
        self.mesh.append(&swept_ring(outline, &around));
        self.wall_parts(outline, outer, inner);
    }

    /// Adds a bar along a path in the plane with normal `across` (a handle); its ends are meant to lie inside other parts.
    pub fn bar(&mut self, path: &[Point3<f32>], across: Unit<Vector3<f32>>, section: &BarSection) {
        let mesh = bar_mesh(path, &across, section);
        for piece in bar_pieces(&mesh, section) {
            self.hull_part(piece);
        }
        self.mesh.append(&mesh);
    }

    /// Adds all of another body, moved.
    pub fn add(&mut self, other: &Self, self_from_other: &Isometry3<f32>) {
        self.mesh.append(&other.mesh.transformed(self_from_other));
        let pose = convert::pose(&self_from_other.cast());
        self.parts.extend(other.parts.iter().map(|(part_pose, shape)| (pose * *part_pose, shape.clone())));
    }

    /// The volume that its surface encloses, m³ (where two primitives overlap it counts twice), and the area of the surface, m².
    pub fn volume_and_area(&self) -> (f32, f32) {
        (0..self.mesh.triangles.len()).map(|i| self.mesh.corners(i)).fold((0.0, 0.0), |(volume, area), [a, b, c]| {
            (volume + a.coords.dot(&b.coords.cross(&c.coords)) / 6.0, area + (b - a).cross(&(c - a)).norm() / 2.0)
        })
    }

    /// The finished shape, its origin moved to the centre of its box.
    pub fn finish(mut self, finish: &Finish) -> ObjectShape {
        let far = Point3::new(f32::MAX, f32::MAX, f32::MAX);
        let (low, high) = self.mesh.vertices.iter().fold((far, -far), |(low, high), v| (low.inf(v), high.sup(v)));
        let center = nalgebra::center(&low, &high);
        for v in &mut self.mesh.vertices {
            *v -= center.coords;
        }
        for (pose, _) in &mut self.parts {
            pose.translation -= convert::vector(&center);
        }
        let moved = |[x, y]: [f32; 2]| [x - center.x, y - center.y];
        ObjectShape {
            name: finish.name.into(),
            mesh: self.mesh,
            parts: self.parts,
            half_extents_m: ((high - low) / 2.0).cast(),
            mass_kg: finish.mass_kg,
            friction: finish.friction,
            is_friction_known: false,
            top: finish.top.map(|t| Top { center_m: moved(t.center_m), height_m: t.height_m - center.z, ..t }),
            opening: finish.opening.map(|o| VesselInterior {
                center_m: moved(o.center_m),
                floor_m: o.floor_m - center.z,
                rim_m: o.rim_m - center.z,
                ..o
            }),
        }
    }

    fn solid_parts(&mut self, outline: &Outline, profile: &[ProfilePoint]) {
        let last = profile.len() - 1;
        let flat = |i: usize, j: usize| profile[i][1] == profile[j][1];
        let (flat_foot, flat_head) = (flat(0, 1), flat(last, last - 1));
        let rings = &profile[usize::from(flat_foot)..=last - usize::from(flat_head)];
        let quads = outline.quads();
        let (lowest, highest) = (
            if flat_foot && !quads.is_empty() { profile[0][1] + INSET_M } else { f32::MIN },
            if flat_head && !quads.is_empty() { profile[last][1] - INSET_M } else { f32::MAX },
        );
        let sections = solid_sections(rings);
        let tall: Vec<&[ProfilePoint]> =
            sections.iter().map(|s| &rings[s.clone()]).filter(|s| s[s.len() - 1][1] - s[0][1] > 1e-5).collect();
        for section in &tall {
            let points: Vec<Point3<f32>> = section.iter().flat_map(|&[r, z]| outline.ring([r, z.max(lowest).min(highest)])).collect();
            self.hull_part(&points);
        }
        // The pieces that have a level face, and its radius.
        let mut bearing: Vec<(usize, f32)> = Vec::new();
        if let (Some(foot), Some(head)) = (tall.first(), tall.last())
            && !quads.is_empty()
        {
            bearing.extend(flat_foot.then(|| (0, foot[0][0])));
            bearing.extend(flat_head.then(|| (tall.len() - 1, head[head.len() - 1][0])));
        }
        // Two faces of one piece may share what bears them.
        bearing.dedup_by(|head, foot| head.0 == foot.0 && (!outline.is_round() || (head.1 - foot.1).abs() < 1e-4));
        for (index, radius) in bearing {
            let section = tall[index];
            // A cylinder, where the piece is nowhere narrower than its face.
            if outline.is_round() && section.iter().all(|p| p[0] > radius * 0.99) {
                let within_facets = radius * outline.inradius() - INSET_M / 2.0;
                self.disc_part(within_facets, section[0][1], section[section.len() - 1][1]);
            } else {
                for quad in &quads {
                    let points: Vec<Point3<f32>> = section.iter().flat_map(|&at| quad.map(|k| outline.corner(at, k))).collect();
                    self.hull_part(&points);
                }
            }
        }
    }

    fn wall_parts(&mut self, outline: &Outline, outer: &[ProfilePoint], inner: &[ProfilePoint]) {
        for section in wall_sections(outer, inner) {
            for k in 0..outline.sides() {
                self.hull_part(&wedge(outline, &outer[section.clone()], &inner[section.clone()], k));
            }
        }
    }

    /// A true cylinder about z between two heights.
    fn disc_part(&mut self, radius: f32, low: f32, high: f32) {
        // The engine's cylinder stands along y.
        let z_from_y = Rotation::from_rotation_x(std::f32::consts::FRAC_PI_2);
        let center = Vector::new(0.0, 0.0, (low + high) / 2.0);
        self.parts.push((Pose::from_parts(center, z_from_y), SharedShape::cylinder((high - low) / 2.0, radius)));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_and_hulls_face_outwards_and_have_their_volume() {
        let mut body = Body::default();
        body.brick([-0.1, -0.2, -0.3], [0.1, 0.2, 0.3]);
        assert!((body.volume_and_area().0 - 0.048).abs() < 1e-6);
        let mut wedge = Body::default();
        wedge.hull(&[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]].map(Point3::from));
        assert!((wedge.volume_and_area().0 - 0.001 / 6.0).abs() < 1e-8);
        assert_eq!(wedge.parts.len(), 1);
    }

    #[test]
    fn a_vessel_tells_what_is_clear_inside() {
        let mut body = Body::default();
        let opening = body.vessel(&Outline::circle(), &[[0.03, 0.0], [0.04, 0.1]], 0.004, 0.006);
        assert!((opening.floor_m - 0.006).abs() < 1e-6 && (opening.rim_m - 0.1).abs() < 1e-6);
        assert!(opening.radius_m > 0.025 && opening.radius_m < 0.027, "{opening:?}");
        assert!(opening.mouth_radius_m > 0.035 && opening.mouth_radius_m < 0.0365, "{opening:?}");
    }
}
