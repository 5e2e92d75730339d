//! What was seen of the objects of training scenes in grids over them, with which of the cells they truly fill: what the network that completes shapes
//! ([`repose_networks::completion`]) is trained on.

use nalgebra::Vector3;
use repose_belief::completion::Grid;
use repose_belief::{Belief, BeliefSettings, SeenScene};
use repose_networks::completion::{CHANNELS, SIDE, SLABS};
use repose_simulator::contact::PlacedParts;

use crate::scenes::believed::MIN_POINTS;
use crate::scenes::training_views::TrainingViews;

/// The first of the training scenes that are learned from.
pub const FIRST_SEED: u64 = 870_000_000;
/// How they are seen.
const VIEWS: TrainingViews =
    TrainingViews { stream: 0xc0_4913, views: 3, sizes: &[[640, 480], [320, 240]], found_masks: Some(0.25), faults: Some(0.15) };
/// Heights in a slab at which it is asked whether it is filled, as shares of its own.
const HEIGHTS: [f32; 3] = [0.2, 0.5, 0.8];

/// An object in one view.
#[derive(Debug, Clone, PartialEq)]
pub struct CompletionSample {
    /// What was seen of each cell, row by row.
    pub seen: Vec<[f32; CHANNELS]>,
    /// Of each cell and slab, at how many of three heights the object fills it.
    pub filled: Vec<[u8; SLABS]>,
}

/// The objects of the `index`-th scene that is learned from; kinds of scenes take turns. Empty where the seed gives no scene.
pub fn completion_samples(index: u64) -> Vec<CompletionSample> {
    let mut samples = Vec::new();
    VIEWS.show(FIRST_SEED + index, index, |truth, view| {
        let seen = SeenScene::of(&view.observed, &view.world_from_camera);
        let Ok(grids) = Belief::completion_grids(&seen, &BeliefSettings::default()) else { return };
        let of_objects = truth.objects.iter().filter_map(|object| {
            let told = grids.get(&object.id).filter(|told| told.points >= MIN_POINTS)?;
            let solid = PlacedParts::new(&object.shape.parts, &object.world_from_object)?;
            Some(CompletionSample { seen: told.cells.clone(), filled: filled(&told.grid, &solid) })
        });
        samples.extend(of_objects);
    });
    samples
}

/// Of each cell and slab of a grid, at how many of three heights a solid fills it.
fn filled(grid: &Grid, solid: &PlacedParts) -> Vec<[u8; SLABS]> {
    let at = |index: usize, slab: usize| {
        let middle = grid.place(slab, index / SIDE, index % SIDE);
        HEIGHTS.iter().filter(|share| solid.contains(&(middle + Vector3::z() * ((*share - 0.5) * grid.slab_m)))).count() as u8
    };
    (0..SIDE * SIDE).map(|index| std::array::from_fn(|slab| at(index, slab))).collect()
}

#[cfg(test)]
mod tests {
    use repose_networks::completion::OF_SLAB;

    use super::*;

    #[test]
    fn what_was_seen_of_an_object_is_filled_and_what_the_camera_looked_through_is_not() {
        let samples: Vec<CompletionSample> = (0..3).flat_map(completion_samples).collect();
        assert!(samples.len() > 5, "{}", samples.len());
        // Of a slab: points, how far behind it something was read, whose that is (its own, another's, furniture's), and whether the rules fill it.
        let [mut with_points, mut looked_through] = [(0u32, 0u32); 2];
        for (seen, filled) in samples.iter().flat_map(|s| s.seen.iter().zip(&s.filled)) {
            for (slab, filled) in seen[..OF_SLAB * SLABS].chunks_exact(OF_SLAB).zip(filled) {
                let is_filled = u32::from(*filled > 0);
                if slab[0] > 0.5 {
                    with_points = (with_points.0 + is_filled, with_points.1 + 1);
                } else if slab[1] >= 1.0 {
                    looked_through = (looked_through.0 + is_filled, looked_through.1 + 1);
                }
            }
        }
        assert!(with_points.1 > 300 && with_points.0 * 10 > with_points.1 * 5, "{with_points:?}");
        assert!(looked_through.1 > 300 && looked_through.0 * 20 < looked_through.1, "{looked_through:?}");
    }
}
