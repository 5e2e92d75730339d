//! What is put where before physics runs.
//!
//! Objects that only fall are never centred to a millimetre nor side by side, so most are placed on purpose: upright or lying on a
//! surface, beside another (touching it or not), on top of one (often centred), into a vessel; the rest fall from a random height in a
//! random orientation.

use std::sync::Arc;

use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, RngExt};

use crate::contact::PlacedParts;
use crate::objects::{Family, Shape};
use crate::scene::{Fixture, Rejected, SceneObject};

/// How scenes are arranged.
#[derive(Debug, Clone, PartialEq)]
pub struct ArrangeSettings {
    /// Fewest and most objects.
    pub objects: [usize; 2],
    /// Families to draw from, each as likely as it is often listed.
    pub families: Vec<Family>,
    /// Smallest and largest scale of an object's usual size.
    pub scale: [f32; 2],
    /// The table.
    pub table: Table,
    /// Half the edge of the square within which objects are put, lowest and highest, metres.
    pub spread_m: [f64; 2],
    /// Highest that something may be for another to be put on top of it, metres.
    pub highest_stack_m: f64,
    /// Lowest and highest friction coefficient of an object.
    pub friction: [f32; 2],
    /// How likely a scene has one or two supports (boxes as furniture) on its table.
    pub supports: f64,
    /// How likely each way of placing an object is; need not sum to 1.
    pub ways: Ways,
    /// How likely a stacked object stands centred on the other.
    pub centered: f64,
    /// How likely an object beside another touches it.
    pub touching: f64,
    /// How likely an object takes over the orientation of the one it stands by.
    pub aligned: f64,
}

/// The table of a scene; its top is z = 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Table {
    /// Around the origin, of random size, objects anywhere on it.
    Random {
        /// Half its edge lengths, lowest and highest, metres.
        half_m: [f64; 2],
    },
    /// Always the same one, objects around a given point.
    Fixed {
        /// Its corner of least (x, y).
        low: Point2<f64>,
        /// Its corner of greatest (x, y).
        high: Point2<f64>,
        /// Where objects are put around.
        middle: Point2<f64>,
    },
}

/// Weights of the ways to place an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ways {
    /// Somewhere on the table or a support.
    pub surface: f64,
    /// Beside an object.
    pub beside: f64,
    /// On top of an object.
    pub on_top: f64,
    /// Into a vessel.
    pub into: f64,
    /// Falling, in any orientation.
    pub falling: f64,
}

impl Default for ArrangeSettings {
    fn default() -> Self {
        use Family::{Bottle, Bowl, Box, Can, Compound, Cup, Cylinder, Mug, Plate, Pot, Tool};
        Self {
            objects: [3, 7],
            families: vec![
                Box, Box, Box, Box, Cylinder, Cylinder, Can, Bottle, Bottle, Mug, Mug, Cup, Bowl, Bowl, Plate, Pot, Compound, Tool,
            ],
            scale: [0.75, 1.25],
            table: Table::Random { half_m: [0.4, 0.7] },
            spread_m: [0.14, 0.3],
            highest_stack_m: 0.28,
            friction: [0.45, 0.9],
            supports: 0.3,
            ways: Ways { surface: 0.32, beside: 0.22, on_top: 0.32, into: 0.04, falling: 0.1 },
            centered: 0.75,
            touching: 0.6,
            aligned: 0.6,
        }
    }
}

/// Clearance at which things are put down: enough not to overlap, too little to gain speed over.
const PUT_DOWN_M: f64 = 0.0003;
/// Draws per object before it is left out.
const TRIES: usize = 25;

/// Furniture and objects, not settled yet.
///
/// # Errors
/// [`Rejected::NoRoom`] when fewer objects than `settings.objects[0]` found a place.
pub fn arranged(settings: &ArrangeSettings, rng: &mut impl Rng) -> Result<(Vec<Fixture>, Vec<SceneObject>), Rejected> {
    let wanted = rng.random_range(settings.objects[0]..=settings.objects[1].max(settings.objects[0]));
    let mut arrangement = Arrangement::furnished(settings, rng);
    for _ in 0..wanted {
        arrangement.add(settings, rng);
    }
    if arrangement.placed.len() < settings.objects[0] {
        return Err(Rejected::NoRoom { placed: arrangement.placed.len(), wanted });
    }
    let objects = arrangement.placed.into_iter().enumerate().map(|(i, p)| SceneObject {
        id: i as u16 + 1,
        shape: p.shape,
        world_from_object: p.world_from_object,
        color: random_color(rng),
    });
    let objects = objects.collect();
    Ok((arrangement.fixtures, objects))
}

/// A random color of medium to high brightness, so that shading shows.
pub fn random_color(rng: &mut impl Rng) -> [u8; 3] {
    let (hue, saturation, value) = (rng.random_range(0.0..6.0f32), rng.random_range(0.25..0.85f32), rng.random_range(0.6..0.98f32));
    let channel = |shift: f32| {
        let k = (shift + hue) % 6.0;
        (value * (1.0 - saturation * k.min(4.0 - k).clamp(0.0, 1.0)) * 255.0) as u8
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

struct Placed {
    shape: Arc<Shape>,
    world_from_object: Isometry3<f64>,
    parts: PlacedParts,
    /// Height of what it stands on; `None` while it falls.
    stands_at_m: Option<f64>,
    /// Whether its own z axis is up.
    upright: bool,
    /// Whether something has been put on it.
    taken: bool,
}

struct Arrangement {
    fixtures: Vec<Fixture>,
    placed: Vec<Placed>,
    middle: Vector2<f64>,
    spread_m: f64,
}

impl Arrangement {
    fn furnished(settings: &ArrangeSettings, rng: &mut impl Rng) -> Self {
        let mut between = |[low, high]: [f64; 2]| rng.random_range(low..=high);
        let spread_m = between(settings.spread_m);
        let floor_m = -between([0.45, 0.8]);
        let (low, high, middle) = match settings.table {
            Table::Fixed { low, high, middle } => (low, high, middle.coords),
            Table::Random { half_m } => {
                let half = Vector2::new(between(half_m), between(half_m));
                let off_center = Vector2::new(between([-0.8, 0.8]), between([-0.8, 0.8]));
                let middle = half.map(|h| (h - spread_m).max(0.0)).component_mul(&off_center);
                (Point2::from(-half), Point2::from(half), middle)
            }
        };
        let wood = random_color(rng).map(|c| (f32::from(c) * 0.5 + 90.0) as u8);
        let mut fixtures = vec![
            Fixture::between("table", Point3::new(low.x, low.y, -0.04), Point3::new(high.x, high.y, 0.0), wood),
            Fixture::between("floor", Point3::new(-3.0, -3.0, floor_m - 0.05), Point3::new(3.0, 3.0, floor_m), [150, 146, 140]),
        ];
        if rng.random_bool(settings.supports) {
            for _ in 0..rng.random_range(1..=2) {
                let size = Vector3::new(rng.random_range(0.07..0.16), rng.random_range(0.07..0.16), rng.random_range(0.02..0.09));
                let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(-1.6..1.6));
                let at = middle + Vector2::new(rng.random_range(-spread_m..spread_m), rng.random_range(-spread_m..spread_m));
                let support =
                    Fixture::new("support", size, Isometry3::from_parts(Translation3::new(at.x, at.y, size.z), yaw), random_color(rng));
                let apart = fixtures[2..].iter().all(|f| (f.world_from_fixture.translation.vector.xy() - at).norm() > 0.42);
                let on_table = (0..2).all(|k| at[k] - 0.2 > low[k] && at[k] + 0.2 < high[k]);
                if apart && on_table {
                    fixtures.push(support);
                }
            }
        }
        Self { fixtures, placed: Vec::new(), middle, spread_m }
    }

    /// Finds a place for one more object; leaves it out when there is none.
    fn add(&mut self, settings: &ArrangeSettings, rng: &mut impl Rng) {
        let family = settings.families[rng.random_range(0..settings.families.len())];
        let scale = rng.random_range(settings.scale[0]..=settings.scale[1]);
        let mut shape = family.sample(scale, rng);
        shape.friction = rng.random_range(settings.friction[0]..=settings.friction[1]);
        let shape = Arc::new(shape);
        for _ in 0..TRIES {
            let ways = &settings.ways;
            let weights = [ways.surface, ways.beside, ways.on_top, ways.into, ways.falling];
            let mut ticket = rng.random_range(0.0..weights.iter().sum::<f64>());
            let way = weights.iter().position(|w| {
                ticket -= w;
                ticket < 0.0
            });
            let found = match way {
                Some(1) => self.beside(&shape, settings, rng),
                Some(2) => self.on_top(&shape, settings, rng),
                Some(3) => self.inside_vessel(&shape, rng),
                Some(4) => self.falling(&shape, rng),
                _ => self.on_surface(&shape, rng),
            };
            if let Some(placed) = found {
                self.placed.push(placed);
                return;
            }
        }
    }

    fn on_surface(&self, shape: &Arc<Shape>, rng: &mut impl Rng) -> Option<Placed> {
        let supports = &self.fixtures[2..];
        let (at, height_m) = if !supports.is_empty() && rng.random_bool(0.4) {
            let support = &supports[rng.random_range(0..supports.len())];
            let (x, y) = (rng.random_range(-0.7..0.7) * support.half_extents_m.x, rng.random_range(-0.7..0.7) * support.half_extents_m.y);
            ((support.world_from_fixture * Point3::new(x, y, 0.0)).coords.xy(), support.top_m())
        } else {
            let mut offset = || rng.random_range(-self.spread_m..self.spread_m);
            (self.middle + Vector2::new(offset(), offset()), 0.0)
        };
        let lying = rng.random_bool(0.2);
        let rotation = yawed(if lying { lying_rotation(rng) } else { UnitQuaternion::identity() }, rng);
        self.put_down(shape, rotation, at, height_m, !lying, 0.004)
    }

    fn beside(&self, shape: &Arc<Shape>, settings: &ArrangeSettings, rng: &mut impl Rng) -> Option<Placed> {
        let anchor = self.pick(rng, |p| p.stands_at_m.is_some() && p.upright)?;
        let height_m = anchor.stands_at_m?;
        let along_axis = rng.random_bool(0.6);
        let rotation =
            if rng.random_bool(settings.aligned) { anchor.world_from_object.rotation } else { yawed(UnitQuaternion::identity(), rng) };
        let turn = if along_axis { f64::from(rng.random_range(0..4u8)) * std::f64::consts::FRAC_PI_2 } else { rng.random_range(-3.2..3.2) };
        let direction = anchor.world_from_object.rotation * Vector3::new(turn.cos(), turn.sin(), 0.0);
        let gap_m = if rng.random_bool(settings.touching) { rng.random_range(0.0001..0.0004) } else { rng.random_range(0.003..0.06) };
        let from = anchor.world_from_object.translation.vector;
        let mut reach = anchor.shape.radius_m() + shape.radius_m() + 0.05;
        // Walks up to the anchor by the remaining distance; from outside that never passes the gap.
        for _ in 0..60 {
            let at = from + direction * reach;
            let placed = self.put_down(shape, rotation, at.xy(), height_m, true, 0.0)?;
            let excess = f64::from(placed.parts.distance_m(&anchor.parts)) - gap_m;
            if excess < 1e-4 {
                return self.free(&placed, 0.00005).then_some(placed);
            }
            reach -= excess;
        }
        None
    }

    fn on_top(&mut self, shape: &Arc<Shape>, settings: &ArrangeSettings, rng: &mut impl Rng) -> Option<Placed> {
        let (centered, aligned) = (rng.random_bool(settings.centered), rng.random_bool(settings.aligned));
        let shift = if centered { [0.0; 2] } else { [rng.random_range(-0.6..0.6), rng.random_range(-0.6..0.6)] };
        let own_yaw = yawed(UnitQuaternion::identity(), rng);
        let index = self.pick_index(rng, |p| p.upright && !p.taken && p.shape.top.is_some() && p.stands_at_m.is_some())?;
        let anchor = &self.placed[index];
        let top = anchor.shape.top?;
        let local = |k: usize| f64::from(top.center_m[k]) + shift[k] * f64::from(top.half_extents_m[k]);
        let local = Point3::new(local(0), local(1), f64::from(top.height_m));
        let at = anchor.world_from_object * local;
        if at.z > settings.highest_stack_m {
            return None;
        }
        let rotation = if aligned { anchor.world_from_object.rotation } else { own_yaw };
        let placed = self.put_down(shape, rotation, at.coords.xy(), at.z, true, 0.0001)?;
        self.placed[index].taken = true;
        Some(placed)
    }

    fn inside_vessel(&mut self, shape: &Arc<Shape>, rng: &mut impl Rng) -> Option<Placed> {
        let rotation = random_rotation(rng);
        let open = |p: &Placed| p.shape.opening.is_some();
        let index = self.pick_index(rng, |p| open(p) && p.upright && !p.taken && p.stands_at_m.is_some())?;
        let vessel = &self.placed[index];
        let at = vessel.world_from_object.translation.vector;
        let mut placed = self.put_down(shape, rotation, at.xy(), at.z + vessel.shape.half_extents_m.z + 0.01, false, 0.0005)?;
        placed.stands_at_m = None;
        self.placed[index].taken = true;
        Some(placed)
    }

    fn falling(&self, shape: &Arc<Shape>, rng: &mut impl Rng) -> Option<Placed> {
        let reach = self.spread_m * 0.7;
        let at = self.middle + Vector2::new(rng.random_range(-reach..reach), rng.random_range(-reach..reach));
        let highest = self.placed.iter().map(|p| f64::from(p.parts.bounds().max.z)).fold(0.1, f64::max);
        let rotation = random_rotation(rng);
        let mut placed = self.put_down(shape, rotation, at, highest + rng.random_range(0.01..0.08), false, 0.002)?;
        placed.stands_at_m = None;
        Some(placed)
    }

    /// The object with this rotation, lowest point just over `height_m`; `None` when it is closer than `margin_m` to anything (0: unchecked)
    /// or off the table.
    fn put_down(
        &self,
        shape: &Arc<Shape>,
        rotation: UnitQuaternion<f64>,
        at: Vector2<f64>,
        height_m: f64,
        upright: bool,
        margin_m: f32,
    ) -> Option<Placed> {
        let turned = Isometry3::from_parts(Translation3::identity(), rotation);
        let height = height_m + shape.depth_below_origin_m(&turned) + PUT_DOWN_M;
        let world_from_object = Isometry3::from_parts(Translation3::new(at.x, at.y, height), rotation);
        let parts = PlacedParts::new(&shape.parts, &world_from_object)?;
        let (table, bounds) = (&self.fixtures[0], parts.bounds());
        let on_table = (0..2).all(|k| {
            let (center, half) = (table.world_from_fixture.translation.vector[k], table.half_extents_m[k]);
            f64::from(bounds.min[k]) > center - half && f64::from(bounds.max[k]) < center + half
        });
        let placed = Placed { shape: shape.clone(), world_from_object, parts, stands_at_m: Some(height_m), upright, taken: false };
        (on_table && (margin_m == 0.0 || self.free(&placed, margin_m))).then_some(placed)
    }

    /// Whether the object keeps `margin_m` to all others, and does not stand in a support.
    fn free(&self, placed: &Placed, margin_m: f32) -> bool {
        let bounds = placed.parts.bounds();
        let clear_of_supports = self.fixtures[2..].iter().all(|f| {
            let half = f.half_extents_m.xy().norm();
            let offset = f.world_from_fixture.translation.vector.xy() - placed.world_from_object.translation.vector.xy();
            f64::from(bounds.min.z) >= f.top_m() || offset.norm() > half + placed.shape.radius_m()
        });
        clear_of_supports && self.placed.iter().all(|other| placed.parts.distance_m(&other.parts) > margin_m)
    }

    fn pick_index(&self, rng: &mut impl Rng, fits: impl Fn(&Placed) -> bool) -> Option<usize> {
        let fitting: Vec<usize> = (0..self.placed.len()).filter(|&i| fits(&self.placed[i])).collect();
        (!fitting.is_empty()).then(|| fitting[rng.random_range(0..fitting.len())])
    }

    fn pick(&self, rng: &mut impl Rng, fits: impl Fn(&Placed) -> bool) -> Option<&Placed> {
        self.pick_index(rng, fits).map(|i| &self.placed[i])
    }
}

fn yawed(rotation: UnitQuaternion<f64>, rng: &mut impl Rng) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(-std::f64::consts::PI..std::f64::consts::PI)) * rotation
}

/// Onto one of the sides, or upside down.
fn lying_rotation(rng: &mut impl Rng) -> UnitQuaternion<f64> {
    const QUARTER: f64 = std::f64::consts::FRAC_PI_2;
    match rng.random_range(0..5) {
        0 => UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
        1 | 2 => UnitQuaternion::from_axis_angle(&Vector3::x_axis(), QUARTER),
        _ => UnitQuaternion::from_axis_angle(&Vector3::y_axis(), QUARTER),
    }
}

/// Uniform over all rotations (Shoemake: a random unit quaternion).
fn random_rotation(rng: &mut impl Rng) -> UnitQuaternion<f64> {
    let (u, a, b) =
        (rng.random_range(0.0..1.0f64), rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(0.0..std::f64::consts::TAU));
    let (p, q) = ((1.0 - u).sqrt(), u.sqrt());
    UnitQuaternion::new_normalize(nalgebra::Quaternion::new(q * b.cos(), p * a.sin(), p * a.cos(), q * b.sin()))
}
