//! Tables: the top at z = 0, the floor somewhere below; round or square, on legs or a base, sometimes before a wall or with a large box
//! on top.

use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, RngExt};

use super::{Fixture, Furniture, FurnitureRole, FurnitureSurface, Outlook, floor, furniture_color, shaded};

/// The table of scenes that stand on one; its top is z = 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Table {
    /// Around the origin, of random size and make.
    Random {
        /// Half its edge lengths, lowest and highest, metres.
        half_m: [f64; 2],
        /// Height of its top over the floor, lowest and highest, metres.
        height_m: [f64; 2],
        /// How likely it is round.
        round: f64,
        /// How likely a wall stands behind it.
        wall: f64,
    },
    /// Always the same one.
    Fixed {
        /// Its corner of least (x, y).
        low: Point2<f64>,
        /// Its corner of greatest (x, y).
        high: Point2<f64>,
    },
}

impl Default for Table {
    fn default() -> Self {
        Self::Random { half_m: [0.32, 0.7], height_m: [0.38, 0.95], round: 0.2, wall: 0.25 }
    }
}

impl Table {
    /// The table alone.
    pub(super) fn furniture(&self, rng: &mut impl Rng) -> Furniture {
        let color = furniture_color(rng);
        match *self {
            Self::Fixed { low, high } => {
                let middle = nalgebra::center(&low, &high);
                let top =
                    Fixture::between(FurnitureRole::Tabletop, Point3::new(low.x, low.y, -0.04), Point3::new(high.x, high.y, 0.0), color);
                let surface =
                    FurnitureSurface::open(FurnitureRole::Tabletop, Point3::new(middle.x, middle.y, 0.0), (high - low) / 2.0, 1.0);
                Furniture { fixtures: vec![top, floor(-0.75, rng)], surfaces: vec![surface], outlook: Outlook::AROUND }
            }
            Self::Random { half_m, height_m, round, wall } => {
                let mut between = |[low, high]: [f64; 2]| if low < high { rng.random_range(low..=high) } else { low };
                let (half, height) = (Vector2::new(between(half_m), between(half_m)), between(height_m));
                let thickness = between([0.015, 0.05]);
                let mut built = if rng.random_bool(round) {
                    round_table(half.min(), thickness, height, color)
                } else {
                    square_table(half, thickness, height, color, rng)
                };
                built.fixtures.push(floor(-height, rng));
                if rng.random_bool(wall) {
                    let gap = rng.random_range(0.0..0.08);
                    let top = rng.random_range(0.25..1.4);
                    let back = Point3::new(-1.6, half.y + gap, -height);
                    let color = shaded([226, 222, 214], rng.random_range(0.75..1.05));
                    built.fixtures.push(Fixture::between(FurnitureRole::Wall, back, Point3::new(1.6, half.y + gap + 0.1, top), color));
                    built.outlook = Outlook { azimuth_rad: Outlook::front(1.1, [0.0; 2], [0.0; 2]).azimuth_rad, ..Outlook::AROUND };
                }
                built
            }
        }
    }
}

/// A rectangular top on four legs or on a solid base.
fn square_table(half: Vector2<f64>, thickness: f64, height: f64, color: [u8; 3], rng: &mut impl Rng) -> Furniture {
    let top = Fixture::between(FurnitureRole::Tabletop, Point3::new(-half.x, -half.y, -thickness), Point3::new(half.x, half.y, 0.0), color);
    let mut fixtures = vec![top];
    let dark = shaded(color, 0.8);
    if rng.random_bool(0.6) {
        let thick = rng.random_range(0.02..0.045);
        for (x, y) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let at = Vector3::new(x * (half.x - thick), y * (half.y - thick), -(height + thickness) / 2.0);
            let size = Vector3::new(thick, thick, (height - thickness) / 2.0);
            fixtures.push(Fixture::new(FurnitureRole::TableBase, size, Isometry3::translation(at.x, at.y, at.z), dark));
        }
    } else {
        let inset = rng.random_range(0.0..0.06);
        let low = Point3::new(-half.x + inset, -half.y + inset, -height);
        fixtures.push(Fixture::between(FurnitureRole::TableBase, low, Point3::new(half.x - inset, half.y - inset, -thickness), dark));
    }
    let surface = FurnitureSurface::open(FurnitureRole::Tabletop, Point3::origin(), half, 1.0);
    Furniture { fixtures, surfaces: vec![surface], outlook: Outlook::AROUND }
}

/// A round top on a column: four crossed boxes, whose union is a regular octagon. (A single cylinder will not do: the engine knows four
/// points of its face only, and what stands beyond them is not carried well.)
fn round_table(radius: f64, thickness: f64, height: f64, color: [u8; 3]) -> Furniture {
    const EIGHTH: f64 = std::f64::consts::FRAC_PI_8;
    let size = Vector3::new(radius * EIGHTH.cos(), radius * EIGHTH.sin(), thickness / 2.0);
    let mut fixtures: Vec<Fixture> = (0..4)
        .map(|k| {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 2.0 * EIGHTH * f64::from(k));
            let pose = Isometry3::from_parts(Translation3::new(0.0, 0.0, -thickness / 2.0), turn);
            Fixture::new(FurnitureRole::Tabletop, size, pose, color)
        })
        .collect();
    let foot = Point3::new(0.05, 0.05, -thickness);
    fixtures.push(Fixture::between(FurnitureRole::TableBase, Point3::new(-0.05, -0.05, -height), foot, shaded(color, 0.8)));
    // The largest square within the octagon.
    let inside = radius * EIGHTH.cos() / (1.0 + EIGHTH.tan());
    let surface = FurnitureSurface::open(FurnitureRole::Tabletop, Point3::origin(), Vector2::repeat(inside), 1.0);
    Furniture { fixtures, surfaces: vec![surface], outlook: Outlook::AROUND }
}

/// A desk: a rectangular table as large as those people work at, often before a wall; a fixed table stays what it is.
pub(super) fn desk(table: &Table, rng: &mut impl Rng) -> Furniture {
    match table {
        Table::Fixed { .. } => table.furniture(rng),
        Table::Random { .. } => Table::Random { half_m: [0.4, 0.75], height_m: [0.68, 0.78], round: 0.0, wall: 0.4 }.furniture(rng),
    }
}

/// A table with one or two large boxes on it, as the paper's robot had them.
pub(super) fn with_large_box(table: &Table, rng: &mut impl Rng) -> Furniture {
    let mut built = table.furniture(rng);
    let tabletop = built.surfaces[0];
    let boxes = if rng.random_bool(0.2) { 2 } else { 1 };
    let mut placed: Vec<(Vector2<f64>, f64)> = Vec::new();
    for _ in 0..20 {
        if placed.len() == boxes {
            break;
        }
        let size = Vector3::new(rng.random_range(0.09..0.2), rng.random_range(0.08..0.16), rng.random_range(0.03..0.13));
        let reach = size.xy().norm();
        let room: Vector2<f64> = tabletop.half_extents_m.map(|h| h - reach);
        if room.min() <= 0.0 {
            continue;
        }
        let at = Vector2::new(rng.random_range(-room.x..room.x), rng.random_range(-room.y..room.y));
        if placed.iter().any(|(other, radius)| (at - other).norm() < radius + reach) {
            continue;
        }
        placed.push((at, reach));
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(-1.6..1.6));
        let pose = tabletop.world_from_surface * Isometry3::from_parts(Translation3::new(at.x, at.y, size.z), yaw);
        let cardboard = shaded([188, 150, 104], rng.random_range(0.75..1.2));
        let color = if rng.random_bool(0.6) { cardboard } else { crate::objects::color::random_color(rng) };
        built.fixtures.push(Fixture::new(FurnitureRole::LargeBox, size, pose, color));
        let lifted = pose * Translation3::new(0.0, 0.0, size.z);
        let surface = FurnitureSurface {
            role: FurnitureRole::LargeBox,
            world_from_surface: lifted,
            half_extents_m: size.xy(),
            clear_m: f64::INFINITY,
            weight: 0.8,
        };
        built.surfaces.push(surface);
    }
    built
}
