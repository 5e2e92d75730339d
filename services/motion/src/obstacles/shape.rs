//! Solids with exact distances: boxes, cylinders, balls, and the slabs that support surfaces stand for.
//!
//! Every solid answers one question, how far a place is from it, for one place in double precision and for the places of many configurations
//! in the lanes of a vector.

use nalgebra::{Isometry3, Point2, Point3, Vector3};
use repose_geometry::Footprint;
use repose_simd::Lanes;

/// The shape and pose of an obstacle in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct ObstacleShape {
    kind: Kind,
    world_from_shape: Isometry3<f64>,
    single: Single,
}

#[derive(Debug, Clone, PartialEq)]
enum Kind {
    /// Half edges.
    Box(Vector3<f64>),
    /// Radius and half height along z.
    Cylinder(f64, f64),
    /// Radius.
    Ball(f64),
    /// From the origin's height down by `depth_m`, over a convex outline.
    Slab { footprint: Footprint, depth_m: f64 },
}

/// The numbers that the lanes need, in single precision.
#[derive(Debug, Clone, PartialEq)]
struct Single {
    origin: [f32; 3],
    /// Rows of `shape_from_world`'s rotation.
    rows: [[f32; 3]; 3],
    /// Whether z is the world's, up to its sign: a turn about z needs fewer products.
    upright: bool,
    /// Sides of a slab: outward normal x y and its offset; a place is inside where all `n·p − offset` are negative.
    sides: Vec<[f32; 3]>,
    lower: [f32; 3],
    upper: [f32; 3],
}

impl ObstacleShape {
    /// A box of full edges `size_m`.
    pub fn cuboid(world_from_box: Isometry3<f64>, size_m: Vector3<f64>) -> Self {
        Self::new(Kind::Box(size_m / 2.0), world_from_box)
    }

    /// A cylinder about its z axis, `height_m` high in all.
    pub fn cylinder(world_from_cylinder: Isometry3<f64>, radius_m: f64, height_m: f64) -> Self {
        Self::new(Kind::Cylinder(radius_m, height_m / 2.0), world_from_cylinder)
    }

    /// A ball.
    pub fn ball(center: Point3<f64>, radius_m: f64) -> Self {
        Self::new(Kind::Ball(radius_m), Isometry3::from(center))
    }

    /// A support surface at `height_m`, solid `depth_m` downwards.
    ///
    /// The distance from it is the largest of those from its planes: a little less than the true one beyond its borders.
    pub fn slab(footprint: Footprint, height_m: f64, depth_m: f64) -> Self {
        Self::new(Kind::Slab { footprint, depth_m }, Isometry3::translation(0.0, 0.0, height_m))
    }

    fn new(kind: Kind, world_from_shape: Isometry3<f64>) -> Self {
        let rotation = world_from_shape.rotation.to_rotation_matrix().into_inner();
        let row = |k: usize| [0, 1, 2].map(|i| rotation[(i, k)] as f32);
        let rows = [row(0), row(1), row(2)];
        let origin = world_from_shape.translation.vector;
        let reach = match &kind {
            Kind::Box(half) => rotation.abs() * half,
            Kind::Cylinder(radius, half) => {
                let axis = rotation.column(2);
                axis.map(|z| half * z.abs() + radius * (1.0 - z * z).max(0.0).sqrt())
            }
            Kind::Ball(radius) => Vector3::repeat(*radius),
            Kind::Slab { .. } => Vector3::zeros(),
        };
        let (mut lower, mut upper) = ((origin - reach).map(|v| v as f32).into(), (origin + reach).map(|v| v as f32).into());
        let mut sides = Vec::new();
        if let Kind::Slab { footprint, depth_m } = &kind {
            let corners = footprint.corners();
            sides = (0..corners.len()).map(|i| side(&corners[i], &corners[(i + 1) % corners.len()])).collect();
            // The distance from it is no true one beyond its borders, so only its height bounds it.
            lower = [f32::NEG_INFINITY, f32::NEG_INFINITY, (origin.z - depth_m) as f32];
            upper = [f32::INFINITY, f32::INFINITY, origin.z as f32];
        }
        let upright = rotation[(2, 2)].abs() > 1.0 - 1e-12;
        let single = Single { origin: origin.map(|v| v as f32).into(), rows, upright, sides, lower, upper };
        Self { kind, world_from_shape, single }
    }

    /// The box along the world's axes around it: its lower and upper corner, metres.
    pub fn bounds(&self) -> (&[f32; 3], &[f32; 3]) {
        (&self.single.lower, &self.single.upper)
    }

    /// How far a place is from the solid, metres; 0 inside.
    pub fn distance_m(&self, place: &Point3<f64>) -> f64 {
        let p = self.world_from_shape.inverse_transform_point(place);
        match &self.kind {
            Kind::Box(half) => (p.coords.abs() - half).sup(&Vector3::zeros()).norm(),
            Kind::Cylinder(radius, half) => (p.xy().coords.norm() - radius).max(0.0).hypot((p.z.abs() - half).max(0.0)),
            Kind::Ball(radius) => (p.coords.norm() - radius).max(0.0),
            Kind::Slab { footprint, depth_m } => {
                let beside = -f64::from(footprint.margin(&Point2::new(place.x as f32, place.y as f32)));
                p.z.max(-p.z - depth_m).max(beside).max(0.0)
            }
        }
    }

    /// The square of the distance for the place in each lane, square metres.
    ///
    /// # Safety
    /// The instruction set of `S` must be present.
    #[inline(always)]
    pub unsafe fn squared_distance<S: Lanes>(&self, place: &[S::V; 3]) -> S::V {
        let single = &self.single;
        // SAFETY: by this function's contract.
        unsafe {
            let zero = S::splat(0.0);
            // No closures here: what a closure holds is compiled without this function's instruction set.
            let x = S::sub(place[0], S::splat(single.origin[0]));
            let y = S::sub(place[1], S::splat(single.origin[1]));
            let z = S::sub(place[2], S::splat(single.origin[2]));
            match &self.kind {
                Kind::Box(half) => {
                    let local = if single.upright {
                        let [first, second, _] = &single.rows;
                        [
                            S::fma(x, S::splat(first[0]), S::mul(y, S::splat(first[1]))),
                            S::fma(x, S::splat(second[0]), S::mul(y, S::splat(second[1]))),
                            z,
                        ]
                    } else {
                        let [first, second, third] = &single.rows;
                        [along::<S>(first, x, y, z), along::<S>(second, x, y, z), along::<S>(third, x, y, z)]
                    };
                    let mut squared = zero;
                    for k in 0..3 {
                        let out = S::max(S::sub(S::abs(local[k]), S::splat(half[k] as f32)), zero);
                        squared = S::fma(out, out, squared);
                    }
                    squared
                }
                Kind::Cylinder(radius, half) => {
                    let up = along::<S>(&single.rows[2], x, y, z);
                    let squared = S::sub(S::fma(x, x, S::fma(y, y, S::mul(z, z))), S::mul(up, up));
                    let beside = S::max(S::sub(S::sqrt(S::max(squared, zero)), S::splat(*radius as f32)), zero);
                    let beyond = S::max(S::sub(S::abs(up), S::splat(*half as f32)), zero);
                    S::fma(beside, beside, S::mul(beyond, beyond))
                }
                Kind::Ball(radius) => {
                    let squared = S::fma(x, x, S::fma(y, y, S::mul(z, z)));
                    let out = S::max(S::sub(S::sqrt(squared), S::splat(*radius as f32)), zero);
                    S::mul(out, out)
                }
                Kind::Slab { depth_m, .. } => {
                    let below = S::sub(S::splat(-*depth_m as f32), z);
                    let mut out = S::max(S::max(z, below), zero);
                    for [nx, ny, offset] in &single.sides {
                        out = S::max(out, S::fma(place[0], S::splat(*nx), S::fma(place[1], S::splat(*ny), S::splat(-offset))));
                    }
                    S::mul(out, out)
                }
            }
        }
    }
}

/// The component along a direction.
#[inline(always)]
unsafe fn along<S: Lanes>(direction: &[f32; 3], x: S::V, y: S::V, z: S::V) -> S::V {
    // SAFETY: by this function's contract.
    unsafe { S::fma(x, S::splat(direction[0]), S::fma(y, S::splat(direction[1]), S::mul(z, S::splat(direction[2])))) }
}

/// The outward normal and offset of the side from `a` to `b` of a counter-clockwise outline.
fn side(a: &Point2<f32>, b: &Point2<f32>) -> [f32; 3] {
    let along = (b - a).normalize();
    [along.y, -along.x, along.y * a.x - along.x * a.y]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use repose_simd::Plain;

    fn shapes() -> impl Strategy<Value = ObstacleShape> {
        let pose = (prop::array::uniform3(-0.5..0.5f64), prop::array::uniform3(-2.0..2.0f64), any::<bool>()).prop_map(|(t, r, upright)| {
            let turn = if upright { Vector3::z() * r[0] } else { Vector3::from(r) };
            Isometry3::new(Vector3::from(t), turn)
        });
        (pose, prop::array::uniform3(0.02..0.6f64), 0..4usize).prop_map(|(pose, size, kind)| match kind {
            0 => ObstacleShape::cuboid(pose, Vector3::from(size)),
            1 => ObstacleShape::cylinder(pose, size[0], size[1]),
            2 => ObstacleShape::ball(Point3::from(pose.translation.vector), size[0]),
            _ => {
                let outline = [[0.2, -0.4, 0.0], [0.8, -0.4, 0.0], [0.9, 0.4, 0.0], [0.2, 0.3, 0.0]].map(Point3::from);
                ObstacleShape::slab(Footprint::of(&outline).unwrap(), pose.translation.z, size[0])
            }
        })
    }

    proptest! {
        #[test]
        fn lanes_and_double_precision_agree_and_the_bounds_hold_the_shape(
            shape in shapes(), places in prop::array::uniform4(prop::array::uniform3(-1.0..1.0f64)),
        ) {
            let lanes = [0, 1, 2].map(|k| places.map(|p| p[k] as f32));
            // SAFETY: the plain set is always there.
            let squared = unsafe { shape.squared_distance::<Plain>(&lanes) };
            let (lower, upper) = shape.bounds();
            for (place, squared) in places.iter().zip(squared) {
                let distance = shape.distance_m(&Point3::from(*place));
                prop_assert!((distance - f64::from(squared).sqrt()).abs() < 3e-6 || distance < 1e-3 && f64::from(squared) < 1e-6);
                let to_bounds = (0..3).map(|k| (f64::from(lower[k]) - place[k]).max(place[k] - f64::from(upper[k])).max(0.0));
                prop_assert!(to_bounds.fold(0.0, f64::max) <= distance + 1e-5);
            }
        }
    }
}
