//! A task whose solution was tried: the true table, what a camera sees of it, and goals that hold in the end and not yet.

use std::sync::Arc;

use nalgebra::{Isometry3, Point2, Point3, Vector3};
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;
use repose_dataset::Split;
use repose_geometry::transform::look_at;
use repose_geometry::{Pinhole, ViewerFrame};
use repose_proto::arrange::ObjectGoal;
use repose_proto::{GoalTerm, Relation, Scene};
use repose_relations::{TrueBounds, ground_truth_margins};
use repose_sensor::SensorModel;
use repose_simulator::furniture::{Furniture, Table};
use repose_simulator::objects::color::random_color;
use repose_simulator::release::{ReleaseSettings, released};
use repose_simulator::scene::{SceneKind, SceneObject, SimulatedScene, displacement_m};
use serde::{Deserialize, Serialize};

use crate::scenes::arrangement::draft::{About, Draft, TABLE_HALF_M, drafted};
use crate::scenes::arrangement::true_view::true_scene;
use crate::scenes::outcome::{OTHERS_MOVED_M, PENETRATION_M, STABLE_M, TILT_RAD};
use crate::scenes::problem::frame_of;

pub use crate::scenes::arrangement::draft::TaskKind;

/// What the planner is given of the objects' shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shapes {
    /// All of their surfaces.
    True,
    /// What one camera with a sensor's faults sees, with true masks.
    Observed,
}

impl Shapes {
    /// Both.
    pub const ALL: [Self; 2] = [Self::True, Self::Observed];

    /// The name in snake case.
    pub fn name(self) -> &'static str {
        match self {
            Self::True => "true",
            Self::Observed => "observed",
        }
    }
}

/// A task.
#[derive(Debug, Clone)]
pub struct ArrangementTask {
    /// What it was drawn from.
    pub seed: u64,
    /// What makes it hard.
    pub kind: TaskKind,
    /// The true table at first.
    pub truth: SimulatedScene,
    /// The viewer of all relations.
    pub viewer: ViewerFrame,
    /// The camera.
    pub camera: Pinhole,
    /// Its true pose.
    pub world_from_camera: Isometry3<f64>,
    /// What it sees of the table at first.
    pub observed: Scene,
    /// What shall hold at the end, in no order.
    pub goals: Vec<ObjectGoal>,
    /// Moves of the known solution.
    pub moves: usize,
}

impl ArrangementTask {
    /// How many slots there are: the next one's first seed is the first slot's second. All of their seeds are of one block of `final`.
    pub const SLOTS: u64 = 500_000;

    /// The task of a slot; none where none of the slot's seeds gives one.
    pub fn of_slot(split: Split, (kind, goals): (TaskKind, usize), slot: u64) -> Option<Self> {
        const SEEDS: u64 = 60;
        (0..SEEDS).find_map(|k| Self::of_seed(split.seed(slot + k * Self::SLOTS)?, kind, goals))
    }

    /// The task of a seed; none where what was drawn finds no room, does not rest, is not seen, or is not solved by its own solution.
    pub fn of_seed(seed: u64, kind: TaskKind, goals: usize) -> Option<Self> {
        // A stream of its own for each size and kind, so that their tasks have nothing in common.
        let mut rng = Pcg64::new(u128::from(seed), 0xa77a_0000 + (kind as u128) * 100 + goals as u128);
        let draft = drafted(kind, goals, &mut rng)?;
        let truth = settled(&draft, seed, &mut rng)?;
        let (camera, world_from_camera) = viewpoint(&mut rng);
        let viewer = ViewerFrame::from_camera(&world_from_camera);
        let end = solved(&truth, &draft.moves)?;
        let mut goals: Vec<ObjectGoal> = draft
            .goals
            .iter()
            .map(|(object, about)| {
                let terms = terms(&truth, &end, &viewer, *object, about, &mut rng)?;
                Some(ObjectGoal { object: truth.objects[*object].id, terms })
            })
            .collect::<Option<_>>()?;
        goals.shuffle(&mut rng);
        let observed = looked_at(&truth, &camera, &world_from_camera, seed)?;
        const SEEN_POINTS: usize = 250;
        let is_seen = |o: &SceneObject| observed.object(o.id).is_some_and(|seen| seen.points >= SEEN_POINTS);
        let moves = draft.moves.len();
        let is_all_seen = truth.objects.iter().all(is_seen);
        is_all_seen.then_some(Self { seed, kind, truth, viewer, camera, world_from_camera, observed, goals, moves })
    }

    /// What a planner is given of it.
    pub fn seen(&self, shapes: Shapes) -> Arc<Scene> {
        Arc::new(match shapes {
            Shapes::True => true_scene(&self.truth, &self.observed),
            Shapes::Observed => self.observed.clone(),
        })
    }

    /// What a planner is given of a table that came of its moves, seen by the same camera; `look` counts the views, and each has noise of its own.
    /// None where perception can make nothing of it.
    pub fn seen_again(&self, table: &SimulatedScene, shapes: Shapes, look: u64) -> Option<Arc<Scene>> {
        const NOISES: u64 = 1_000_003;
        let observed = looked_at(table, &self.camera, &self.world_from_camera, self.seed.wrapping_add(look * NOISES))?;
        Some(Arc::new(match shapes {
            Shapes::True => true_scene(table, &observed),
            Shapes::Observed => observed,
        }))
    }

    /// The index of an object in the true scene.
    pub fn index_of(&self, id: u16) -> Option<usize> {
        self.truth.objects.iter().position(|o| o.id == id)
    }

    /// Whether all goals hold on a true table.
    pub fn hold(&self, table: &SimulatedScene) -> bool {
        let (n, relations) = (table.objects.len(), table.relations(&self.viewer));
        let term = |i: usize, t: &GoalTerm| self.index_of(t.anchor).is_some_and(|j| relations[i * n + j][t.relation.index()] == t.holds);
        self.goals.iter().all(|goal| self.index_of(goal.object).is_some_and(|i| goal.terms.iter().all(|t| term(i, t))))
    }
}

/// What perception makes of a camera's picture, with true masks; `seed` is the sensor's.
fn looked_at(table: &SimulatedScene, camera: &Pinhole, world_from_camera: &Isometry3<f64>, seed: u64) -> Option<Scene> {
    let frame = frame_of(table, camera, world_from_camera, &SensorModel::default(), seed);
    repose_perception::segment(&frame, &repose_perception::Settings::default()).ok()
}

/// The table at first, at rest.
fn settled(draft: &Draft, seed: u64, rng: &mut Pcg64) -> Option<SimulatedScene> {
    const SETTLED_M: f64 = 0.005;
    let [x, y] = TABLE_HALF_M;
    let table = Table::Fixed { low: Point2::new(-x, -y), high: Point2::new(x, y) };
    let Furniture { fixtures, surfaces, outlook } = Furniture::sample(SceneKind::OpenTable, &table, rng);
    let object = |(i, (shape, pose)): (usize, (&Arc<repose_simulator::objects::ObjectShape>, &Isometry3<f64>))| SceneObject {
        id: i as u16 + 1,
        shape: shape.clone(),
        world_from_object: *pose,
        color: [0; 3],
    };
    let mut objects: Vec<SceneObject> = draft.shapes.iter().zip(&draft.start).enumerate().map(object).collect();
    objects.iter_mut().for_each(|o| o.color = random_color(rng));
    let scene = SimulatedScene { seed, kind: SceneKind::OpenTable, fixtures, surfaces, outlook, objects, gaps_m: Vec::new() };
    let settings = repose_simulator::scene::SceneSettings::default();
    let mut world = scene.world(settings.physics);
    world.settle(&settings.rest)?;
    let poses = world.poses();
    let stays = |(o, pose): (&SceneObject, &Isometry3<f64>)| displacement_m(&o.shape, &o.world_from_object, pose) <= SETTLED_M;
    scene.objects.iter().zip(&poses).all(stays).then(|| scene.with_poses(&poses))
}

/// A camera on a tripod that sees the whole table.
fn viewpoint(rng: &mut Pcg64) -> (Pinhole, Isometry3<f64>) {
    let camera = Pinhole { width: 640, height: 480, fx: 525.0, fy: 525.0, cx: 319.5, cy: 239.5 };
    let azimuth_rad = rng.random_range(-std::f64::consts::PI..std::f64::consts::PI);
    let (elevation_rad, distance_m) = (rng.random_range(42.0f64..58.0).to_radians(), rng.random_range(1.2..1.4));
    let level_m = distance_m * elevation_rad.cos();
    let eye = Point3::new(level_m * azimuth_rad.cos(), level_m * azimuth_rad.sin(), distance_m * elevation_rad.sin());
    (camera, look_at(&eye, &Point3::new(0.0, 0.0, 0.03), &Vector3::z()))
}

/// The table after a solution's moves; none where one of them does not stay where it was put.
fn solved(truth: &SimulatedScene, moves: &[(usize, Isometry3<f64>)]) -> Option<SimulatedScene> {
    let settings = ReleaseSettings { ends_at_rest: true, ..ReleaseSettings::default() };
    moves.iter().try_fold(truth.clone(), |scene, (object, there)| {
        let came = released(&scene, *object, there, &settings)?;
        let is_clean = came.moved_m < STABLE_M / 5.0
            && came.tilt_rad <= TILT_RAD / 3.0
            && came.others_moved_m <= OTHERS_MOVED_M / 4.0
            && came.penetration_m <= PENETRATION_M / 5.0;
        is_clean.then(|| scene.with_poses(&came.world_from_objects))
    })
}

/// Terms that hold in the end with room to spare, the first of which does not hold yet; none where there are none.
fn terms(
    truth: &SimulatedScene,
    end: &SimulatedScene,
    viewer: &ViewerFrame,
    object: usize,
    about: &About,
    rng: &mut Pcg64,
) -> Option<Vec<GoalTerm>> {
    use Relation::{Above, Behind, InFrontOf, LeftOf, Near, RightOf};
    const SIDES: [Relation; 4] = [LeftOf, RightOf, InFrontOf, Behind];
    // By how much a relation must hold in the end, and be missed at first, metres: nobody asks for what nobody can tell.
    const SURE_M: f64 = 0.008;
    let margin = |scene: &SimulatedScene, anchor: usize, relation: Relation| {
        let true_object = |i: usize| TrueBounds { bounds: scene.objects[i].shape.bounds(&scene.objects[i].world_from_object) };
        let gap_m = f64::from(scene.gaps_m[object * scene.objects.len() + anchor]);
        ground_truth_margins(&true_object(object), &true_object(anchor), gap_m, viewer).0[relation.index()]
    };
    let will_hold = |anchor: usize, relation: Relation| margin(end, anchor, relation) >= SURE_M;
    let is_open = |anchor: usize, relation: Relation| margin(truth, anchor, relation) <= -SURE_M;
    let term = |relation: Relation, anchor: usize| GoalTerm { relation, anchor: truth.objects[anchor].id, holds: true };
    match about {
        About::OnTopOf(under) => (will_hold(*under, Above) && is_open(*under, Above)).then(|| vec![term(Above, *under)]),
        About::Beside(neighbour) => {
            let side = SIDES.into_iter().find(|side| will_hold(*neighbour, *side))?;
            let is_near = will_hold(*neighbour, Near) && is_open(*neighbour, Near);
            is_near.then(|| vec![term(Near, *neighbour), term(side, *neighbour)])
        }
        About::OneOf(anchors) => {
            let mut choices: Vec<(usize, Relation)> = anchors.iter().flat_map(|a| SIDES.map(|side| (*a, side))).collect();
            choices.retain(|(anchor, side)| will_hold(*anchor, *side) && is_open(*anchor, *side));
            choices.shuffle(rng);
            let (anchor, side) = *choices.first()?;
            let near = will_hold(anchor, Near).then(|| term(Near, anchor));
            Some(std::iter::once(term(side, anchor)).chain(near).collect())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_of_every_kind_are_open_and_were_solved() {
        for kind in TaskKind::ALL {
            let task = ArrangementTask::of_slot(Split::Train, (kind, 3), 0).unwrap_or_else(|| panic!("no task of kind {}", kind.name()));
            assert_eq!(task.goals.len(), 3);
            assert!(!task.hold(&task.truth), "{}: nothing is left to do", kind.name());
            let aside = usize::from(matches!(kind, TaskKind::Swap | TaskKind::Unstack));
            assert_eq!(task.moves, 3 + aside, "{}", kind.name());
            let moved: Vec<u16> = task.goals.iter().map(|goal| goal.object).collect();
            let waits = task.goals.iter().any(|goal| goal.terms.iter().any(|term| moved.contains(&term.anchor)));
            assert_eq!(waits, kind == TaskKind::Ordered, "{}: goals about objects that move", kind.name());
        }
    }

    #[test]
    fn the_same_slot_gives_the_same_task() {
        let task = || ArrangementTask::of_slot(Split::Train, (TaskKind::Free, 2), 3).expect("a task");
        let (first, again) = (task(), task());
        assert_eq!((first.seed, first.goals, first.observed.id()), (again.seed, again.goals, again.observed.id()));
    }
}
