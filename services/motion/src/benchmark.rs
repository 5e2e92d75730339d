//! Motion planning problems in known worlds: the format of `motionbenchmaker/*.json`, and one problem solved and timed.
//!
//! MotionBenchMaker (Chamzas and others, 2022) has seven sets of problems for the Panda. Boxes and cylinders are checked exactly. Problems whose
//! ends touch something or lie outside the official joint limits are invalid, and said to be.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_panda::Joints;
use serde::Deserialize;

use crate::collision::{ArmCollisionSettings, CollisionChecker, Contact};
use crate::obstacles::{ObstacleShape, Obstacles};
use crate::path::rrt_connect::{RrtError, RrtSettings, rrt_connect};
use crate::path::simplify::{SimplifySettings, simplified};

/// A file of problems.
#[derive(Debug, Clone, Deserialize)]
pub struct ProblemFile {
    /// How far each finger is from the middle, metres.
    finger_joint_positions: [f64; 2],
    /// Problems by set.
    pub problems: BTreeMap<String, Vec<PathProblem>>,
}

/// A path-planning problem: from a start to one of the goals, in the robot's base frame.
#[derive(Debug, Clone, Deserialize)]
pub struct PathProblem {
    /// Its number in the set.
    pub index: usize,
    /// Joint angles at the start, radians.
    pub start: Joints,
    /// Joint angles of which one is to be reached, radians.
    pub goals: Vec<Joints>,
    obstacles: Vec<Obstacle>,
}

#[derive(Debug, Clone, Deserialize)]
struct Obstacle {
    position: [f64; 3],
    quat_xyzw: [f64; 4],
    #[serde(flatten)]
    solid: Solid,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase")]
enum Solid {
    Box { size_xyz: [f64; 3] },
    Cylinder { height: f64, radius: f64 },
    Sphere { radius: f64 },
}

/// Why a file of problems cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ProblemError {
    /// Not the expected JSON.
    #[error("expected a file of motion planning problems: {0}")]
    Format(#[from] serde_json::Error),
    /// A number that cannot be: not finite, or a size that is not positive.
    #[error("{set} {index}: {field} is not finite or not positive")]
    Value {
        /// The set.
        set: String,
        /// The problem's number in it.
        index: usize,
        /// The field.
        field: &'static str,
    },
}

impl ProblemFile {
    /// Reads a file's text.
    ///
    /// # Errors
    /// [`ProblemError`] that says where.
    pub fn parse(text: &str) -> Result<Self, ProblemError> {
        let file: Self = serde_json::from_str(text)?;
        for (set, problems) in &file.problems {
            for problem in problems {
                if let Some(field) = problem.bad_field() {
                    return Err(ProblemError::Value { set: set.clone(), index: problem.index, field });
                }
            }
        }
        Ok(file)
    }

    /// The arm that the problems are for, without padding.
    pub fn arm(&self) -> ArmCollisionSettings {
        ArmCollisionSettings {
            padding_m: 0.0,
            finger_opening_m: self.finger_joint_positions.iter().sum(),
            ..ArmCollisionSettings::default()
        }
    }
}

impl PathProblem {
    /// The solids in the way.
    pub fn shapes(&self) -> Vec<ObstacleShape> {
        let shape = |o: &Obstacle| {
            let [x, y, z, w] = o.quat_xyzw;
            let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            let pose = Isometry3::from_parts(Translation3::from(o.position), rotation);
            match o.solid {
                Solid::Box { size_xyz } => ObstacleShape::cuboid(pose, Vector3::from(size_xyz)),
                Solid::Cylinder { height, radius } => ObstacleShape::cylinder(pose, radius, height),
                Solid::Sphere { radius } => ObstacleShape::ball(Point3::from(o.position), radius),
            }
        };
        self.obstacles.iter().map(shape).collect()
    }

    fn bad_field(&self) -> Option<&'static str> {
        let finite = |joints: &Joints| joints.iter().all(|v| v.is_finite());
        if !finite(&self.start) {
            return Some("start");
        }
        if self.goals.is_empty() || !self.goals.iter().all(finite) {
            return Some("goals");
        }
        let positive = |v: f64| v.is_finite() && v > 0.0;
        let sound = |o: &Obstacle| {
            let sized = match o.solid {
                Solid::Box { size_xyz } => size_xyz.into_iter().all(positive),
                Solid::Cylinder { height, radius } => positive(height) && positive(radius),
                Solid::Sphere { radius } => positive(radius),
            };
            sized && o.position.iter().all(|v| v.is_finite()) && positive(o.quat_xyzw.iter().map(|v| v * v).sum())
        };
        (!self.obstacles.iter().all(sound)).then_some("obstacles")
    }
}

/// A problem solved.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// The simplified path, start and goal included.
    pub path: Vec<Joints>,
    /// Corners of the path as the search found it.
    pub found: usize,
    /// Time for the search, everything from the problem's shapes on included.
    pub plan: Duration,
    /// The same with the simplification.
    pub plan_simplify: Duration,
}

/// Why a problem has no solution.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Unsolved {
    /// The start cannot be.
    #[error("start: {0}")]
    Start(Contact),
    /// The last goal cannot be, and none of the others.
    #[error("goal: {0}")]
    Goal(Contact),
    /// The search ended first.
    #[error("{0}")]
    Search(RrtError),
}

impl Unsolved {
    /// Whether the problem itself is at fault.
    pub fn is_invalid(&self) -> bool {
        !matches!(self, Self::Search(RrtError::Exhausted { .. } | RrtError::Stopped))
    }
}

/// Solves one problem.
///
/// # Errors
/// [`Unsolved`] with what was in the way.
pub fn solve(
    problem: &PathProblem,
    arm: ArmCollisionSettings,
    rrt: &RrtSettings,
    simplify: &SimplifySettings,
    seed: u64,
) -> Result<Solution, Unsolved> {
    let begin = Instant::now();
    let world = Obstacles::solids(problem.shapes());
    let obstacles = [&world];
    let space = CollisionChecker::new(arm, &obstacles, None);
    let mut rng = Pcg64::seed_from_u64(seed);
    let found = rrt_connect(&problem.start, &problem.goals, &space, rrt, &mut rng, &|| false);
    let plan = begin.elapsed();
    let found = found.map_err(|error| match error {
        RrtError::StartBlocked => space.contact(&problem.start).map_or(Unsolved::Search(error), Unsolved::Start),
        RrtError::GoalBlocked => problem.goals.iter().find_map(|g| space.contact(g)).map_or(Unsolved::Search(error), Unsolved::Goal),
        RrtError::Exhausted { .. } | RrtError::Stopped => Unsolved::Search(error),
    })?;
    let path = simplified(&found, simplify, &space);
    Ok(Solution { path, found: found.len(), plan, plan_simplify: begin.elapsed() })
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = r#"{"finger_joint_positions": [0.02, 0.02], "problems": {"one": [{"index": 1,
        "start": [0, -0.785, 0, -2.356, 0, 1.571, 0.785], "goals": [[1.5, -0.785, 0, -2.356, 0, 1.571, 0.785]],
        "obstacles": [{"id": "post", "type": "cylinder", "position": [0.22, 0.22, 0.5], "quat_xyzw": [0, 0, 0, 1], "height": 1.0, "radius": 0.05},
                      {"id": "block", "type": "box", "position": [0.4, 0.4, 0.1], "quat_xyzw": [0, 0, 0.3, 1], "size_xyz": [0.1, 0.2, 0.3]}]}]}}"#;

    #[test]
    fn a_problem_is_read_and_solved() {
        let file = ProblemFile::parse(FILE).unwrap();
        assert!((file.arm().finger_opening_m - 0.04).abs() < 1e-12);
        let problem = &file.problems["one"][0];
        let solution = solve(problem, file.arm(), &RrtSettings::default(), &SimplifySettings::default(), 1).unwrap();
        assert_eq!((solution.path.first(), solution.path.last()), (Some(&problem.start), problem.goals.first()));
        assert!(solution.path.len() > 2, "the post is in the way");
    }

    #[test]
    fn what_is_wrong_is_named() {
        assert!(matches!(ProblemFile::parse("{}"), Err(ProblemError::Format(_))));
        let flat = FILE.replace("\"height\": 1.0", "\"height\": 0.0");
        assert!(matches!(ProblemFile::parse(&flat), Err(ProblemError::Value { field: "obstacles", index: 1, .. })));
        let inside = FILE.replace("[0.22, 0.22, 0.5]", "[0.3, 0.0, 0.5]");
        let file = ProblemFile::parse(&inside).unwrap();
        let unsolved = solve(&file.problems["one"][0], file.arm(), &RrtSettings::default(), &SimplifySettings::default(), 1).unwrap_err();
        assert!(matches!(unsolved, Unsolved::Start(Contact::Scene(_))) && unsolved.is_invalid(), "{unsolved}");
    }
}
