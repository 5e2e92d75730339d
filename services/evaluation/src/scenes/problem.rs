//! One problem: a simulated scene that was never trained on, what a camera saw of it, an object to move and a goal that does not hold yet.
//!
//! Ground truth: instance masks, the camera's pose (and so gravity), meshes and poses. Observed: depth with the sensor model, and
//! everything that perception makes of it.

use nalgebra::Isometry3;
use rand::RngExt;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_pcg::Pcg64;
use repose_dataset::Split;
use repose_geometry::{Pinhole, ViewerFrame};
use repose_proto::{CameraModel, Frame, GoalTerm, Relation, RigidTransform, Scene};
use repose_sensor::SensorModel;
use repose_simulator::render::{Drawable, Picture, picture};
use repose_simulator::scene::{SceneSettings, SimulatedScene, scene_of_seed};
use repose_simulator::viewpoint::{ViewpointSettings, random_viewpoint};

use crate::scenes::loads::true_loads;

/// The paper's goals in its evaluation scenes (section 3).
pub const GOAL_RELATIONS: [Relation; 4] = [Relation::InFrontOf, Relation::Behind, Relation::LeftOf, Relation::RightOf];

/// Where problems come from.
#[derive(Debug, Clone)]
pub struct ProblemSettings {
    /// How scenes are made.
    pub scene: SceneSettings,
    /// How cameras are chosen; the picture's size too.
    pub viewpoint: ViewpointSettings,
    /// The depth sensor.
    pub sensor: SensorModel,
    /// How the frame is segmented (true masks are given).
    pub perception: repose_perception::Settings,
    /// The fewest observed points of a query or an anchor.
    pub min_points: usize,
    /// Cameras tried per scene until two objects are seen well enough.
    pub viewpoints: usize,
    /// The relations that goals are drawn of.
    pub relations: Vec<Relation>,
}

impl Default for ProblemSettings {
    fn default() -> Self {
        Self {
            scene: SceneSettings::default(),
            viewpoint: ViewpointSettings { width: 640, height: 480, ..ViewpointSettings::default() },
            sensor: SensorModel::default(),
            perception: repose_perception::Settings::default(),
            min_points: 300,
            viewpoints: 20,
            relations: GOAL_RELATIONS.to_vec(),
        }
    }
}

/// A camera's view of a scene: its pose, and what it observed.
#[derive(Debug, Clone)]
pub struct CameraView {
    /// The camera.
    pub camera: Pinhole,
    /// Its true pose.
    pub world_from_camera: Isometry3<f64>,
    /// What it saw, with true masks.
    pub frame: Frame,
    /// What perception made of that.
    pub observed: Scene,
}

impl CameraView {
    /// From a camera that is drawn at random; `seed` is the sensor's. `None` where perception can make nothing of the picture.
    pub fn at_random(truth: &SimulatedScene, settings: &ProblemSettings, rng: &mut Pcg64, seed: u64) -> Option<Self> {
        let (camera, world_from_camera) = random_viewpoint(&truth.focus(), &settings.viewpoint, rng);
        let frame = frame_of(truth, &camera, &world_from_camera, &settings.sensor, seed);
        let observed = repose_perception::segment(&frame, &settings.perception).ok()?;
        Some(Self { camera, world_from_camera, frame, observed })
    }
}

/// A problem with its truth.
#[derive(Debug, Clone)]
pub struct Problem {
    /// The scene's seed.
    pub seed: u64,
    /// The true scene.
    pub truth: SimulatedScene,
    /// The camera.
    pub camera: Pinhole,
    /// Its true pose.
    pub world_from_camera: Isometry3<f64>,
    /// The viewer of every relation.
    pub viewer: ViewerFrame,
    /// What the camera saw, with true masks.
    pub frame: Frame,
    /// What perception made of it.
    pub observed: Scene,
    /// The object to move.
    pub query: u16,
    /// The goal: one term.
    pub goal: GoalTerm,
}

impl Problem {
    /// The problem of scene `index` of a split; `None` where the split ends before it, or the seed gives no scene or no goal that is still open.
    pub fn of_split(split: Split, index: u64, settings: &ProblemSettings) -> Option<Self> {
        Self::of_seed(split.seed(index)?, settings)
    }

    /// The problem of a scene seed; `None` where the seed gives no scene or no goal that is still open.
    pub fn of_seed(seed: u64, settings: &ProblemSettings) -> Option<Self> {
        let (truth, _) = scene_of_seed(seed, &settings.scene).ok()?;
        // A stream of its own, so that a change in how scenes are drawn does not change which goals are.
        let mut rng = Pcg64::new(u128::from(seed), 0x9e0b_1e55);
        for _ in 0..settings.viewpoints {
            let Some(view) = CameraView::at_random(&truth, settings, &mut rng, seed) else { continue };
            let CameraView { camera, world_from_camera, frame, observed } = view;
            let viewer = ViewerFrame::from_camera(&world_from_camera);
            let seen: Vec<u16> = observed.meta.objects.iter().filter(|o| o.points >= settings.min_points).map(|o| o.id).collect();
            let Some((query, goal)) = open_goal(&truth, &viewer, &seen, &settings.relations, &mut rng) else { continue };
            return Some(Self { seed, truth, camera, world_from_camera, viewer, frame, observed, query, goal });
        }
        None
    }

    /// The index of an object in the true scene.
    pub fn index_of(&self, id: u16) -> Option<usize> {
        self.truth.objects.iter().position(|o| o.id == id)
    }
}

/// What the sensor reports of a true scene, with true masks and the true pose.
pub fn frame_of(scene: &SimulatedScene, camera: &Pinhole, world_from_camera: &Isometry3<f64>, sensor: &SensorModel, seed: u64) -> Frame {
    frame_with(scene, |_| true, camera, world_from_camera, sensor, seed)
}

/// As [`frame_of`], as if only those objects were there of whose id `present` holds.
pub fn frame_with(
    scene: &SimulatedScene,
    present: impl Fn(u16) -> bool,
    camera: &Pinhole,
    world_from_camera: &Isometry3<f64>,
    sensor: &SensorModel,
    seed: u64,
) -> Frame {
    let drawables: Vec<_> = scene.drawables().into_iter().filter(|d| d.label == 0 || present(d.label)).collect();
    frame_drawn(&drawables, camera, world_from_camera, sensor, seed)
}

/// What the sensor reports of things that are drawn, with true masks and the true pose.
pub fn frame_drawn(
    drawables: &[Drawable<'_>],
    camera: &Pinhole,
    world_from_camera: &Isometry3<f64>,
    sensor: &SensorModel,
    seed: u64,
) -> Frame {
    let mut seen = picture(camera, world_from_camera, drawables);
    sensor.disturb(seen.depth_m.pixels_mut(), camera, seed);
    frame_of_picture(seen, camera, world_from_camera)
}

/// The frame of a picture, with true masks and the true pose.
pub fn frame_of_picture(seen: Picture, camera: &Pinhole, world_from_camera: &Isometry3<f64>) -> Frame {
    const DEPTH_UNIT_M: f32 = 0.001;
    let camera = CameraModel {
        width: camera.width,
        height: camera.height,
        fx: camera.fx,
        fy: camera.fy,
        cx: camera.cx,
        cy: camera.cy,
        depth_unit_m: f64::from(DEPTH_UNIT_M),
        world_from_camera: Some(RigidTransform(repose_geometry::transform::to_row_major(world_from_camera))),
    };
    let depth = seen.depth_m.pixels().iter().map(|d| (d / DEPTH_UNIT_M).round() as u16).collect();
    Frame {
        color: Some(seen.color.into_pixels()),
        labels: Some(seen.labels.into_pixels()),
        ..Frame::new("evaluation".to_owned(), 0, camera, depth)
    }
}

/// A random query, anchor and relation among the objects seen, such that the relation does not hold. The query carries nothing.
fn open_goal(scene: &SimulatedScene, viewer: &ViewerFrame, seen: &[u16], of: &[Relation], rng: &mut Pcg64) -> Option<(u16, GoalTerm)> {
    let n = scene.objects.len();
    let relations = scene.relations(viewer);
    let loads = true_loads(scene);
    let index = |id: u16| scene.objects.iter().position(|o| o.id == id);
    let mut queries: Vec<u16> = seen.iter().copied().filter(|id| !loads.contains_key(id)).collect();
    queries.shuffle(rng);
    for query in queries {
        let anchors: Vec<u16> = seen.iter().copied().filter(|a| *a != query).collect();
        let Some(&anchor) = anchors.choose(rng) else { continue };
        let (i, j) = (index(query)?, index(anchor)?);
        let first = rng.random_range(0..of.len());
        let open = (0..of.len()).map(|k| of[(first + k) % of.len()]).find(|relation| !relations[i * n + j][relation.index()]);
        if let Some(relation) = open {
            return Some((query, GoalTerm { relation, anchor, holds: true }));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_problem_of_a_split_comes_from_the_scenes_of_the_next() {
        let seeds = Split::Test.seeds();
        let (scenes, settings) = (seeds.end - seeds.start, ProblemSettings::default());
        assert!((0..5).all(|beyond| Problem::of_split(Split::Test, scenes + beyond, &settings).is_none()));
    }
}
