//! Whether the arm gets to an object and to a place for it, by true shapes and the arm's kinematics alone: what a trial may ask for.
//!
//! The hand comes from straight above, across the object where the fingers can span it, with palm and fingers clear of everything else; at the
//! place it has the same turn to the object as at the start, for it is one grasp that carries it. Nothing that was seen, planned or believed counts.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use repose_panda::{FINGER_OPENING_MAX_M, InverseSettings, inverse_sweep, kinematics::hand_from_tcp};
use repose_simulator::contact::PlacedParts;
use repose_simulator::release::Surroundings;
use repose_simulator::robot::hand;
use repose_simulator::scene::SimulatedScene;

/// The widest that the fingers span with room to get over it, metres; as the second world's `GRIP_MAX_M`.
const SPAN_MAX_M: f64 = 0.075;
/// Turns of the hand that are tried, over half a turn.
const TURNS: usize = 12;
/// How far the grasp centre is below the object's top, metres.
const BELOW_TOP_M: f64 = 0.01;
/// How far straight up from there the arm must get as well, metres.
const UP_M: f64 = 0.10;
/// Room between the object and each open finger, metres.
const ROOM_M: f64 = 0.005;

/// The hand over an object, where it stands and where it may be placed.
#[derive(Debug)]
pub struct TrueReach {
    around: Surroundings,
    /// Hands that get to the object where it stands.
    hands: Vec<HandOver>,
}

/// One way of the hand over the object where it stands.
#[derive(Debug, Clone, Copy)]
struct HandOver {
    world_from_tcp: Isometry3<f64>,
    opening_m: f64,
}

impl TrueReach {
    /// For object `index` of a scene in the robot's base frame; `None` where the hand does not get to it.
    pub fn new(scene: &SimulatedScene, index: usize) -> Option<Self> {
        let (object, around) = (scene.objects.get(index)?, Surroundings::of(scene, index)?);
        let vertices: Vec<Vector3<f64>> =
            object.shape.mesh.vertices.iter().map(|v| (object.world_from_object * v.cast::<f64>()).coords).collect();
        let top_m = vertices.iter().map(|v| v.z).fold(f64::NEG_INFINITY, f64::max);
        let extent = |direction: &Vector3<f64>| {
            let along = vertices.iter().map(|v| v.dot(direction));
            along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), a| (low.min(a), high.max(a)))
        };
        let width_m = |yaw_rad: f64| {
            let (low, high) = extent(&across(yaw_rad));
            high - low
        };
        let degrees = (0..180).map(|k| f64::from(k).to_radians());
        let narrowest_rad = degrees.min_by(|a, b| width_m(*a).total_cmp(&width_m(*b)))?;
        let turns = (0..TURNS).map(|k| narrowest_rad + std::f64::consts::PI * k as f64 / TURNS as f64);
        let over = |yaw_rad: f64| {
            let (closing, along) = (across(yaw_rad), across(yaw_rad + std::f64::consts::FRAC_PI_2));
            let middle = |direction: &Vector3<f64>| {
                let (low, high) = extent(direction);
                0.5 * (low + high)
            };
            let place = closing * middle(&closing) + along * middle(&along) + Vector3::z() * (top_m - BELOW_TOP_M);
            // The approach straight down, the fingers closing along y.
            let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad - std::f64::consts::FRAC_PI_2) * down;
            let opening_m = (width_m(yaw_rad) + 2.0 * ROOM_M).min(FINGER_OPENING_MAX_M);
            HandOver { world_from_tcp: Isometry3::from_parts(place.into(), turn), opening_m }
        };
        let spanned = turns.filter(|yaw_rad| width_m(*yaw_rad) <= SPAN_MAX_M).map(over);
        let hands: Vec<HandOver> = spanned.filter(|hand| hand.gets_there(&Isometry3::identity(), &around)).collect();
        (!hands.is_empty()).then_some(Self { around, hands })
    }

    /// Whether one of the hands that get to the object gets to it at a place, too.
    pub fn gets_to(&self, placed_from_observed: &Isometry3<f64>) -> bool {
        self.hands.iter().any(|hand| hand.gets_there(placed_from_observed, &self.around))
    }
}

impl HandOver {
    /// Whether the arm gets there and straight up from there, with one half turn of the wrist or the other, the hand touching nothing.
    fn gets_there(&self, placed_from_observed: &Isometry3<f64>, around: &Surroundings) -> bool {
        let base_from_tcp = placed_from_observed * self.world_from_tcp;
        let settings = InverseSettings::default();
        let is_reached = |half_turn_rad: f64, up_m: f64| {
            let turned = base_from_tcp * Isometry3::rotation(Vector3::z() * half_turn_rad);
            !inverse_sweep(&(Translation3::new(0.0, 0.0, up_m) * turned), &settings).is_empty()
        };
        let is_reachable = [0.0, std::f64::consts::PI].into_iter().any(|turn| is_reached(turn, 0.0) && is_reached(turn, UP_M));
        let hand = PlacedParts::new(&hand::parts(self.opening_m), &(base_from_tcp * hand_from_tcp().inverse()));
        is_reachable && hand.is_some_and(|hand| !around.overlaps(&hand))
    }
}

/// The horizontal direction at an angle from the world's x, radians.
fn across(yaw_rad: f64) -> Vector3<f64> {
    Vector3::new(yaw_rad.cos(), yaw_rad.sin(), 0.0)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rand::SeedableRng;
    use rand_pcg::Pcg64;
    use repose_simulator::cell::CellSettings;
    use repose_simulator::furniture::Furniture;
    use repose_simulator::objects::ObjectShape;
    use repose_simulator::objects::body::{Body, Finish};
    use repose_simulator::scene::{SceneKind, SceneObject};

    use super::*;

    fn brick([x, y, z]: [f32; 3]) -> Arc<ObjectShape> {
        let mut body = Body::default();
        body.brick([0.0; 3], [x, y, z]);
        Arc::new(body.finish(&Finish { name: "brick", mass_kg: 0.2, friction: 0.6, top: None, opening: None }))
    }

    /// Bricks of these sizes standing on the cell's table, their middles there.
    fn scene(bricks: &[([f32; 3], [f64; 2])]) -> SimulatedScene {
        let kind = SceneKind::OpenTable;
        let table = CellSettings::default().scene.table;
        let Furniture { fixtures, surfaces, outlook } = Furniture::sample(kind, &table, &mut Pcg64::seed_from_u64(1));
        let table_m = surfaces[0].world_from_surface.translation.z;
        let stood = bricks.iter().enumerate().map(|(i, (size, [x, y]))| SceneObject {
            id: i as u16 + 1,
            shape: brick(*size),
            world_from_object: Isometry3::translation(*x, *y, table_m + f64::from(size[2]) / 2.0 + 0.0005),
            color: [0; 3],
        });
        SimulatedScene { seed: 1, kind, fixtures, surfaces, outlook, objects: stood.collect(), gaps_m: Vec::new() }
    }

    const SMALL: [f32; 3] = [0.05, 0.05, 0.10];

    #[test]
    fn the_hand_gets_to_what_it_spans_within_the_arms_reach() {
        let is_reached = |size, at| TrueReach::new(&scene(&[(size, at)]), 0).is_some();
        assert!(is_reached(SMALL, [0.5, 0.1]));
        assert!(!is_reached(SMALL, [1.1, 0.1]), "beyond the arm");
        assert!(!is_reached([0.09, 0.09, 0.10], [0.5, 0.1]), "wider than the fingers open");
    }

    #[test]
    fn a_place_is_reached_where_the_arm_gets_and_the_hand_has_room() {
        let wall = ([0.2, 0.2, 0.3], [0.5, 0.3]);
        let reach = TrueReach::new(&scene(&[(SMALL, [0.5, -0.2]), wall]), 0).expect("the hand gets to it");
        assert!(reach.gets_to(&Isometry3::translation(0.1, 0.1, 0.0)));
        assert!(!reach.gets_to(&Isometry3::translation(0.6, 0.0, 0.0)), "beyond the arm");
        // 5 mm beside something taller: the object has room, the palm over it has not.
        assert!(!reach.gets_to(&Isometry3::translation(0.0, 0.37, 0.0)));
    }

    #[test]
    fn what_stands_closely_between_taller_things_is_not_reached() {
        let beside = |y: f64| ([0.2, 0.1, 0.3], [0.5, y]);
        assert!(TrueReach::new(&scene(&[(SMALL, [0.5, 0.0]), beside(0.08), beside(-0.08)]), 0).is_none());
    }
}
