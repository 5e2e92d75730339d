//! What is put where before physics runs.
//!
//! Objects that only fall are never centred to a millimetre nor side by side, so most are placed on purpose: upright or lying on a
//! surface, beside another (touching it or not), on top of one (often centred), into a vessel; the rest fall from a random height in a
//! random orientation ([`ways`] has each). Objects gather in a [`Crowd`] per surface, or no camera would see them all.

pub mod rotation;
pub mod settings;
mod ways;

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2};
use rand::{Rng, RngExt};

pub use settings::{ArrangeSettings, Ways};

use crate::contact::PlacedParts;
use crate::furniture::{Fixture, Furniture, FurnitureSurface};
use crate::objects::{ObjectShape, color::random_color};
use crate::scene::{object::SceneObject, rejected::Rejected};

/// Clearance at which things are put down: enough not to overlap, too little to gain speed over.
const PUT_DOWN_M: f64 = 0.0003;
/// Room that stays between what is put on a covered surface and what covers it, metres.
const HEADROOM_M: f64 = 0.015;
/// Draws per object before it is left out.
const TRIES: usize = 25;

/// Objects on furniture, not settled yet. `settings` are the kind's ([`ArrangeSettings::for_kind`]).
///
/// # Errors
/// [`Rejected::NoRoom`] when fewer objects than `settings.objects[0]` found a place.
pub fn arranged(furniture: &Furniture, settings: &ArrangeSettings, rng: &mut impl Rng) -> Result<Vec<SceneObject>, Rejected> {
    let wanted = rng.random_range(settings.objects[0]..=settings.objects[1].max(settings.objects[0]));
    let mut arrangement = Arrangement::on(furniture, settings, rng);
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
    Ok(objects.collect())
}

/// An object that found its place.
struct Placed {
    shape: Arc<ObjectShape>,
    world_from_object: Isometry3<f64>,
    parts: PlacedParts,
    /// Which surface it is on, directly or by way of others.
    surface: usize,
    /// Height of what it stands on; `None` while it falls.
    stands_at_m: Option<f64>,
    /// Whether its own z axis is up.
    upright: bool,
    /// How many objects are below it in its stack.
    level: usize,
    /// How many objects have been put on it.
    carries: usize,
}

/// Where on a surface objects gather.
#[derive(Debug, Clone, Copy)]
struct Crowd {
    /// Its middle, in the surface's frame.
    middle: Vector2<f64>,
    /// Half its edge lengths, metres.
    half: Vector2<f64>,
}

struct Arrangement<'a> {
    fixtures: Vec<PlacedParts>,
    surfaces: &'a [FurnitureSurface],
    /// One for each surface.
    crowds: Vec<Crowd>,
    placed: Vec<Placed>,
}

/// How an object is to be put down.
struct PutDown {
    rotation: UnitQuaternion<f64>,
    /// Horizontal position of the object's origin, world.
    at: Vector2<f64>,
    /// Height of what it is put on, world.
    height_m: f64,
    /// Over which surface.
    surface: usize,
    /// Whether its own z axis is up.
    upright: bool,
    /// How far it keeps from all other objects, metres; 0: unchecked.
    margin_m: f32,
}

impl<'a> Arrangement<'a> {
    fn on(furniture: &'a Furniture, settings: &ArrangeSettings, rng: &mut impl Rng) -> Self {
        let fixtures = furniture.fixtures.iter().filter_map(Fixture::placed).collect();
        let surfaces = furniture.surfaces.as_slice();
        let mut crowds = vec![Crowd { middle: Vector2::zeros(), half: Vector2::zeros() }; surfaces.len()];
        let mut order: Vec<usize> = (0..surfaces.len()).collect();
        let area = |i: &usize| surfaces[*i].half_extents_m.product();
        order.sort_by(|a, b| area(a).total_cmp(&area(b)).then(a.cmp(b)));
        // The smallest surface has its crowd anywhere; the others gather as near to it as they can.
        let mut near = settings.gather_at.map(|at| Point3::new(at.x, at.y, 0.0));
        for i in order {
            let surface = &surfaces[i];
            let half = surface.half_extents_m.map(|h| h.min(rng.random_range(settings.spread_m[0]..=settings.spread_m[1])));
            let room = surface.half_extents_m - half;
            let middle = match near {
                None if rng.random_bool(settings.at_edge) => edge_point(&room, rng),
                None => room.map(|r| rng.random_range(-0.8..=0.8) * r),
                Some(near) => {
                    let at = surface.world_from_surface.inverse_transform_point(&near);
                    Vector2::new(at.x.clamp(-room.x, room.x), at.y.clamp(-room.y, room.y))
                }
            };
            if surface.weight > 0.0 && near.is_none() {
                near = Some(surface.world_from_surface * Point3::new(middle.x, middle.y, 0.0));
            }
            crowds[i] = Crowd { middle, half };
        }
        Self { fixtures, surfaces, crowds, placed: Vec::new() }
    }

    /// Finds a place for one more object; leaves it out when there is none.
    fn add(&mut self, settings: &ArrangeSettings, rng: &mut impl Rng) {
        let mut shape = sampled(settings, rng);
        if shape.top.is_none() && rng.random_bool(settings.stackable) {
            shape = sampled(settings, rng);
        }
        // Drawn for every object, so that what is known of one does not change the others.
        let friction = rng.random_range(settings.friction[0]..=settings.friction[1]);
        if !shape.is_friction_known {
            shape.friction = friction;
        }
        let shape = Arc::new(shape);
        for _ in 0..TRIES {
            let ways = &settings.ways;
            let found = match drawn(&[ways.surface, ways.beside, ways.on_top, ways.into, ways.falling], rng) {
                Some(1) => self.beside(&shape, settings, rng),
                Some(2) => self.on_top(&shape, settings, rng),
                Some(3) => self.inside_vessel(&shape, rng),
                Some(4) => self.falling(&shape, rng),
                _ => self.on_surface(&shape, settings, rng),
            };
            if let Some(placed) = found {
                self.placed.push(placed);
                return;
            }
        }
    }

    /// A random surface by weight among those that `fits` accepts.
    fn pick_surface(&self, rng: &mut impl Rng, fits: impl Fn(&FurnitureSurface) -> bool) -> Option<usize> {
        let weights: Vec<f64> = self.surfaces.iter().map(|s| if fits(s) { s.weight } else { 0.0 }).collect();
        drawn(&weights, rng)
    }

    /// A random point of a surface's crowd, world; `within` scales the crowd.
    fn crowd_point(&self, surface: usize, within: f64, rng: &mut impl Rng) -> Vector2<f64> {
        let crowd = &self.crowds[surface];
        let mut offset = |half: f64| rng.random_range(-1.0..=1.0) * half * within;
        let at = crowd.middle + Vector2::new(offset(crowd.half.x), offset(crowd.half.y));
        (self.surfaces[surface].world_from_surface * Point3::new(at.x, at.y, 0.0)).coords.xy()
    }

    /// The object as asked, its lowest point just over the height; `None` when it would stick out of its surface, into furniture, or keep
    /// less than the margin to another object.
    fn put_down(&self, shape: &Arc<ObjectShape>, how: &PutDown) -> Option<Placed> {
        let turned = Isometry3::from_parts(Translation3::identity(), how.rotation);
        let height = how.height_m + shape.depth_below_origin_m(&turned) + PUT_DOWN_M;
        let world_from_object = Isometry3::from_parts(Translation3::new(how.at.x, how.at.y, height), how.rotation);
        let surface = &self.surfaces[how.surface];
        let within = shape.bounds(&world_from_object).corners().iter().all(|corner| {
            let at = surface.world_from_surface.inverse_transform_point(corner);
            at.x.abs() <= surface.half_extents_m.x && at.y.abs() <= surface.half_extents_m.y && at.z <= surface.clear_m - HEADROOM_M
        });
        if !within {
            return None;
        }
        let placed = Placed {
            shape: shape.clone(),
            world_from_object,
            parts: PlacedParts::new(&shape.parts, &world_from_object)?,
            surface: how.surface,
            stands_at_m: Some(how.height_m),
            upright: how.upright,
            level: 0,
            carries: 0,
        };
        (how.margin_m == 0.0 || self.is_free(&placed, how.margin_m)).then_some(placed)
    }

    /// Whether the object keeps `margin_m` to all others and is not in any furniture.
    fn is_free(&self, placed: &Placed, margin_m: f32) -> bool {
        const TO_FURNITURE_M: f32 = 0.0001;
        self.fixtures.iter().all(|fixture| !placed.parts.is_within(fixture, TO_FURNITURE_M))
            && self.placed.iter().all(|other| !placed.parts.is_within(&other.parts, margin_m))
    }

    fn pick_index(&self, rng: &mut impl Rng, fits: impl Fn(&Placed) -> bool) -> Option<usize> {
        let fitting: Vec<usize> = (0..self.placed.len()).filter(|&i| fits(&self.placed[i])).collect();
        (!fitting.is_empty()).then(|| fitting[rng.random_range(0..fitting.len())])
    }
}

/// A random object.
fn sampled(settings: &ArrangeSettings, rng: &mut impl Rng) -> ObjectShape {
    let scale = rng.random_range(settings.scale[0]..=settings.scale[1]);
    Arc::unwrap_or_clone(settings.source.sample(scale, rng))
}

/// A point on the border of a rectangle around the origin.
fn edge_point(half: &Vector2<f64>, rng: &mut impl Rng) -> Vector2<f64> {
    let along: f64 = rng.random_range(-1.0..=1.0);
    match rng.random_range(0..4u8) {
        0 => Vector2::new(half.x, half.y * along),
        1 => Vector2::new(-half.x, half.y * along),
        2 => Vector2::new(half.x * along, half.y),
        _ => Vector2::new(half.x * along, -half.y),
    }
}

/// A random index by weight; `None` when no weight is positive.
fn drawn(weights: &[f64], rng: &mut impl Rng) -> Option<usize> {
    let sum: f64 = weights.iter().sum();
    if sum <= 0.0 {
        return None;
    }
    let mut ticket = rng.random_range(0.0..sum);
    let hit = weights.iter().position(|w| {
        ticket -= w;
        ticket < 0.0
    });
    // Rounding may leave a sliver above the last weight.
    hit.or_else(|| weights.iter().rposition(|w| *w > 0.0))
}
