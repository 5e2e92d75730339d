//! What the fingers hold stays as it was grasped, while the hand lifts it, waits, carries it and turns.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use parry3d::shape::SharedShape;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_panda::kinematics::TCP_M;
use repose_proto::robot::GripperCommand;
use repose_simulator::objects::body::{Body, Finish};
use repose_simulator::objects::{Family, ObjectShape};
use repose_simulator::physics::{PhysicsSettings, World};
use repose_simulator::robot::{HandSettings, SimulatedHand};

/// How far below an object's top it is grasped, metres, and the lowest that the grasp centre goes.
const DEPTH_M: f64 = 0.025;
const LOWEST_M: f64 = 0.017;

/// A hand that points down, its grasp centre at a place, turned about the vertical; the fingers close along y at first.
fn world_from_hand(place: Vector3<f64>, turn_rad: f64) -> Isometry3<f64> {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    Isometry3::from_parts(
        Translation3::from(place + Vector3::z() * TCP_M),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn_rad) * down,
    )
}

/// Grasps the object `aside_m` from its middle along its longer side, and moves it about for five seconds. How far it shifted (metres) and
/// turned (radians) in the hand since the fingers had closed.
fn shift_in_hand(shape: &ObjectShape, aside_m: f64, force_n: f64) -> (f64, f64) {
    let mut world = World::new(PhysicsSettings::grasping());
    world.add_fixture(SharedShape::cuboid(1.0, 1.0, 0.05), &Isometry3::translation(0.0, 0.0, -0.05), 0.6);
    let half = shape.half_extents_m;
    let upright = if half.x < half.y { std::f64::consts::FRAC_PI_2 } else { 0.0 };
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), upright);
    world.add_object(shape, &Isometry3::from_parts(Translation3::new(0.0, 0.0, half.z), turned));
    let low = Vector3::new(aside_m, 0.0, (2.0 * half.z - DEPTH_M).max(LOWEST_M));
    let high = low + Vector3::z() * 0.1;
    let away = high + Vector3::x() * 0.3;
    let mut hand = SimulatedHand::new(&mut world, &world_from_hand(low, 0.0), HandSettings::default());
    let go = |world: &mut World,
              hand: &mut SimulatedHand,
              (from, from_rad): (Vector3<f64>, f64),
              (to, to_rad): (Vector3<f64>, f64),
              seconds: f64| {
        let steps = (seconds / f64::from(world.step_s())) as usize;
        for k in 1..=steps {
            let s = repose_panda::smooth_step(k as f64 / steps as f64);
            hand.before_step(world, &world_from_hand(from.lerp(&to, s), from_rad + s * (to_rad - from_rad)));
            world.step();
        }
        world_from_hand(to, to_rad).inverse() * world.world_from_object(0)
    };
    hand.command(&GripperCommand { width_m: 0.0, force_n });
    let grasped = go(&mut world, &mut hand, (low, 0.0), (low, 0.0), 1.5);
    assert!(hand.is_holding(&mut world), "{} is not held", shape.name);
    go(&mut world, &mut hand, (low, 0.0), (high, 0.0), 1.0);
    go(&mut world, &mut hand, (high, 0.0), (high, 0.0), 1.5);
    go(&mut world, &mut hand, (high, 0.0), (away, 0.0), 1.0);
    let end = go(&mut world, &mut hand, (away, 0.0), (away, 1.5), 1.5);
    ((end.translation.vector - grasped.translation.vector).norm(), end.rotation.angle_to(&grasped.rotation))
}

#[test]
fn what_is_held_neither_creeps_nor_lags_behind_a_hand_that_turns() {
    let mut held = 0;
    for seed in 0..40 {
        let mut rng = Pcg64::seed_from_u64(seed);
        let family = [Family::Box, Family::Can, Family::Cylinder][seed as usize % 3];
        let shape = family.sample(0.8, &mut rng);
        let half = shape.half_extents_m;
        if half.x.min(half.y) > 0.034 || half.z < 0.02 {
            continue;
        }
        // Off the middle by up to 3 cm, where there is so much of it.
        let aside_m = if family == Family::Box { (half.x.max(half.y) - 0.015).clamp(0.0, 0.03) } else { 0.0 };
        let (by_m, turn_rad) = shift_in_hand(&shape, aside_m, 30.0);
        println!("{} {:.0} g, {:.0} mm aside: {:.2} mm, {:.3} rad", shape.name, shape.mass_kg * 1e3, aside_m * 1e3, by_m * 1e3, turn_rad);
        assert!(by_m < 0.003 && turn_rad < 0.03, "{} (seed {seed}): {by_m} m, {turn_rad} rad", shape.name);
        held += 1;
    }
    assert!(held >= 10, "{held}");
}

#[test]
fn fingers_stand_still_while_the_hand_turns_and_its_rotation_is_told_by_either_quaternion() {
    let mut world = World::new(PhysicsSettings::grasping());
    let place = |k: u32| {
        let pose = world_from_hand(Vector3::new(0.0, 0.0, 0.3), 0.004 * f64::from(k));
        let rotation = pose.rotation.into_inner();
        let told = if k % 70 < 35 { rotation } else { -rotation };
        Isometry3::from_parts(pose.translation, UnitQuaternion::new_unchecked(told))
    };
    let mut hand = SimulatedHand::new(&mut world, &place(0), HandSettings::default());
    hand.command(&GripperCommand { width_m: 0.04, force_n: 30.0 });
    for k in 0..3000 {
        hand.before_step(&mut world, &place(k));
        world.step();
        let width_m = hand.width_m(&mut world);
        assert!(k < 1000 || (width_m - 0.04).abs() < 0.001, "{width_m} m after {k} steps");
    }
}

#[test]
fn thin_things_are_held_however_the_fingers_tremble() {
    for width_mm in [6u8, 10, 14, 16, 18, 24] {
        let mut body = Body::default();
        body.brick([0.0; 3], [0.1, f32::from(width_mm) * 1e-3, 0.06]);
        let shape = body.finish(&Finish { name: "slab", mass_kg: 0.05, friction: 0.6, top: None, opening: None });
        // Asserts that it is held.
        let (by_m, turn_rad) = shift_in_hand(&shape, 0.0, 70.0);
        assert!(by_m < 0.003 && turn_rad < 0.03, "{width_mm} mm: {by_m} m, {turn_rad} rad");
    }
}

#[test]
fn what_is_too_heavy_for_the_grip_slips() {
    let mut rng = Pcg64::seed_from_u64(0);
    let mut shape = Family::Box.sample(0.8, &mut rng);
    while shape.half_extents_m.xy().min() > 0.034 || shape.half_extents_m.z < 0.03 {
        shape = Family::Box.sample(0.8, &mut rng);
    }
    (shape.mass_kg, shape.friction) = (1.5, 0.3);
    // 14.7 N of weight against 2 × 5 N of grip at a friction of 0.6.
    assert!(shift_in_hand(&shape, 0.0, 5.0).0 > 0.03);
    assert!(shift_in_hand(&shape, 0.0, 60.0).0 < 0.003);
}

#[test]
fn what_is_let_go_drops_upright_where_it_was_held() {
    let mut dropped = 0;
    for seed in 0..60 {
        let shape = Family::Box.sample(0.8, &mut Pcg64::seed_from_u64(seed));
        let half = shape.half_extents_m;
        // Tall enough to topple when it is let go at a slant, and no smaller than what stands after a fall of two centimetres.
        if half.x.min(half.y) > 0.034 || half.x.min(half.y) < 0.012 || half.z < 0.035 || half.z > 3.0 * half.x.min(half.y) {
            continue;
        }
        let mut world = World::new(PhysicsSettings::grasping());
        world.add_fixture(SharedShape::cuboid(1.0, 1.0, 0.05), &Isometry3::translation(0.0, 0.0, -0.05), 0.6);
        let upright = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), if half.x < half.y { std::f64::consts::FRAC_PI_2 } else { 0.0 });
        world.add_object(&shape, &Isometry3::from_parts(Translation3::new(0.0, 0.0, half.z), upright));
        // Held 8 mm beside its middle: as the grip let go slowly, it would swing down about the pads.
        let place = |z: f64| world_from_hand(Vector3::new(0.008, 0.0, (2.0 * half.z - DEPTH_M).max(LOWEST_M) + z), 0.0);
        let mut hand = SimulatedHand::new(&mut world, &place(0.0), HandSettings::default());
        let mut go = |command: GripperCommand, from: f64, to: f64| {
            hand.command(&command);
            for k in 1..=750 {
                hand.before_step(&mut world, &place(from + (to - from) * repose_panda::smooth_step(f64::from(k) / 750.0)));
                world.step();
            }
            world.world_from_object(0)
        };
        let close = GripperCommand { width_m: 0.0, force_n: 30.0 };
        go(close, 0.0, 0.0);
        let held = go(close, 0.0, 0.02);
        let stands = go(GripperCommand { width_m: 0.08, force_n: 30.0 }, 0.02, 0.02);
        let aside_m = (stands.translation.vector - held.translation.vector).xy().norm();
        let tilt_rad = (stands.rotation * Vector3::z()).angle(&Vector3::z());
        println!("seed {seed}: {:.0} mm high, {:.1} mm aside, {tilt_rad:.3} rad", 2e3 * half.z, aside_m * 1e3);
        assert!(aside_m < 0.005 && tilt_rad < 0.02, "seed {seed}: {aside_m} m, {tilt_rad} rad");
        dropped += 1;
    }
    assert!(dropped >= 5, "{dropped}");
}
