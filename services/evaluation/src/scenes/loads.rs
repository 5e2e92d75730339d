//! What truly lies on what in a simulated scene, and what is believed to.
//!
//! An object bears another where it stops it from going down: lowered a little, the other would be pressed into it. So what leans on a thing
//! counts where the thing's surface there faces upwards more than sideways.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Isometry3, Translation3};
use repose_belief::Belief;
use repose_simulator::contact::PlacedParts;
use repose_simulator::scene::{SceneKind, SceneObject, SimulatedScene};
use serde::Serialize;

/// How far a load is lowered, metres.
const LOWERED_M: f32 = 0.004;
/// What is farther than this from another is not borne by it, metres: bodies at rest keep a small distance.
const TOUCHING_M: f32 = 0.002;
/// The least upward part of the direction in which a load is held.
const UPWARDS: f32 = 0.5;

/// The loads of each object of a scene, by its id; what bears nothing is left out.
pub fn true_loads(scene: &SimulatedScene) -> BTreeMap<u16, BTreeSet<u16>> {
    let placed = |object: &SceneObject, pose: &Isometry3<f64>| PlacedParts::new(&object.shape.parts, pose);
    let lowered = |object: &SceneObject| Translation3::new(0.0, 0.0, -f64::from(LOWERED_M)) * object.world_from_object;
    let mut loads: BTreeMap<u16, BTreeSet<u16>> = BTreeMap::new();
    for (i, below) in scene.objects.iter().enumerate() {
        for (j, above) in scene.objects.iter().enumerate().filter(|(j, _)| *j != i) {
            let gap_m = scene.gaps_m[i * scene.objects.len() + j];
            let parts = (placed(below, &below.world_from_object), placed(above, &above.world_from_object), placed(above, &lowered(above)));
            let (Some(below_parts), Some(above_parts), Some(lowered_parts)) = parts else { continue };
            let pressed_m = lowered_parts.penetration_m(&below_parts) - above_parts.penetration_m(&below_parts);
            if gap_m <= TOUCHING_M && pressed_m + gap_m >= UPWARDS * LOWERED_M {
                loads.entry(below.id).or_default().insert(above.id);
            }
        }
    }
    loads
}

/// An object that a camera saw, and what lies on it of the others that it saw.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LoadBelief {
    /// The scene.
    pub seed: u64,
    /// The object.
    pub id: u16,
    /// Its kind of scene.
    pub kind: SceneKind,
    /// What truly lies on it.
    pub borne: BTreeSet<u16>,
    /// What is believed to.
    pub told: BTreeSet<u16>,
}

/// What is believed to lie on each of the objects with so many points, of those.
pub fn believed_loads(truth: &SimulatedScene, belief: &Belief, min_points: usize) -> Vec<LoadBelief> {
    let loads = true_loads(truth);
    let is_seen = |id: &u16| belief.objects.get(id).is_some_and(|object| object.points.len() >= min_points);
    let seen: BTreeSet<u16> = truth.objects.iter().map(|object| object.id).filter(is_seen).collect();
    let of = |id: &u16| LoadBelief {
        seed: truth.seed,
        id: *id,
        kind: truth.kind,
        borne: loads.get(id).map_or_else(BTreeSet::new, |loads| loads & &seen),
        told: &belief.carried(*id).iter().copied().collect::<BTreeSet<u16>>() & &seen,
    };
    seen.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use repose_simulator::scene::{KindWeights, SceneSettings, scene_of_seed};

    use super::*;

    #[test]
    fn what_another_bears_touches_it_and_does_not_bear_it_in_turn() {
        let settings = SceneSettings { kinds: KindWeights::only(SceneKind::Stacking), ..SceneSettings::default() };
        let stacked = |seed: u64| {
            let (scene, _) = scene_of_seed(seed, &settings).ok()?;
            let loads = true_loads(&scene);
            (!loads.is_empty()).then_some((scene, loads))
        };
        let (scene, loads) = (5..30).find_map(stacked).expect("a stack");
        let index = |id: u16| scene.objects.iter().position(|object| object.id == id).expect("an object");
        for (below, above) in loads.iter().flat_map(|(below, above)| above.iter().map(move |above| (*below, *above))) {
            assert!(scene.gaps_m[index(below) * scene.objects.len() + index(above)] <= TOUCHING_M, "{above} on {below}");
            assert!(!loads.get(&above).is_some_and(|loads| loads.contains(&below)), "{above} and {below}");
        }
    }
}
