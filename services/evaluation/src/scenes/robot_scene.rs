//! The scenes of the robot's table: one named object among others within the Panda's reach, seen by the cell's camera, and a goal for it.
//!
//! Ground truth: masks, the camera's pose, meshes and poses. Observed: depth with the sensor model, the robot in the picture. Objects stand
//! upright, a hand's width apart, on the table or (in the second condition) on the table and a large box on it; the paper's Table 3 has the same
//! two.
//!
//! What cannot be done is not asked for, as the second world (`tests/foreign_world/problems.py`) does not: an object that the hand does not
//! get to where it stands, and a goal that no place within reach makes true. Both are judged by the truth alone ([`TrueReach`],
//! [`PreparedTruth`]), before anything is planned, and counted ([`Excluded`]).

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;
use repose_geometry::{ViewerFrame, cloud};
use repose_panda::{FINGER_OPENING_MAX_M, Joints, READY};
use repose_proto::place::RegionBox;
use repose_proto::{Frame, GoalTerm, Relation, RigidTransform, RobotInView};
use repose_sensor::SensorModel;
use repose_simulator::cell::CellSettings;
use repose_simulator::contact::PlacedParts;
use repose_simulator::furniture::{Furniture, FurnitureSurface};
use repose_simulator::objects::ObjectShape;
use repose_simulator::objects::color::random_color;
use repose_simulator::release::{ReleaseSettings, penetration_of};
use repose_simulator::robot::body;
use repose_simulator::scene::{SceneKind, SceneObject, SimulatedScene, displacement_m};
use serde::Serialize;

use crate::scenes::problem::{GOAL_RELATIONS, Problem, frame_drawn};
use crate::scenes::true_answers::{PreparedTruth, TruthSettings};
use crate::scenes::true_reach::TrueReach;

/// The condition of a robot trial: what stands on the table beside the objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TableCondition {
    /// Nothing.
    Table,
    /// A large box, sometimes two.
    LargeBox,
}

impl TableCondition {
    /// Both, in the paper's order.
    pub const ALL: [Self; 2] = [Self::Table, Self::LargeBox];

    /// The name in snake case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Table => "table",
            Self::LargeBox => "large_box",
        }
    }

    fn kind(self) -> SceneKind {
        match self {
            Self::Table => SceneKind::OpenTable,
            Self::LargeBox => SceneKind::LargeBox,
        }
    }
}

/// How the scenes are made.
#[derive(Debug, Clone)]
pub struct RobotSceneSettings {
    /// The robot's cell: table, camera, physics.
    pub cell: CellSettings,
    /// The depth sensor.
    pub sensor: SensorModel,
    /// Fewest and most other objects.
    pub others: [usize; 2],
    /// Corners of the part of the cell where objects start, world (x, y), metres: what the arm reaches from above.
    pub workspace_m: [[f64; 2]; 2],
    /// Least distance between objects at the start, metres: room for a finger.
    pub margin_m: f32,
    /// The fewest observed points of a query or an anchor.
    pub min_points: usize,
    /// How far an object may move while the scene settles, metres.
    pub settled_m: f64,
    /// Scenes drawn per trial until one will do.
    pub attempts: usize,
}

impl Default for RobotSceneSettings {
    fn default() -> Self {
        Self {
            cell: CellSettings::default(),
            sensor: SensorModel::default(),
            others: [2, 4],
            workspace_m: [[0.32, -0.30], [0.70, 0.30]],
            margin_m: 0.04,
            min_points: 300,
            settled_m: 0.02,
            attempts: 60,
        }
    }
}

/// What was drawn and is not asked for, by the truth alone.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Excluded {
    /// Scenes in which the hand does not get to the object.
    pub out_of_reach: usize,
    /// Goals for which no place within reach was found.
    pub no_place: usize,
}

impl Excluded {
    /// Both counts of two together.
    pub fn and(self, other: Self) -> Self {
        Self { out_of_reach: self.out_of_reach + other.out_of_reach, no_place: self.no_place + other.no_place }
    }
}

/// The problem of a trial: `object` among two to four of `others`, to be placed in `region`; and what was drawn before it. `None` when no
/// draw will do.
pub fn robot_problem(
    object: &Arc<ObjectShape>,
    others: &[Arc<ObjectShape>],
    condition: TableCondition,
    seed: u64,
    region: &RegionBox,
    settings: &RobotSceneSettings,
) -> Option<(Problem, Excluded)> {
    let mut rng = Pcg64::new(u128::from(seed), 0x7ab1_e003);
    let mut excluded = Excluded::default();
    let problem = (0..settings.attempts).find_map(|_| {
        let truth = drawn(object, others, condition, seed, settings, &mut rng)?;
        seen(truth, seed, region, settings, &mut excluded, &mut rng)
    })?;
    Some((problem, excluded))
}

/// A settled scene; its first object is the query.
fn drawn(
    object: &Arc<ObjectShape>,
    others: &[Arc<ObjectShape>],
    condition: TableCondition,
    seed: u64,
    settings: &RobotSceneSettings,
    rng: &mut Pcg64,
) -> Option<SimulatedScene> {
    let kind = condition.kind();
    let Furniture { fixtures, surfaces, outlook } = Furniture::sample(kind, &settings.cell.scene.table, rng);
    let mut scene = SimulatedScene { seed, kind, fixtures, surfaces, outlook, objects: Vec::new(), gaps_m: Vec::new() };
    let mut around: Vec<&Arc<ObjectShape>> = others.iter().collect();
    around.shuffle(rng);
    let count = rng.random_range(settings.others[0]..=settings.others[1]);
    for shape in std::iter::once(object).chain(around.into_iter().take(count)) {
        put(&mut scene, shape, settings, rng)?;
    }
    let start: Vec<Isometry3<f64>> = scene.objects.iter().map(|o| o.world_from_object).collect();
    let mut world = scene.world(settings.cell.scene.physics);
    world.settle(&settings.cell.scene.rest)?;
    let poses = world.poses();
    let stays = |(i, o): (usize, &SceneObject)| displacement_m(&o.shape, &start[i], &poses[i]) <= settings.settled_m;
    scene.objects.iter().enumerate().all(stays).then(|| scene.with_poses(&poses))
}

/// Puts one more object somewhere on a surface within the workspace, upright, turned at random.
fn put(scene: &mut SimulatedScene, shape: &Arc<ObjectShape>, settings: &RobotSceneSettings, rng: &mut Pcg64) -> Option<()> {
    const TRIES: usize = 60;
    const AIR_M: f64 = 0.0005;
    let id = scene.objects.len() as u16 + 1;
    let color = random_color(rng);
    let [low, high] = settings.workspace_m;
    for _ in 0..TRIES {
        let surface = &scene.surfaces[rng.random_range(0..scene.surfaces.len())];
        let [reach_x, reach_y] = [surface.half_extents_m.x, surface.half_extents_m.y];
        let on_it = Point3::new(rng.random_range(-reach_x..reach_x), rng.random_range(-reach_y..reach_y), 0.0);
        let at = surface.world_from_surface * on_it;
        if !(low[0]..high[0]).contains(&at.x) || !(low[1]..high[1]).contains(&at.y) {
            continue;
        }
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(-std::f64::consts::PI..std::f64::consts::PI));
        let height = at.z + shape.depth_below_origin_m(&Isometry3::identity()) + AIR_M;
        let world_from_object = Isometry3::from_parts(Translation3::new(at.x, at.y, height), yaw);
        if !stands_on(surface, shape, &world_from_object) || !keeps_away(scene, shape, &world_from_object, settings.margin_m) {
            continue;
        }
        scene.objects.push(SceneObject { id, shape: shape.clone(), world_from_object, color });
        if penetration_of(scene, scene.objects.len() - 1, &world_from_object) == 0.0 {
            return Some(());
        }
        scene.objects.pop();
    }
    None
}

fn stands_on(surface: &FurnitureSurface, shape: &ObjectShape, world_from_object: &Isometry3<f64>) -> bool {
    shape.bounds(world_from_object).corners().iter().all(|corner| {
        let at = surface.world_from_surface.inverse_transform_point(corner);
        at.x.abs() <= surface.half_extents_m.x && at.y.abs() <= surface.half_extents_m.y
    })
}

fn keeps_away(scene: &SimulatedScene, shape: &ObjectShape, world_from_object: &Isometry3<f64>, margin_m: f32) -> bool {
    let Some(placed) = PlacedParts::new(&shape.parts, world_from_object) else { return false };
    let other = |o: &SceneObject| PlacedParts::new(&o.shape.parts, &o.world_from_object);
    scene.objects.iter().filter_map(other).all(|o| !placed.is_within(&o, margin_m))
}

/// The cell's arm as a frame tells of it.
pub fn arm_in_view(joints_rad: Joints, gripper_width_m: f64, holds: bool) -> RobotInView {
    RobotInView {
        name: "panda".to_owned(),
        model: "panda".to_owned(),
        joints_rad,
        gripper_width_m,
        holding: Some(holds),
        world_from_base: RigidTransform::IDENTITY,
    }
}

/// What the cell's camera makes of the scene, with a goal that is still open and can be had; `None` when too little is seen or there is none.
fn seen(
    truth: SimulatedScene,
    seed: u64,
    region: &RegionBox,
    settings: &RobotSceneSettings,
    excluded: &mut Excluded,
    rng: &mut Pcg64,
) -> Option<Problem> {
    let (camera, world_from_camera) = (settings.cell.camera, settings.cell.world_from_camera());
    let mut drawables = truth.drawables();
    drawables.extend(body::drawables(&READY, [FINGER_OPENING_MAX_M as f32 / 2.0; 2]));
    let robot = arm_in_view(READY, FINGER_OPENING_MAX_M, false);
    let frame = frame_drawn(&drawables, &camera, &world_from_camera, &settings.sensor, seed);
    let frame = Frame { robots: vec![robot], ..frame };
    let observed = repose_perception::segment(&frame, &repose_perception::Settings::default()).ok()?;
    let query = truth.objects.first()?.id;
    let is_seen = |id: u16| observed.object(id).is_some_and(|o| o.points >= settings.min_points);
    if !is_seen(query) {
        return None;
    }
    let viewer = ViewerFrame::from_camera(&world_from_camera);
    let relations = truth.relations(&viewer);
    let mut open: Vec<(u16, Relation)> = Vec::new();
    for (j, anchor) in truth.objects.iter().enumerate().skip(1).filter(|(_, o)| is_seen(o.id)) {
        open.extend(GOAL_RELATIONS.iter().filter(|r| !relations[j][r.index()]).map(|r| (anchor.id, *r)));
    }
    if open.is_empty() {
        return None;
    }
    let Some(reach) = TrueReach::new(&truth, 0) else {
        excluded.out_of_reach += 1;
        return None;
    };
    let (anchor, relation) = open.swap_remove(rng.random_range(0..open.len()));
    let goal = GoalTerm { relation, anchor, holds: true };
    let mut problem = Problem { seed, truth, camera, world_from_camera, viewer, frame, observed, query, goal };
    while !is_possible(&problem, &reach, region) {
        excluded.no_place += 1;
        if open.is_empty() {
            return None;
        }
        let (anchor, relation) = open.swap_remove(rng.random_range(0..open.len()));
        problem.goal = GoalTerm { relation, anchor, holds: true };
    }
    Some(problem)
}

/// Whether a search with the truth in hand finds a place in the region that meets the goal, that the arm gets to, where the object stays and where
/// no part of it reaches over an edge of what carries it: nobody is asked to set something down half over a table's edge.
fn is_possible(problem: &Problem, reach: &TrueReach, region: &RegionBox) -> bool {
    // A region is asked of the middle of what was seen of an object.
    let seen: Vec<Point3<f32>> = problem.observed.points_of(problem.query).map(Point3::from).collect();
    let Some((middle, truth)) = cloud::centroid(&seen).zip(PreparedTruth::new(problem)) else { return false };
    let is_allowed = |placed_from_observed: &Isometry3<f64>| {
        let at = placed_from_observed * middle;
        (0..3).all(|k| (region.min_m[k]..=region.max_m[k]).contains(&at[k]))
            && keeps_off_edges(problem, placed_from_observed)
            && reach.gets_to(placed_from_observed)
    };
    !truth.answers_among(&TruthSettings::default(), &ReleaseSettings::default(), 1, &is_allowed).is_empty()
}

/// Whether what is moved, set down on furniture, stands there whole; on another object it may reach over.
fn keeps_off_edges(problem: &Problem, placed_from_observed: &Isometry3<f64>) -> bool {
    const AT_M: f64 = 0.012;
    let Some(moved) = problem.index_of(problem.query).map(|index| &problem.truth.objects[index]) else { return false };
    let there = placed_from_observed * moved.world_from_object;
    let bottom_m = there.translation.z - moved.shape.depth_below_origin_m(&there);
    let is_under = |surface: &&FurnitureSurface| (bottom_m - surface.world_from_surface.translation.z).abs() < AT_M;
    let mut carriers = problem.truth.surfaces.iter().filter(is_under).peekable();
    carriers.peek().is_none() || carriers.any(|surface| stands_on(surface, &moved.shape, &there))
}

#[cfg(test)]
mod tests {
    use repose_simulator::objects::body::{Body, Finish};

    use super::*;

    fn brick(name: &str, [x, y, z]: [f32; 3]) -> Arc<ObjectShape> {
        let mut body = Body::default();
        body.brick([0.0; 3], [x, y, z]);
        Arc::new(body.finish(&Finish { name, mass_kg: 0.2, friction: 0.6, top: None, opening: None }))
    }

    #[test]
    fn a_goal_that_no_place_makes_true_is_not_asked_for_and_counted() {
        let (object, others) = (brick("a", [0.05, 0.06, 0.1]), [brick("b", [0.06, 0.06, 0.08]), brick("c", [0.1, 0.06, 0.12])]);
        let settings = RobotSceneSettings { attempts: 8, ..RobotSceneSettings::default() };
        let draw = |seed, region: &RegionBox| robot_problem(&object, &others, TableCondition::Table, seed, region, &settings);
        let region = |x: [f64; 2]| RegionBox { min_m: [x[0], -0.42, -0.05], max_m: [x[1], 0.42, 0.7], inside: true };
        let whole = region([0.28, 0.78]);
        let (problem, _) = draw(3, &whole).expect("a problem");
        assert!(is_possible(&problem, &TrueReach::new(&problem.truth, 0).expect("it is reached"), &whole));
        assert!(draw(3, &region([5.0, 6.0])).is_none(), "no place is there");
        // Where there is less room, more goals are passed over: those that are asked are possible there, too.
        let narrow = region([0.28, 0.45]);
        let drawn: Vec<(Problem, Excluded)> = (0..4).filter_map(|seed| draw(seed, &narrow)).collect();
        assert!(drawn.iter().map(|(_, excluded)| excluded.no_place).sum::<usize>() > 0 && !drawn.is_empty());
        for (problem, _) in &drawn {
            let surface = &problem.truth.surfaces[0];
            let beyond = surface.half_extents_m.x - problem.truth.objects[0].world_from_object.translation.x
                + surface.world_from_surface.translation.x;
            assert!(keeps_off_edges(problem, &Isometry3::identity()));
            assert!(!keeps_off_edges(problem, &Isometry3::translation(beyond, 0.0, 0.0)), "half of it is beyond the edge");
            assert!(is_possible(problem, &TrueReach::new(&problem.truth, 0).expect("it is reached"), &narrow));
        }
    }
}
