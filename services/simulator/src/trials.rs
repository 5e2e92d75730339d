//! Objects of a scene let go here and there, and what comes of it: what the outcome network learns from.
//!
//! Places are drawn to be worth learning from: where the object rested, a little beside it or turned, near another object, and the paper's
//! negatives; most of them set down on what is under them, some a few millimetres into it or above it, since that is what candidates look
//! like before and after they are grounded.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use repose_dataset::ReleaseRecord;

use crate::release::{ReleaseSettings, Surroundings, released};
use crate::scene::SimulatedScene;

/// How the places of simulated releases are drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct ReleaseTrialSettings {
    /// Trials of a scene, spread over its objects.
    pub per_scene: usize,
    /// How likely each kind of place is, relative to the others.
    pub weights: TrialWeights,
    /// Places beside where the object rested are at most this far from it, metres.
    pub beside_m: f64,
    /// Places near another object are at most this far from its centre, metres.
    pub near_m: f64,
    /// How far the paper's negatives are moved, metres: nearest and farthest.
    pub negative_m: [f64; 2],
    /// Share of the trials whose object is turned about z.
    pub turned: f64,
    /// Share of the trials set down with nothing but a hair of air between.
    pub grounded: f64,
    /// Standard deviation of the height of half of the others over (or in) what is under them, metres: the prior's least is 5 mm.
    pub height_m: f64,
    /// Heights of the other half, metres: lowest and highest. Draws from the prior float as high, and what falls less than 5 cm counts as stable.
    pub heights_m: [f64; 2],
    /// How a release is simulated.
    pub release: ReleaseSettings,
}

/// How likely each kind of place is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrialWeights {
    /// Where the object rested.
    pub rest: f64,
    /// A little beside it.
    pub beside: f64,
    /// Near another object.
    pub near: f64,
    /// The paper's negatives: moved in any direction, as they are.
    pub negative: f64,
}

impl Default for ReleaseTrialSettings {
    fn default() -> Self {
        Self {
            per_scene: 12,
            weights: TrialWeights { rest: 0.2, beside: 0.25, near: 0.45, negative: 0.1 },
            beside_m: 0.06,
            near_m: 0.35,
            negative_m: [0.02, 0.15],
            turned: 0.5,
            grounded: 0.6,
            height_m: 0.008,
            heights_m: [-0.02, 0.09],
            release: ReleaseSettings { ends_at_rest: true, ..ReleaseSettings::default() },
        }
    }
}

/// The air that is left under what is set down, metres: overlaps would push it away.
const AIR_M: f32 = 0.001;
/// From this far above what may be under it an object is lowered, metres.
const LOWERED_FROM_M: f64 = 0.01;
/// Steps of lowering at most; each goes as far as nothing can be met.
const LOWERING_STEPS: usize = 16;

/// Lets objects of the scene go; the same for the same scene and settings.
pub fn trials(scene: &SimulatedScene, settings: &ReleaseTrialSettings) -> Vec<ReleaseRecord> {
    const TRIAL_STREAM: u128 = 0x7e1e_a5e0_0000_0001;
    let mut rng = Pcg64::new(u128::from(scene.seed), TRIAL_STREAM);
    let trial = |_| {
        let index = rng.random_range(0..scene.objects.len());
        let around = Surroundings::of(scene, index)?;
        let (world_from_object, yaw_rad) = place(scene, index, &around, settings, &mut rng);
        let_go(scene, index, &world_from_object, yaw_rad, &settings.release)
    };
    let count = if scene.objects.is_empty() { 0 } else { settings.per_scene };
    (0..count).filter_map(trial).collect()
}

/// Lets object `index` go at `world_from_object`, turned by `yaw_rad` from how it stands in the scene, and writes down what comes of it. `None`
/// when the scene has no such object.
pub fn let_go(
    scene: &SimulatedScene,
    index: usize,
    world_from_object: &Isometry3<f64>,
    yaw_rad: f64,
    settings: &ReleaseSettings,
) -> Option<ReleaseRecord> {
    let outcome = released(scene, index, world_from_object, settings)?;
    Some(ReleaseRecord {
        scene_seed: scene.seed,
        object: scene.objects[index].id,
        origin_m: world_from_object.translation.vector.cast::<f32>().into(),
        yaw_rad: yaw_rad as f32,
        moved_m: outcome.moved_m as f32,
        tilt_rad: outcome.tilt_rad as f32,
        penetration_m: outcome.penetration_m,
        others_moved_m: outcome.others_moved_m as f32,
    })
}

/// A place for object `index`: its pose, and its turn about z from how it stands in the scene.
fn place(
    scene: &SimulatedScene,
    index: usize,
    around: &Surroundings,
    settings: &ReleaseTrialSettings,
    rng: &mut Pcg64,
) -> (Isometry3<f64>, f64) {
    let standing = scene.objects[index].world_from_object;
    let yaw_rad = if rng.random_bool(settings.turned) { rng.random_range(-std::f64::consts::PI..std::f64::consts::PI) } else { 0.0 };
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad) * standing.rotation;
    let at = |origin: Vector3<f64>| Isometry3::from_parts(Translation3::from(origin), rotation);
    let (here, w) = (standing.translation.vector, &settings.weights);
    let mut pick = rng.random_range(0.0..w.rest + w.beside + w.near + w.negative);
    let mut is_kind = |weight: f64| {
        pick -= weight;
        pick < 0.0
    };
    let origin = if is_kind(w.rest) {
        here
    } else if is_kind(w.beside) {
        here + level(rng) * rng.random_range(0.0..settings.beside_m)
    } else if is_kind(w.near) {
        let other = &scene.objects[rng.random_range(0..scene.objects.len())].world_from_object.translation.vector;
        // Uniform over the disc.
        let reach = settings.near_m * rng.random_range(0.0..1.0f64).sqrt();
        Vector3::new(other.x, other.y, here.z) + level(rng) * reach
    } else {
        let up: f64 = rng.random_range(-1.0..=1.0);
        let direction = level(rng) * (1.0 - up * up).sqrt() + Vector3::z() * up;
        return (at(here + direction * rng.random_range(settings.negative_m[0]..settings.negative_m[1])), yaw_rad);
    };
    let mut pose = at(origin);
    lower(around, &mut pose, rng);
    if !rng.random_bool(settings.grounded) {
        let normal: f64 = StandardNormal.sample(rng);
        let near = rng.random_bool(0.5);
        pose.translation.z +=
            if near { settings.height_m * normal } else { rng.random_range(settings.heights_m[0]..settings.heights_m[1]) };
    }
    (pose, yaw_rad)
}

/// A level direction.
fn level(rng: &mut impl Rng) -> Vector3<f64> {
    let (sin, cos) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
    Vector3::new(cos, sin, 0.0)
}

/// Sets an object down on one of the things under it, by going as far as nothing can be met, again and again. It starts above the highest
/// thing, or now and then below it (a shelf's lower board, a drawer) where that is free.
fn lower(around: &Surroundings, pose: &mut Isometry3<f64>, rng: &mut impl Rng) {
    let (lowest_point_m, tops) = around.column_m(pose);
    let Some(last) = tops.len().checked_sub(1) else { return };
    let start = if rng.random_bool(0.3) { rng.random_range(0..=last) } else { 0 };
    // From the lowest point up to the origin.
    let bottom = pose.translation.z - lowest_point_m;
    pose.translation.z = tops[start] + LOWERED_FROM_M + bottom;
    if around.distance_m(pose) <= 0.0 {
        pose.translation.z = tops[0] + LOWERED_FROM_M + bottom;
    }
    for _ in 0..LOWERING_STEPS {
        let free_m = around.distance_m(pose) - AIR_M;
        if free_m < AIR_M || pose.translation.z < tops[last] + bottom {
            break;
        }
        pose.translation.z -= f64::from(free_m);
    }
    // Distances between hulls are now and then millimetres too long.
    for _ in 0..LOWERING_STEPS {
        let Some((_, depth_m)) = around.deepest(pose) else { return };
        pose.translation.z += f64::from(depth_m + AIR_M);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::release::penetration_of;
    use crate::scene::{SceneSettings, scene_of_seed};

    #[test]
    fn trials_are_the_same_again_and_of_both_outcomes() {
        let settings = ReleaseTrialSettings { per_scene: 8, ..ReleaseTrialSettings::default() };
        let all: Vec<ReleaseRecord> = [11, 12, 13]
            .iter()
            .filter_map(|seed| scene_of_seed(*seed, &SceneSettings::default()).ok())
            .flat_map(|(scene, _)| {
                let first = trials(&scene, &settings);
                assert_eq!(first, trials(&scene, &settings));
                first
            })
            .collect();
        let stayed = all.iter().filter(|r| r.moved_m < 0.05).count();
        assert!(stayed > all.len() / 5 && stayed < all.len(), "{stayed} of {}", all.len());
        assert!(all.iter().all(|r| r.origin_m.iter().all(|x| x.is_finite()) && r.moved_m >= 0.0));
    }

    #[test]
    fn what_is_lowered_stands_free_and_close_above_something() {
        let (scene, _) = scene_of_seed(11, &SceneSettings::default()).expect("seed 11 gives a scene");
        let around = Surroundings::of(&scene, 0).expect("an object");
        let mut rng = Pcg64::new(1, 2);
        for _ in 0..20 {
            let mut pose = scene.objects[0].world_from_object;
            pose.translation.vector += level(&mut rng) * 0.1;
            lower(&around, &mut pose, &mut rng);
            let gap_m = around.distance_m(&pose);
            assert_eq!(penetration_of(&scene, 0, &pose), 0.0);
            assert!(gap_m < 0.01, "{gap_m}");
        }
    }
}
