//! The ways to place an object: on a surface, beside another, on top of one, into a vessel, falling.

use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};

use super::settings::MOST_STACKED;
use super::{ArrangeSettings, Arrangement, Placed, PutDown, rotation};
use crate::objects::{ObjectShape, VesselInterior};

/// Gap of what touches, metres: the rule of `touching` says 1 mm, and settling may open a gap a little.
const TOUCHING_M: std::ops::Range<f64> = 0.0001..0.0004;
/// Gap of what stands beside without touching, metres: well clear of what the rule of `touching` says.
const APART_M: std::ops::Range<f64> = 0.004..0.06;
/// Half a top's edge length from which a second object finds room on it, metres.
const BIG_TOP_M: f32 = 0.05;

impl Arrangement<'_> {
    /// Upright or lying, somewhere on a surface.
    pub(super) fn on_surface(&self, shape: &Arc<ObjectShape>, settings: &ArrangeSettings, rng: &mut impl Rng) -> Option<Placed> {
        let surface = self.pick_surface(rng, |_| true)?;
        let at = self.crowd_point(surface, 1.0, rng);
        let lying = rng.random_bool(settings.lying);
        let half = &shape.half_extents_m;
        let squat = half.z < 1.5 * half.xy().min();
        let rotation = rotation::yawed(if lying { rotation::lying(squat, rng) } else { UnitQuaternion::identity() }, rng);
        let height_m = self.surfaces[surface].height_m();
        self.put_down(shape, &PutDown { rotation, at, height_m, surface, upright: !lying, margin_m: 0.004 })
    }

    /// Beside an object, at the same height, touching it or clearly apart.
    pub(super) fn beside(&self, shape: &Arc<ObjectShape>, settings: &ArrangeSettings, rng: &mut impl Rng) -> Option<Placed> {
        let anchor = &self.placed[self.pick_index(rng, |p| p.stands_at_m.is_some() && p.upright && p.level == 0)?];
        let height_m = anchor.stands_at_m?;
        let along_axis = rng.random_bool(0.6);
        let aligned = rng.random_bool(settings.aligned);
        let rotation = if aligned { anchor.world_from_object.rotation } else { rotation::yawed(UnitQuaternion::identity(), rng) };
        let turn = if along_axis { f64::from(rng.random_range(0..4u8)) * std::f64::consts::FRAC_PI_2 } else { rng.random_range(-3.2..3.2) };
        let direction = anchor.world_from_object.rotation * Vector3::new(turn.cos(), turn.sin(), 0.0);
        let touching = rng.random_bool(settings.touching);
        let gap_m = rng.random_range(if touching { TOUCHING_M } else { APART_M });
        let from = anchor.world_from_object.translation.vector;
        let mut reach = anchor.shape.radius_m() + shape.radius_m() + 0.05;
        // Walks up to the anchor by the remaining distance; from outside that never passes the gap.
        for _ in 0..60 {
            let at = (from + direction * reach).xy();
            let how = PutDown { rotation, at, height_m, surface: anchor.surface, upright: true, margin_m: 0.0 };
            let placed = self.put_down(shape, &how)?;
            let excess = f64::from(placed.parts.distance_m(&anchor.parts)) - gap_m;
            if excess < 1e-4 {
                return self.is_free(&placed, 0.00005).then_some(placed);
            }
            reach -= excess;
        }
        None
    }

    /// On the top of an object, centred or not, with its orientation or another.
    pub(super) fn on_top(&mut self, shape: &Arc<ObjectShape>, settings: &ArrangeSettings, rng: &mut impl Rng) -> Option<Placed> {
        let (centered, aligned) = (rng.random_bool(settings.centered), rng.random_bool(settings.aligned));
        let own_yaw = rotation::yawed(UnitQuaternion::identity(), rng);
        let big = |p: &Placed| p.shape.top.is_some_and(|t| t.half_extents_m[0].min(t.half_extents_m[1]) > BIG_TOP_M);
        let fits = |p: &Placed| {
            let room = p.carries == 0 || (p.carries < 3 && big(p));
            p.upright && room && p.shape.top.is_some() && p.stands_at_m.is_some() && p.level + 1 < MOST_STACKED
        };
        let highest = (0..self.placed.len()).filter(|&i| fits(&self.placed[i])).max_by_key(|&i| self.placed[i].level);
        let index = if rng.random_bool(settings.tower) { highest } else { self.pick_index(rng, fits) }?;
        let anchor = &self.placed[index];
        let top = anchor.shape.top?;
        let centered = centered && anchor.carries == 0;
        let shift = if centered { [0.0; 2] } else { [rng.random_range(-0.65..0.65f32), rng.random_range(-0.65..0.65f32)] };
        let local = |k: usize| f64::from(top.center_m[k] + top.half_extents_m[k] * shift[k]);
        let local = Point3::new(local(0), local(1), f64::from(top.height_m));
        let at = anchor.world_from_object * local;
        let surface = anchor.surface;
        if at.z - self.surfaces[surface].height_m() > settings.highest_stack_m {
            return None;
        }
        let rotation = if aligned { anchor.world_from_object.rotation } else { own_yaw };
        let how = PutDown { rotation, at: at.coords.xy(), height_m: at.z, surface, upright: true, margin_m: 0.0001 };
        let level = anchor.level + 1;
        let placed = self.put_down(shape, &how)?;
        self.placed[index].carries += 1;
        Some(Placed { level, ..placed })
    }

    /// Into a vessel: stood on its floor where it fits upright, dropped in otherwise, and sometimes all the same.
    pub(super) fn inside_vessel(&mut self, shape: &Arc<ObjectShape>, rng: &mut impl Rng) -> Option<Placed> {
        let dropped = rng.random_bool(0.4);
        let turned = (rotation::yawed(UnitQuaternion::identity(), rng), rotation::any(rng));
        let open = |p: &Placed| p.shape.opening.is_some() && p.upright && p.carries == 0 && p.stands_at_m.is_some();
        let index = self.pick_index(rng, open)?;
        let (vessel, surface, level) = (&self.placed[index], self.placed[index].surface, self.placed[index].level + 1);
        let opening = vessel.shape.opening?;
        let [x, y] = opening.center_m.map(f64::from);
        let inside = |height_m: f32| vessel.world_from_object * Point3::new(x, y, f64::from(height_m));
        let how =
            |rotation, at: Point3<f64>| PutDown { rotation, at: at.coords.xy(), height_m: at.z, surface, upright: true, margin_m: 0.0001 };
        let stood = stood_in(shape, &opening, turned.0, vessel.world_from_object.rotation)
            .filter(|_| !dropped)
            .and_then(|rotation| self.put_down(shape, &how(rotation, inside(opening.floor_m))));
        let placed = match stood {
            Some(placed) => Placed { level, ..placed },
            None if shape.radius_m() < f64::from(opening.mouth_radius_m) * 1.5 => {
                let at = inside(opening.rim_m + 0.01);
                Placed { stands_at_m: None, upright: false, level, ..self.put_down(shape, &how(turned.1, at))? }
            }
            None => return None,
        };
        self.placed[index].carries += 1;
        Some(placed)
    }

    /// Falling from over everything else on an open surface, in any orientation.
    pub(super) fn falling(&self, shape: &Arc<ObjectShape>, rng: &mut impl Rng) -> Option<Placed> {
        let surface = self.pick_surface(rng, |s| s.clear_m.is_infinite())?;
        let at = self.crowd_point(surface, 0.7, rng);
        let ground_m = self.surfaces[surface].height_m();
        let below = self.placed.iter().filter(|p| p.surface == surface);
        let highest = below.map(|p| f64::from(p.parts.bounds().max.z)).fold(ground_m + 0.1, f64::max);
        let height_m = highest + rng.random_range(0.01..0.08);
        let how = PutDown { rotation: rotation::any(rng), at, height_m, surface, upright: false, margin_m: 0.002 };
        Some(Placed { stands_at_m: None, ..self.put_down(shape, &how)? })
    }
}

/// How an upright object fits on the floor of a vessel: turned in any way, only as the vessel is, or not at all.
fn stood_in(
    shape: &ObjectShape,
    opening: &VesselInterior,
    turned: UnitQuaternion<f64>,
    as_vessel: UnitQuaternion<f64>,
) -> Option<UnitQuaternion<f64>> {
    const ROOM_M: f64 = 0.001;
    let half = shape.half_extents_m.xy();
    if half.norm() + ROOM_M < f64::from(opening.radius_m) {
        return Some(turned);
    }
    (0..2).all(|k| half[k] + ROOM_M < f64::from(opening.half_extents_m[k])).then_some(as_vessel)
}
