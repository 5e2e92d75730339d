//! Every path for the published problems, checked again by plain means: double precision kinematics, parry's shapes, small steps, no vectors.

#[path = "../../../tests/common/real_data.rs"]
mod real_data;

use std::collections::BTreeMap;

use parry3d::math::{Pose, Rotation, Vector};
use parry3d::query::PointQuery;
use parry3d::shape::{Cuboid, Cylinder};
use repose_motion::benchmark::{ProblemFile, Unsolved, solve};
use repose_motion::path::rrt_connect::RrtSettings;
use repose_motion::path::simplify::SimplifySettings;
use repose_panda::{FINGER_OPENING_MAX_M, Joints, LIMITS, LINKS, Link, LinkFrames, PlacedSphere, SPHERE_COUNT, spheres_in_base};
use serde_json::Value;

/// Between two checks no joint moves further, radians.
const STEP_RAD: f64 = 0.004;
/// Parry's shapes are in single precision.
const ROUNDING_M: f64 = 2e-6;

fn data(name: &str) -> Option<Value> {
    let path = real_data::real_data(&format!("motionbenchmaker/{name}"))?;
    Some(serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap())
}

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    std::array::from_fn(|i| value[i].as_f64().unwrap())
}

/// A solid of the file as parry has it.
struct Solid {
    world_from_solid: Pose,
    shape: Box<dyn PointQuery>,
}

impl Solid {
    fn new(obstacle: &Value) -> Self {
        let ([x, y, z], [i, j, k, w]) = (numbers(&obstacle["position"]), numbers(&obstacle["quat_xyzw"]));
        let (single, half) = (|v: f64| v as f32, |field: &Value| (field.as_f64().unwrap() / 2.0) as f32);
        let rotation = Rotation::from_xyzw(single(i), single(j), single(k), single(w)).normalize();
        let shape: Box<dyn PointQuery> = if obstacle["type"] == "box" {
            let size = &obstacle["size_xyz"];
            Box::new(Cuboid::new(Vector::new(half(&size[0]), half(&size[1]), half(&size[2]))))
        } else {
            Box::new(Cylinder::new(half(&obstacle["height"]), single(obstacle["radius"].as_f64().unwrap())))
        };
        // Parry's cylinders stand along y, the file's along z.
        let stood = if obstacle["type"] == "box" { Rotation::IDENTITY } else { Rotation::from_rotation_x(std::f32::consts::FRAC_PI_2) };
        let at = Vector::new(single(x), single(y), single(z));
        Self { world_from_solid: Pose::from_parts(at, rotation * stood), shape }
    }

    fn distance_m(&self, sphere: &PlacedSphere) -> f64 {
        let center = Vector::new(sphere.center.x as f32, sphere.center.y as f32, sphere.center.z as f32);
        f64::from(self.shape.distance_to_point(&self.world_from_solid, center, true))
    }
}

/// The pairs of links that may not touch, by the planning framework's own matrix.
fn forbidden_pairs(matrix: &Value) -> Vec<(usize, usize)> {
    let names = ["link0", "link1", "link2", "link3", "link4", "link5", "link6", "link7", "hand", "leftfinger", "rightfinger"];
    let entries = matrix["entry_names"].as_array().unwrap();
    let entry = |k: usize| entries.iter().position(|e| e.as_str().unwrap() == format!("panda_{}", names[k])).unwrap();
    let pairs = (0..names.len()).flat_map(|i| (i + 1..names.len()).map(move |k| (i, k)));
    pairs.filter(|(i, k)| !matrix["entry_values"][entry(*i)][entry(*k)].as_bool().unwrap()).collect()
}

fn overlap(spheres: &[PlacedSphere; SPHERE_COUNT], (i, k): (usize, usize)) -> bool {
    spheres[LINKS[i].sphere_range()]
        .iter()
        .any(|a| spheres[LINKS[k].sphere_range()].iter().any(|b| (a.center - b.center).norm() < a.radius_m + b.radius_m - ROUNDING_M))
}

/// What is wrong at a configuration, if anything.
fn fault(joints: &Joints, opening_m: f64, solids: &[Solid], pairs: &[(usize, usize)]) -> Option<String> {
    // Goals may stand at a limit, and what lies between them and elsewhere is rounded.
    if !LIMITS.contains(joints, -1e-9) {
        return Some("outside the limits".to_owned());
    }
    let spheres = spheres_in_base(&LinkFrames::at(joints), opening_m);
    if let Some(pair) = pairs.iter().find(|pair| overlap(&spheres, **pair)) {
        return Some(format!("{:?} touches {:?}", LINKS[pair.0], LINKS[pair.1]));
    }
    let moving = &spheres[Link::Link1.sphere_range().start..];
    let touching = moving.iter().position(|s| solids.iter().any(|solid| solid.distance_m(s) < s.radius_m - ROUNDING_M));
    touching.map(|sphere| format!("sphere {} touches a solid", sphere + 1))
}

#[test]
fn every_valid_problem_is_solved_and_every_path_is_free_in_small_steps() {
    let (Some(raw), Some(matrix)) = (data("panda_odd.json"), data("allowed_collision_matrix.json")) else { return };
    let file = ProblemFile::parse(&raw.to_string()).unwrap();
    let opening_m = 2.0 * 0.065;
    let pairs = forbidden_pairs(&matrix);
    let mut invalid = BTreeMap::new();
    for (set, problems) in &file.problems {
        for (k, problem) in problems.iter().enumerate() {
            let solids: Vec<Solid> = raw["problems"][set][k]["obstacles"].as_array().unwrap().iter().map(Solid::new).collect();
            let solution = match solve(problem, file.arm(), &RrtSettings::default(), &SimplifySettings::default(), 0) {
                Ok(solution) => solution,
                Err(unsolved @ (Unsolved::Start(_) | Unsolved::Goal(_))) => {
                    invalid.insert((set.clone(), problem.index), unsolved);
                    assert!(
                        fault(&problem.start, opening_m, &solids, &pairs)
                            .or(fault(&problem.goals[0], opening_m, &solids, &pairs))
                            .is_some()
                    );
                    continue;
                }
                Err(unsolved) => panic!("{set} {}: {unsolved}", problem.index),
            };
            assert_eq!((solution.path[0], solution.path[solution.path.len() - 1]), (problem.start, problem.goals[0]));
            for edge in solution.path.windows(2) {
                let widest = (0..7).map(|i| (edge[1][i] - edge[0][i]).abs()).fold(0.0, f64::max);
                let steps = (widest / STEP_RAD).ceil().max(1.0) as usize;
                for step in 0..=steps {
                    let q: Joints = std::array::from_fn(|i| edge[0][i] + (edge[1][i] - edge[0][i]) * step as f64 / steps as f64);
                    assert_eq!(fault(&q, opening_m, &solids, &pairs), None, "{set} {}", problem.index);
                }
            }
        }
    }
    // The data's own notes name exactly these: goals outside the official limits, and one inside an obstacle.
    let named = [("table_pick", 31), ("table_pick", 41), ("table_pick", 49), ("table_under_pick", 3), ("table_under_pick", 97)];
    assert_eq!(invalid.keys().map(|(set, index)| (set.as_str(), *index)).collect::<Vec<_>>(), named);
}

#[test]
fn the_matrix_forbids_no_pair_of_links_that_can_touch_unseen() {
    use rand::{RngExt, SeedableRng};
    let Some(matrix) = data("allowed_collision_matrix.json") else { return };
    let ours: Vec<(usize, usize)> = repose_panda::SELF_COLLISION_PAIRS.iter().map(|(a, b)| (*a as usize, *b as usize)).collect();
    let unseen: Vec<(usize, usize)> = forbidden_pairs(&matrix).into_iter().filter(|pair| !ours.contains(pair)).collect();
    let mut rng = rand_pcg::Pcg64::seed_from_u64(2);
    for opening_m in [0.0, FINGER_OPENING_MAX_M, 0.13] {
        for _ in 0..20_000 {
            let q = LIMITS.between(&std::array::from_fn(|_| rng.random_range(0.0..1.0)));
            let spheres = spheres_in_base(&LinkFrames::at(&q), opening_m);
            assert_eq!(unseen.iter().find(|pair| overlap(&spheres, **pair)), None, "{q:?}");
        }
    }
}
