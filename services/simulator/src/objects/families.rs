//! The families, each with random dimensions in the range of everyday things.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};

use super::body::{Body, Material};
use super::{Shape, Top};
use crate::objects::revolution::ProfilePoint;

/// A kind of object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Family {
    /// A cuboid, from a matchbox to a shoe carton.
    Box,
    /// A plain cylinder.
    Cylinder,
    /// A can with a bevelled rim.
    Can,
    /// A bottle: body, shoulder, neck, cap.
    Bottle,
    /// A cup with a handle.
    Mug,
    /// A cup without one.
    Cup,
    /// A round bowl.
    Bowl,
    /// A plate with a raised rim.
    Plate,
    /// A low vessel with two grips.
    Pot,
    /// Two or three bricks in one: letters and steps.
    Compound,
    /// A handle with a head across: hammers, brushes.
    Tool,
}

impl Family {
    /// All families.
    pub const ALL: [Self; 11] = [
        Self::Box,
        Self::Cylinder,
        Self::Can,
        Self::Bottle,
        Self::Mug,
        Self::Cup,
        Self::Bowl,
        Self::Plate,
        Self::Pot,
        Self::Compound,
        Self::Tool,
    ];

    /// The lower-case name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Box => "box",
            Self::Cylinder => "cylinder",
            Self::Can => "can",
            Self::Bottle => "bottle",
            Self::Mug => "mug",
            Self::Cup => "cup",
            Self::Bowl => "bowl",
            Self::Plate => "plate",
            Self::Pot => "pot",
            Self::Compound => "compound",
            Self::Tool => "tool",
        }
    }

    /// A random object of this family. `scale` multiplies its usual size (1 for a household's variety, less for small hands).
    pub fn sample(self, scale: f32, rng: &mut impl Rng) -> Shape {
        let mut length = |low: f32, high: f32| rng.random_range(low..high) * scale;
        let (body, top) = match self {
            Self::Box => cuboid([length(0.03, 0.14), length(0.03, 0.14), length(0.02, 0.2)]),
            Self::Cylinder => cylinder(length(0.018, 0.055), length(0.03, 0.2)),
            Self::Can => can(length(0.025, 0.043), length(0.06, 0.15)),
            Self::Bottle => bottle(length(0.022, 0.042), length(0.14, 0.27), rng),
            Self::Mug => mug(length(0.033, 0.046), length(0.07, 0.115), true, rng),
            Self::Cup => mug(length(0.028, 0.045), length(0.06, 0.13), false, rng),
            Self::Bowl => bowl(length(0.05, 0.095), length(0.035, 0.075), rng),
            Self::Plate => plate(length(0.075, 0.125), length(0.015, 0.028)),
            Self::Pot => pot(length(0.055, 0.09), length(0.05, 0.1)),
            Self::Compound => compound(scale, rng),
            Self::Tool => tool(length(0.1, 0.2), length(0.008, 0.014), length(0.025, 0.05), length(0.012, 0.022)),
        };
        let density_kg_m3 = match self {
            Self::Box => rng.random_range(150.0..600.0),
            Self::Mug | Self::Cup | Self::Bowl | Self::Plate => rng.random_range(1400.0..2300.0),
            Self::Pot | Self::Tool => rng.random_range(900.0..2000.0),
            _ => rng.random_range(300.0..1000.0),
        };
        body.finish(self, Material { density_kg_m3, friction: 0.6 }, top)
    }
}

type Made = (Body, Option<Top>);

fn cuboid(size: [f32; 3]) -> Made {
    let half = Vector3::from(size) / 2.0;
    let mut body = Body::default();
    body.cuboid(Point3::origin(), UnitQuaternion::identity(), half);
    (body, Some(Top { height_m: half.z, half_extents_m: [half.x, half.y] }))
}

fn round_top(height_m: f32, radius: f32) -> Option<Top> {
    let half = radius * std::f32::consts::FRAC_1_SQRT_2;
    Some(Top { height_m, half_extents_m: [half, half] })
}

fn cylinder(radius: f32, height: f32) -> Made {
    let mut body = Body::default();
    body.solid(&[[0.0, 0.0], [radius, 0.0], [radius, height], [0.0, height]], &[]);
    (body, round_top(height, radius))
}

fn can(radius: f32, height: f32) -> Made {
    let bevel = radius * 0.12;
    let inset = radius - bevel;
    let mut body = Body::default();
    body.solid(&[[0.0, 0.0], [inset, 0.0], [radius, bevel], [radius, height - bevel], [inset, height], [0.0, height]], &[]);
    (body, round_top(height, inset))
}

fn bottle(radius: f32, height: f32, rng: &mut impl Rng) -> Made {
    let neck = radius * rng.random_range(0.3..0.45);
    let shoulder = height * rng.random_range(0.5..0.7);
    let neck_start = shoulder + (height - shoulder) * rng.random_range(0.35..0.6);
    let profile =
        [[0.0, 0.0], [radius * 0.94, 0.0], [radius, radius * 0.08], [radius, shoulder], [neck, neck_start], [neck, height], [0.0, height]];
    let mut body = Body::default();
    body.solid(&profile, &[3, 4]);
    (body, None)
}

fn mug(radius: f32, height: f32, handle: bool, rng: &mut impl Rng) -> Made {
    let wall = rng.random_range(0.0035..0.0055f32);
    let base = radius * rng.random_range(0.75..1.0);
    let floor = wall * 1.3;
    let inner = |outer: f32, at: f32| [outer - wall, at];
    let at_floor = base + (radius - base) * floor / height;
    let mut body = Body::default();
    body.vessel(&[[base, 0.0], [radius, height]], &[inner(at_floor, floor), inner(radius, height)], floor);
    if handle {
        let reach = height * rng.random_range(0.22..0.32);
        let (low, high) = (height * rng.random_range(0.14..0.22), height * rng.random_range(0.78..0.88));
        let wall_at = |z: f32| base + (radius - base) * z / height - wall * 0.5;
        let squareness = rng.random_range(1.0..2.2f32);
        let path: Vec<Point3<f32>> = (0..=6)
            .map(|k| {
                let turn = std::f32::consts::PI * k as f32 / 6.0;
                let z = (low + high) / 2.0 - (high - low) / 2.0 * turn.cos();
                let out = turn.sin().max(0.0).powf(1.0 / squareness);
                Point3::new(wall_at(z) + reach * out, 0.0, z)
            })
            .collect();
        body.bar(&path, rng.random_range(0.0035..0.006));
    }
    (body, None)
}

fn bowl(radius: f32, height: f32, rng: &mut impl Rng) -> Made {
    let wall = rng.random_range(0.003..0.005f32);
    let base = radius * rng.random_range(0.4..0.6);
    let floor = wall;
    // A quarter of an ellipse between the base's rim and the bowl's.
    let outer: Vec<ProfilePoint> = (0..=3)
        .map(|k| {
            let turn = std::f32::consts::FRAC_PI_2 * k as f32 / 3.0;
            [base + (radius - base) * turn.sin(), height * (1.0 - turn.cos())]
        })
        .collect();
    let inner: Vec<ProfilePoint> =
        outer.iter().map(|&[r, z]| [r - wall, if z == height { height } else { floor + z * (height - floor) / height }]).collect();
    let mut body = Body::default();
    body.vessel(&outer, &inner, floor);
    (body, None)
}

fn plate(radius: f32, height: f32) -> Made {
    let wall = 0.004f32;
    let base = radius * 0.62;
    let outer = [[base, 0.0], [radius, height]];
    let inner = [[base - wall * 0.2, wall], [radius - wall * 1.5, height]];
    let mut body = Body::default();
    body.vessel(&outer, &inner, wall);
    (body, round_top(wall, base * 0.95))
}

fn pot(radius: f32, height: f32) -> Made {
    let (wall, floor) = (0.004f32, 0.005f32);
    let mut body = Body::default();
    body.vessel(&[[radius, 0.0], [radius, height]], &[[radius - wall, floor], [radius - wall, height]], floor);
    for side in [-1.0f32, 1.0] {
        let reach = radius * 0.35;
        let center = Point3::new(side * (radius - wall / 2.0 + reach / 2.0), 0.0, height * 0.82);
        body.cuboid(center, UnitQuaternion::identity(), Vector3::new(reach / 2.0, radius * 0.3, 0.005));
    }
    (body, None)
}

/// An L, a T or a step, lying or standing: one brick and one or two more grown from it.
fn compound(scale: f32, rng: &mut impl Rng) -> Made {
    let mut length = |low: f32, high: f32| rng.random_range(low..high) * scale;
    let foot = Vector3::new(length(0.03, 0.07), length(0.02, 0.045), length(0.01, 0.03));
    let post = Vector3::new(length(0.01, 0.028).min(foot.x), length(0.01, 0.045).min(foot.y), length(0.015, 0.06));
    let shift = (foot.x - post.x) * [-1.0, 0.0, 1.0, 1.0][rng.random_range(0..4)];
    let mut body = Body::default();
    body.cuboid(Point3::new(0.0, 0.0, foot.z), UnitQuaternion::identity(), foot);
    body.cuboid(Point3::new(shift, 0.0, 2.0 * foot.z + post.z), UnitQuaternion::identity(), post);
    if rng.random_bool(0.3) {
        body.cuboid(
            Point3::new(-shift, 0.0, 2.0 * foot.z + post.z * 0.6),
            UnitQuaternion::identity(),
            Vector3::new(post.x, post.y, post.z * 0.6),
        );
    }
    (body, None)
}

/// A bar with a block across its end, lying.
fn tool(handle: f32, grip: f32, head: f32, thickness: f32) -> Made {
    let mut body = Body::default();
    let lift = thickness.max(grip);
    body.cuboid(Point3::new(0.0, 0.0, lift), UnitQuaternion::identity(), Vector3::new(handle / 2.0, grip, grip));
    body.cuboid(Point3::new(handle / 2.0 + thickness, 0.0, lift), UnitQuaternion::identity(), Vector3::new(thickness, head, lift));
    (body, None)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn every_family_gives_closed_outward_meshes_around_their_origin() {
        let mut rng = Pcg64::seed_from_u64(1);
        for family in Family::ALL {
            for _ in 0..20 {
                let shape = family.sample(1.0, &mut rng);
                let bounds = shape.mesh.aabb().expect("a mesh has vertices");
                assert!((bounds.min.coords + bounds.max.coords).norm() < 1e-5, "{family:?} is centered");
                let volume: f32 = (0..shape.mesh.triangles.len())
                    .map(|i| shape.mesh.corners(i))
                    .map(|[a, b, c]| a.coords.dot(&b.coords.cross(&c.coords)) / 6.0)
                    .sum();
                assert!(volume > 0.0, "{family:?} faces outwards");
                assert!(!shape.parts.is_empty() && shape.mass_kg >= 0.03);
            }
        }
    }

    #[test]
    fn parts_fill_what_the_mesh_shows() {
        let mut rng = Pcg64::seed_from_u64(2);
        for family in Family::ALL {
            let shape = family.sample(1.0, &mut rng);
            let collider = shape.collider();
            let bounds = collider.compute_local_aabb();
            let half = shape.half_extents_m.cast::<f32>();
            for k in 0..3 {
                assert!((bounds.maxs[k] - half[k]).abs() < 0.002 && (bounds.mins[k] + half[k]).abs() < 0.002, "{family:?} axis {k}");
            }
        }
    }
}
