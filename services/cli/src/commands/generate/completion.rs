//! Shards that the network which completes shapes is trained on, by `scripts/train_completion.py`.

use std::collections::HashMap;
use std::path::Path;

use repose_evaluation::scenes::completion_samples::{CompletionSample, FIRST_SEED, completion_samples};
use repose_networks::completion::{CHANNELS, OF_OBJECT, SIDE, SLABS};
use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, TensorView};

use super::shards::Shards;
use crate::failure::Failure;

/// Numbers of a cell that differ from cell to cell; the others are the object's.
const OF_CELL: usize = CHANNELS - OF_OBJECT;

/// Writes the shards that are missing; how many objects are in them.
pub fn write_completion(folder: &Path, first: u64, scenes: u64) -> Result<usize, Failure> {
    let shards = Shards { name: "completion", first_seed: FIRST_SEED };
    shards.write(folder, shards.scenes(first, scenes)?, completion_samples, shard_of)
}

/// The bytes of a shard: `cells` (what was seen of each, in steps of 1/127), `objects` (what is known of each object as a whole) and `filled` (thirds of each
/// cell's slabs).
fn shard_of(samples: &[CompletionSample]) -> Result<Vec<u8>, SafeTensorError> {
    let count = samples.len();
    let in_steps = |value: &f32| (value * 127.0).round() as i8 as u8;
    let cells: Vec<u8> = samples.iter().flat_map(|s| s.seen.iter().flat_map(|cell| cell[..OF_CELL].iter().map(in_steps))).collect();
    let objects: Vec<u8> = samples.iter().flat_map(|s| s.seen[0][OF_CELL..].iter().flat_map(|value| value.to_le_bytes())).collect();
    let filled: Vec<u8> = samples.iter().flat_map(|s| s.filled.as_flattened().iter().copied()).collect();
    let grid = |depth: usize| vec![count, SIDE, SIDE, depth];
    let tensors = [
        ("cells", TensorView::new(Dtype::I8, grid(OF_CELL), &cells)?),
        ("objects", TensorView::new(Dtype::F32, vec![count, OF_OBJECT], &objects)?),
        ("filled", TensorView::new(Dtype::U8, grid(SLABS), &filled)?),
    ];
    safetensors::serialize(tensors, None::<HashMap<String, String>>)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shard_has_what_was_seen_of_each_object_and_what_it_fills() {
        let folder = tempfile::tempdir().unwrap();
        let objects = write_completion(folder.path(), 60, 1).unwrap();
        let shard = std::fs::read(folder.path().join("completion-0000060-0000061.safetensors")).unwrap();
        let shard = safetensors::SafeTensors::deserialize(&shard).unwrap();
        let shapes = ["cells", "objects", "filled"].map(|name| shard.tensor(name).unwrap().shape().to_vec());
        assert_eq!(shapes, [vec![objects, SIDE, SIDE, OF_CELL], vec![objects, OF_OBJECT], vec![objects, SIDE, SIDE, SLABS]]);
        let filled = shard.tensor("filled").unwrap().data().to_vec();
        assert!(objects > 0 && filled.iter().all(|thirds| *thirds <= 3) && filled.contains(&3) && filled.contains(&0));
    }
}
