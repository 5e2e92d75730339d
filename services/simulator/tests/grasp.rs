//! The simulated Panda picks objects up by friction, from the ready pose and back, through the command keys' own messages.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use repose_panda::{InverseSettings, Joints, READY, base_from_tcp, inverse_at};
use repose_proto::robot::{GripperCommand, Owner, RobotCommand, RobotMode, SetPoint};
use repose_simulator::cell::CellSettings;
use repose_simulator::cell_world::CellWorld;
use repose_simulator::robot::{ArmSettings, HandSettings};

/// Below the velocity limit of the slowest joint.
const FASTEST_RAD_S: f64 = 2.0;
/// Turns of the last joint that are tried for a line, to either side.
const TURNS: i32 = 12;
/// How far apart they are.
const TURN_RAD: f64 = 0.2;

/// Drives the arm along straight lines of the grasp centre, as a commander would.
struct Commander {
    seq: u64,
    q_rad: Joints,
}

impl Commander {
    fn send(&mut self, cell: &mut CellWorld, set_points: Vec<SetPoint>, gripper: Option<GripperCommand>) {
        self.seq += 1;
        let moves = !set_points.is_empty();
        let owner = Owner { id: "test".to_owned(), epoch: 1 };
        let command = RobotCommand {
            v: 1,
            seq: self.seq,
            owner,
            ttl_ms: 1000,
            starts_stream: moves,
            ends_stream: moves,
            set_points,
            gripper,
            clear_stop: false,
            clears: None,
            task: None,
        };
        cell.arm.command(&command, 0.0).expect("taken");
    }

    /// A straight line to a pose of the grasp centre in `seconds`, smooth from rest to rest. False, and no motion, when it is out of reach
    /// or passes so near a singular posture that a joint would have to race.
    fn line(&mut self, cell: &mut CellWorld, to: &Isometry3<f64>, seconds: f64) -> bool {
        let steps = (seconds * 50.0) as usize;
        // The last joint is free: it turns as smoothly as the hand moves, and as little as the other joints' limits let it.
        let mut turns: Vec<i32> = (-TURNS..=TURNS).collect();
        turns.sort_by_key(|turn| turn.abs());
        let mut paths = turns.iter().filter_map(|turn| self.path(to, f64::from(*turn) * TURN_RAD, steps));
        let Some(path) = paths.next() else { return false };
        let speed = |k: usize, i: usize| if k == 0 || k == steps { 0.0 } else { (path[k + 1][i] - path[k - 1][i]) / 0.04 };
        let points =
            (0..=steps).map(|k| SetPoint { t_ms: k as f64 * 20.0, q_rad: path[k], dq_rad_s: std::array::from_fn(|i| speed(k, i)) });
        self.send(cell, points.collect(), None);
        self.q_rad = path[steps];
        self.wait(cell, seconds + 0.05);
        true
    }

    /// Joint angles at evenly spaced instants of the line while the last joint turns by `turn_rad` in all.
    fn path(&self, to: &Isometry3<f64>, turn_rad: f64, steps: usize) -> Option<Vec<Joints>> {
        let from = base_from_tcp(&self.q_rad);
        let mut path = vec![self.q_rad];
        for k in 1..=steps {
            let s = k as f64 / steps as f64;
            let place = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
            let last = path[k - 1];
            let apart = |q: &Joints| (0..q.len()).map(|i| (q[i] - last[i]).abs()).fold(0.0, f64::max);
            let postures = inverse_at(&from.lerp_slerp(to, place), self.q_rad[6] + place * turn_rad, &InverseSettings::default());
            let q = postures.into_iter().min_by(|a, b| apart(a).total_cmp(&apart(b)))?;
            if apart(&q) > FASTEST_RAD_S / 50.0 {
                return None;
            }
            path.push(q);
        }
        Some(path)
    }

    fn grip(&mut self, cell: &mut CellWorld, width_m: f64) {
        self.send(cell, Vec::new(), Some(GripperCommand { width_m, force_n: 20.0 }));
        self.wait(cell, 1.0);
    }

    fn wait(&self, cell: &mut CellWorld, seconds: f64) {
        for _ in 0..(seconds / cell.step_s()) as usize {
            cell.step(0.0);
        }
    }
}

/// A downward grasp centre at a place, its fingers opening along the direction `yaw_rad` from world y.
fn downward(x: f64, y: f64, z: f64, yaw_rad: f64) -> Isometry3<f64> {
    let ready = base_from_tcp(&READY).rotation;
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad) * ready)
}

#[test]
fn objects_are_picked_lifted_and_carried_by_friction_alone() {
    let (mut tried, mut lifted, mut without_slip) = (0, 0, 0);
    for seed in 0..24 {
        let mut cell = CellWorld::new(seed, CellSettings::default(), ArmSettings::default(), HandSettings::default()).expect("a scene");
        let scene = cell.truth();
        let n = scene.objects.len();
        let found = scene.objects.iter().enumerate().find(|(i, o)| {
            let narrow = o.shape.half_extents_m.xy().min() * 2.0 < 0.065;
            let upright = (o.world_from_object.rotation * Vector3::z()).z > 0.99;
            let alone = (0..n).all(|j| j == *i || scene.gaps_m[i * n + j] > 0.06);
            // Bottles are not among them: their many-sided bodies slip out of flat fingers in this simulation.
            narrow && upright && alone && matches!(&*o.shape.name, "box" | "block" | "cylinder" | "can")
        });
        let Some((index, object)) = found else { continue };
        tried += 1;
        let pose = object.world_from_object;
        let half = object.shape.half_extents_m;
        let across = if half.x < half.y { 0.0 } else { std::f64::consts::FRAC_PI_2 };
        let mut yaw = repose_geometry::transform::yaw_of(&pose) + across + std::f64::consts::FRAC_PI_2;
        yaw = (yaw + std::f64::consts::FRAC_PI_2).rem_euclid(std::f64::consts::PI) - std::f64::consts::FRAC_PI_2;
        let at = pose.translation.vector;
        let height = (at.z + half.z - 0.03).max(0.012);
        let mut commander = Commander { seq: 0, q_rad: READY };
        let above = downward(at.x, at.y, height + 0.13, yaw);
        let grasp = downward(at.x, at.y, height, yaw);
        if !commander.line(&mut cell, &above, 5.0) || !commander.line(&mut cell, &grasp, 3.0) {
            tried -= 1;
            continue;
        }
        commander.grip(&mut cell, 0.0);
        let (width, settled, holding) = cell.gripper();
        let lift = commander.line(&mut cell, &downward(at.x, at.y, height + 0.2, yaw), 3.0);
        let up = cell.truth().objects[index].world_from_object.translation.vector;
        let carried = downward(at.x, -at.y * 0.5, height + 0.2, yaw);
        let carry = lift && commander.line(&mut cell, &carried, 5.0);
        if !carry || !commander.line(&mut cell, &downward(at.x, -at.y * 0.5, height + 0.002, yaw), 3.0) {
            tried -= 1;
            continue;
        }
        let low = cell.truth().objects[index].world_from_object.translation.vector;
        let mode = (cell.arm.mode(), cell.arm.stop().cloned());
        assert_eq!(mode, (RobotMode::Idle, None), "seed {seed}");
        println!(
            "seed {seed}: {} {:.0} g, width {:.1} mm (settled {settled}, holding {holding}), rose {:.1} of 200 mm, slipped {:.1} mm on the way",
            object.shape.name,
            object.shape.mass_kg * 1e3,
            width * 1e3,
            (up.z - at.z) * 1e3,
            (low.z - 0.002 - at.z) * 1e3
        );
        lifted += usize::from(up.z - at.z > 0.17 && holding);
        without_slip += usize::from((up.z - at.z - 0.2).abs() < 0.002);
    }
    println!("{lifted} lifted, {without_slip} of them without slip, of {tried}");
    // Round things may roll in the fingers.
    assert!(tried >= 5 && lifted * 10 >= tried * 8, "{lifted} of {tried} lifted");
    assert!(without_slip * 10 >= tried * 8, "{without_slip} of {tried} did not slip");
}
