//! What becomes of every object of a training scene when it is set down alone as it was seen or turned over, and of its neighbours when it is taken
//! away, with what the planner measures of them: what the forecasts of [`repose_planner::learned::standing`] are fitted on.

use std::collections::BTreeMap;

use nalgebra::Isometry3;
use rand_pcg::Pcg64;
use repose_planner::learned::neighbours::beside;
use repose_planner::learned::standing::Stance;
use repose_planner::settings::SupportSettings;
use repose_planner::{PreparedScene, turned_over, turns};
use repose_simulator::furniture::{Fixture, FurnitureRole};
use repose_simulator::physics::RestSettings;
use repose_simulator::release::{ReleaseSettings, released};
use repose_simulator::scene::{KindWeights, Outlook, SceneKind, SceneObject, SimulatedScene, scene_of_seed};
use serde::{Deserialize, Serialize};

use crate::scenes::outcome::{OTHERS_MOVED_M, STABLE_M, TILT_RAD};
use crate::scenes::problem::{CameraView, ProblemSettings};
use crate::statistics::forecast_fit::FitSample;

/// The first of the training scenes that are learned from.
pub const FIRST_SEED: u64 = 700_000_000;
/// Views of each scene.
const VIEWS: usize = 2;
/// Other sides of each object in each view: the widest, which is where a planner sets it down.
const SIDES: usize = 2;
/// The fewest observed points of an object that is learned from.
const MIN_POINTS: usize = 100;
/// Half the edge of the floor that it is set down on, metres.
const FLOOR_M: f64 = 2.0;

/// One scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneStances {
    /// The scene.
    pub seed: u64,
    /// What was measured of each object in each view, as it lay and on other sides, and whether it stood when it was set down alone like that.
    pub stands: Vec<(Vec<f32>, bool)>,
    /// What was measured of each neighbour of each object in each view, and whether it stayed when that was taken away.
    pub stays: Vec<(Vec<f32>, bool)>,
}

impl SceneStances {
    /// The `index`-th scene that is learned from; kinds of scenes take turns. Empty where the seed gives no scene.
    pub fn of(index: u64) -> Self {
        let mut stances = Self { seed: FIRST_SEED + index, stands: Vec::new(), stays: Vec::new() };
        let mut settings = ProblemSettings::default();
        settings.scene.kinds = KindWeights::only(SceneKind::ALL[index as usize % SceneKind::ALL.len()]);
        let Ok((truth, _)) = scene_of_seed(stances.seed, &settings.scene) else { return stances };
        let ids: Vec<u16> = truth.objects.iter().map(|o| o.id).collect();
        let stands: BTreeMap<u16, bool> = ids.iter().copied().zip(truth.objects.iter().map(stands_alone)).collect();
        let stays: BTreeMap<u16, BTreeMap<u16, bool>> = ids.iter().map(|id| (*id, stay_without(&truth, *id))).collect();
        let mut rng = Pcg64::new(u128::from(stances.seed), 0x57a9_ce55);
        for _ in 0..VIEWS {
            let Some(view) = CameraView::at_random(&truth, &settings, &mut rng, stances.seed) else { continue };
            let prepared = PreparedScene::new(std::sync::Arc::new(view.observed));
            let seen = prepared.belief.objects.iter().filter(|(_, object)| object.points.len() >= MIN_POINTS).map(|(id, _)| *id);
            let seen: BTreeMap<u16, Stance<'_>> = seen.filter_map(|id| Some((id, Stance::of(&prepared, id)?))).collect();
            for (id, stance) in &seen {
                stances.stands.extend(stands.get(id).map(|stood| (stance.measures(None), *stood)));
                for (other, neighbour) in seen.iter().filter(|(other, _)| *other != id) {
                    let stayed = stays.get(id).and_then(|others| others.get(other));
                    stances.stays.extend(stayed.zip(beside(neighbour, stance)).map(|(stayed, measures)| (measures, *stayed)));
                }
            }
            let in_view = truth.objects.iter().filter(|object| seen.contains_key(&object.id));
            stances.stands.extend(in_view.flat_map(|object| on_sides(&prepared, object)));
        }
        stances
    }

    /// Objects, to learn from.
    pub fn samples(&self) -> Vec<FitSample> {
        samples(&self.stands)
    }

    /// Neighbours, to learn from.
    pub fn neighbour_samples(&self) -> Vec<FitSample> {
        samples(&self.stays)
    }
}

fn samples(measured: &[(Vec<f32>, bool)]) -> Vec<FitSample> {
    measured.iter().map(|(measures, came_true)| FitSample { measures: measures.clone(), came_true: *came_true }).collect()
}

/// An object on the other sides that it is believed to have: what is measured of it there, and whether it stands.
fn on_sides(prepared: &PreparedScene, object: &SceneObject) -> Vec<(Vec<f32>, bool)> {
    // What carries something is not turned over.
    let Ok(sides) = turns(prepared, object.id) else { return Vec::new() };
    let on_side = |turn: Isometry3<f64>| {
        let table = turned_over(prepared, object.id, turn).ok()?;
        let measures = Stance::of(&table.prepared, object.id)?.measures(Some(&table.turned));
        let stands = stands_alone(&SceneObject { world_from_object: turn * object.world_from_object, ..object.clone() });
        Some((measures, stands))
    };
    sides.into_iter().take(SIDES).filter_map(on_side).collect()
}

/// Whether an object neither tips nor moves away when it is let go over an empty floor in the attitude that it has.
pub(crate) fn stands_alone(object: &SceneObject) -> bool {
    let half = nalgebra::Vector3::new(FLOOR_M, FLOOR_M, 0.025);
    let floor = Fixture::new(FurnitureRole::Floor, half, Isometry3::translation(0.0, 0.0, -half.z), [128; 3]);
    let alone = SimulatedScene {
        seed: 0,
        kind: SceneKind::OpenTable,
        fixtures: vec![floor],
        surfaces: Vec::new(),
        outlook: Outlook::AROUND,
        objects: vec![object.clone()],
        gaps_m: vec![0.0],
    };
    let mut over_floor = object.world_from_object;
    over_floor.translation.vector = nalgebra::Vector3::z()
        * (object.shape.depth_below_origin_m(&object.world_from_object) + f64::from(SupportSettings::default().release_m));
    let settings = ReleaseSettings { ends_at_rest: true, ..ReleaseSettings::default() };
    released(&alone, 0, &over_floor, &settings).is_some_and(|came| came.tilt_rad <= TILT_RAD && came.moved_m < STABLE_M)
}

/// Whether each other object of a scene stays where it is when one is taken away.
fn stay_without(scene: &SimulatedScene, id: u16) -> BTreeMap<u16, bool> {
    let mut without = scene.clone();
    without.objects.retain(|o| o.id != id);
    let settings = ReleaseSettings::default();
    let mut world = without.world(settings.physics);
    world.run(settings.steps, Some(&RestSettings::default()));
    let moved_m =
        |before: &SceneObject, after: &Isometry3<f64>| (before.world_from_object.translation.vector - after.translation.vector).norm();
    without.objects.iter().zip(world.poses()).map(|(before, after)| (before.id, moved_m(before, &after) <= OTHERS_MOVED_M)).collect()
}
