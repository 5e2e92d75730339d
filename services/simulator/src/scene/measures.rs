//! What is measured on a scene at rest: gaps, overlaps, how far things moved.

use nalgebra::Isometry3;

use super::SimulatedScene;
use crate::contact::PlacedParts;
use crate::furniture::Fixture;
use crate::objects::ObjectShape;

/// A bound on how far any point of an object moved between two poses, metres.
pub fn displacement_m(shape: &ObjectShape, world_from_before: &Isometry3<f64>, world_from_after: &Isometry3<f64>) -> f64 {
    let turned = world_from_before.rotation.angle_to(&world_from_after.rotation);
    (world_from_after.translation.vector - world_from_before.translation.vector).norm() + turned * shape.radius_m()
}

pub(super) struct Measures {
    /// Distance between the surfaces of objects, `[n * n]`.
    pub gaps_m: Vec<f32>,
    /// The deepest overlap that an object has part in.
    pub penetration_m: f32,
}

pub(super) fn measured(scene: &SimulatedScene) -> Measures {
    let n = scene.objects.len();
    let objects: Vec<Option<PlacedParts>> = scene.objects.iter().map(|o| PlacedParts::new(&o.shape.parts, &o.world_from_object)).collect();
    let fixtures: Vec<PlacedParts> = scene.fixtures.iter().filter_map(Fixture::placed).collect();
    let mut gaps_m = vec![0.0f32; n * n];
    let mut penetration_m = 0.0f32;
    for (i, a) in objects.iter().enumerate() {
        let Some(a) = a else { continue };
        for fixture in &fixtures {
            penetration_m = penetration_m.max(a.penetration_m(fixture));
        }
        for (j, b) in objects.iter().enumerate().skip(i + 1) {
            let Some(b) = b else { continue };
            let gap = a.distance_m(b);
            gaps_m[i * n + j] = gap;
            gaps_m[j * n + i] = gap;
            if gap == 0.0 {
                penetration_m = penetration_m.max(a.penetration_m(b));
            }
        }
    }
    Measures { gaps_m, penetration_m }
}
