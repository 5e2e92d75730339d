//! Places on a table: upright, apart from everything else, beside another object or on top of it.

use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::RngExt;
use rand_pcg::Pcg64;
use repose_simulator::contact::PlacedParts;
use repose_simulator::objects::ObjectShape;

/// Air under what is put down, metres.
const AIR_M: f64 = 0.0005;
/// How far from the table's edge everything stands, metres.
const EDGE_M: f64 = 0.03;
/// Draws for one place.
const TRIES: usize = 80;

/// A table, seen from above, and what keeps its places on it.
#[derive(Debug, Clone)]
pub struct Layout {
    /// Half the table's edges; its middle is the origin, its top z = 0.
    pub half_m: Vector2<f64>,
    /// Least distance between things, metres: room for a finger.
    pub margin_m: f32,
    taken: Vec<PlacedParts>,
}

impl Layout {
    /// An empty table.
    pub fn new(half_m: Vector2<f64>, margin_m: f32) -> Self {
        Self { half_m, margin_m, taken: Vec::new() }
    }

    /// Nothing else may come near an object at this place.
    pub fn keep(&mut self, shape: &ObjectShape, world_from_object: &Isometry3<f64>) {
        self.taken.extend(PlacedParts::new(&shape.parts, world_from_object));
    }

    /// A free place anywhere on the table.
    pub fn anywhere(&self, shape: &ObjectShape, rng: &mut Pcg64) -> Option<Isometry3<f64>> {
        (0..TRIES).find_map(|_| {
            let at = self.half_m.map(|half| rng.random_range(-half..half));
            let placed = on_table(shape, at, any_yaw(rng));
            (self.is_on_table(shape, &placed) && self.is_free(shape, &placed)).then_some(placed)
        })
    }

    /// A free place on the table beside another object, as near as the layout lets it be and up to a centimetre farther.
    pub fn beside(&self, shape: &ObjectShape, other: (&ObjectShape, &Isometry3<f64>), rng: &mut Pcg64) -> Option<Isometry3<f64>> {
        const STEP_M: f64 = 0.005;
        const STEPS: u32 = 60;
        let neighbour = PlacedParts::new(&other.0.parts, other.1)?;
        (0..TRIES / 2).find_map(|_| {
            let direction = any_yaw(rng) * Vector3::x();
            let yaw = any_yaw(rng);
            let gap_m = self.margin_m + rng.random_range(0.001..0.01);
            let at = |step: u32| on_table(shape, other.1.translation.vector.xy() + direction.xy() * (f64::from(step) * STEP_M), yaw);
            let is_clear =
                |placed: &Isometry3<f64>| PlacedParts::new(&shape.parts, placed).is_some_and(|p| !p.is_within(&neighbour, gap_m));
            let placed = (1..STEPS).map(at).find(is_clear)?;
            (self.is_on_table(shape, &placed) && self.is_free(shape, &placed)).then_some(placed)
        })
    }

    fn is_free(&self, shape: &ObjectShape, placed: &Isometry3<f64>) -> bool {
        PlacedParts::new(&shape.parts, placed).is_some_and(|parts| self.taken.iter().all(|other| !parts.is_within(other, self.margin_m)))
    }

    fn is_on_table(&self, shape: &ObjectShape, placed: &Isometry3<f64>) -> bool {
        let within = |corner: &nalgebra::Point3<f64>| (0..2).all(|k| corner[k].abs() <= self.half_m[k] - EDGE_M);
        shape.bounds(placed).corners().iter().all(within)
    }
}

/// The place on top of another object, in the middle of its top; none where its top is too small for it, or has room for a second one
/// where only one shall fit.
pub fn on_top(shape: &ObjectShape, other: (&Arc<ObjectShape>, &Isometry3<f64>), only_one: bool) -> Option<Isometry3<f64>> {
    const OF_TOP: f64 = 0.95;
    let top = other.0.top?;
    let half = |k: usize| f64::from(top.half_extents_m[k]);
    let fits = (0..2).all(|k| shape.half_extents_m[k] <= OF_TOP * half(k));
    // Two of them fit where either edge is as long as two.
    let fits_two = (0..2).any(|k| 2.0 * shape.half_extents_m[k] <= half(k));
    if !fits || only_one && fits_two {
        return None;
    }
    let height_m = f64::from(top.height_m) + shape.half_extents_m.z + AIR_M;
    Some(other.1 * Translation3::new(f64::from(top.center_m[0]), f64::from(top.center_m[1]), height_m))
}

fn on_table(shape: &ObjectShape, at: Vector2<f64>, yaw: UnitQuaternion<f64>) -> Isometry3<f64> {
    let height_m = shape.depth_below_origin_m(&Isometry3::identity()) + AIR_M;
    Isometry3::from_parts(Translation3::new(at.x, at.y, height_m), yaw)
}

fn any_yaw(rng: &mut Pcg64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(-std::f64::consts::PI..std::f64::consts::PI))
}
