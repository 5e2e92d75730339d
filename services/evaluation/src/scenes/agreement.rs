//! Whether what is said of a release depends on the physics step: the same placements, let go at the usual step and at a finer one.
//!
//! The placements are of every sort that a planner may propose: set down on a surface, floating up to 6 cm above one, half over an edge,
//! on top of another object; so that both outcomes occur.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};
use rand_pcg::Pcg64;
use repose_simulator::release::{ReleaseSettings, penetration_of, released};
use repose_simulator::scene::{FurnitureSurface, SceneSettings, SimulatedScene, scene_of_seed};

use crate::scenes::outcome::{PENETRATION_M, STABLE_M};

/// The two step lengths.
#[derive(Debug, Clone, Copy)]
pub struct StepSettings {
    /// The release at the usual step.
    pub usual: ReleaseSettings,
    /// How many times shorter the steps of the other simulation are.
    pub finer: usize,
}

impl Default for StepSettings {
    fn default() -> Self {
        Self { usual: ReleaseSettings::default(), finer: 4 }
    }
}

/// How the outcomes of releases compare at two step lengths.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize)]
pub struct Releases {
    /// Placements that were released.
    pub placements: usize,
    /// Stable at both steps.
    pub both_stable: usize,
    /// Unstable at both.
    pub both_unstable: usize,
    /// Stable at the usual step only.
    pub only_usual_stable: usize,
    /// Stable at the finer step only.
    pub only_finer_stable: usize,
}

impl Releases {
    /// The share of placements of which both steps say the same, percent.
    pub fn agreement_percent(&self) -> f64 {
        100.0 * (self.both_stable + self.both_unstable) as f64 / self.placements.max(1) as f64
    }

    pub(crate) fn of(outcomes: &[Option<[bool; 2]>]) -> Self {
        let count = |which: [bool; 2]| outcomes.iter().flatten().filter(|o| **o == which).count();
        Self {
            placements: outcomes.iter().flatten().count(),
            both_stable: count([true, true]),
            both_unstable: count([false, false]),
            only_usual_stable: count([true, false]),
            only_finer_stable: count([false, true]),
        }
    }
}

/// Whether a random placement in the scene of a seed (or of one soon after it) is stable, at the usual step and at the finer.
pub(crate) fn compared(seed: u64, scene: &SceneSettings, steps: &StepSettings) -> Option<[bool; 2]> {
    const SEEDS_APART: u64 = 100_000;
    let (scene, (index, placed)) = (0..10).find_map(|retry| {
        let seed = seed + retry * SEEDS_APART;
        let (scene, _) = scene_of_seed(seed, scene).ok()?;
        let placement = placement(&scene, &mut Pcg64::new(u128::from(seed), 0x0b7e_c7ed))?;
        Some((scene, placement))
    })?;
    let usual = steps.usual;
    let mut finer = ReleaseSettings { steps: usual.steps * steps.finer, ..usual };
    finer.physics.step_s /= steps.finer as f32;
    let stable = |release: &ReleaseSettings| Some(released(&scene, index, &placed, release)?.moved_m < STABLE_M);
    Some([stable(&usual)?, stable(&finer)?])
}

/// A random object and where it is let go; `None` when no draw was free.
fn placement(scene: &SimulatedScene, rng: &mut impl Rng) -> Option<(usize, Isometry3<f64>)> {
    const TRIES: usize = 60;
    for _ in 0..TRIES {
        let index = rng.random_range(0..scene.objects.len());
        let object = &scene.objects[index];
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(-std::f64::consts::PI..std::f64::consts::PI));
        let rotation = yaw * object.world_from_object.rotation;
        let (at, support_m) = spot(scene, index, rng)?;
        let float_m = if rng.random_bool(0.4) { rng.random_range(0.0..0.06) } else { 0.0005 };
        let turned = Isometry3::from_parts(Translation3::identity(), rotation);
        let height_m = support_m + object.shape.depth_below_origin_m(&turned) + float_m;
        let placed = Isometry3::from_parts(Translation3::new(at.x, at.y, height_m), rotation);
        if penetration_of(scene, index, &placed) <= PENETRATION_M {
            return Some((index, placed));
        }
    }
    None
}

/// A horizontal position and the height of what is there: on a surface near the other objects, at the surface's edge, or on an object.
fn spot(scene: &SimulatedScene, index: usize, rng: &mut impl Rng) -> Option<(Point3<f64>, f64)> {
    let others: Vec<usize> = (0..scene.objects.len()).filter(|i| *i != index).collect();
    let other = &scene.objects[*others.get(rng.random_range(0..others.len().max(1)))?];
    let middle = Point3::from(other.world_from_object.translation.vector);
    let mut near = |reach: f64| middle + Vector3::new(rng.random_range(-reach..reach), rng.random_range(-reach..reach), 0.0);
    let (beside, above) = (near(0.25), near(0.04));
    let surfaces: Vec<&FurnitureSurface> = scene.surfaces.iter().filter(|s| s.weight > 0.0).collect();
    let surface = surfaces.get(rng.random_range(0..surfaces.len().max(1)))?;
    match rng.random_range(0..3) {
        0 => {
            let local = surface.world_from_surface.inverse_transform_point(&beside);
            let half = surface.half_extents_m;
            let inside = Point3::new(local.x.clamp(-half.x, half.x), local.y.clamp(-half.y, half.y), 0.0);
            Some((surface.world_from_surface * inside, surface.height_m()))
        }
        1 => {
            let half = surface.half_extents_m;
            let past = rng.random_range(-0.04..0.04);
            let along = rng.random_range(-0.8..0.8);
            let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
            let edge = if rng.random_bool(0.5) {
                Point3::new(side * (half.x + past), along * half.y, 0.0)
            } else {
                Point3::new(along * half.x, side * (half.y + past), 0.0)
            };
            Some((surface.world_from_surface * edge, surface.height_m()))
        }
        _ => {
            let corners = other.shape.bounds(&other.world_from_object).corners();
            Some((above, corners.iter().map(|c| c.z).fold(f64::NEG_INFINITY, f64::max)))
        }
    }
}
