//! Shards that the network which completes shapes is trained on, by `scripts/train_completion.py`.

use std::collections::HashMap;
use std::path::Path;

use repose_evaluation::scenes::completion_samples::{CompletionSample, FIRST_SEED, completion_samples};
use repose_networks::completion::{CHANNELS, OF_OBJECT, SIDE, SLABS};
use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, TensorView};

use super::shards::{ShardPlan, Shards};
use crate::commands::train::made_with::of_beliefs;
use crate::failure::Failure;

/// The network that is trained on the shards, by its name among what comes with the program; their names begin with it.
const COMPLETION: &str = "completion";
/// Numbers of a cell that differ from cell to cell; the others are the object's.
const OF_CELL: usize = CHANNELS - OF_OBJECT;

/// What is to be made in a folder for so many scenes from one on.
pub fn plan_completion(folder: &Path, first: u64, scenes: u64) -> Result<ShardPlan, Failure> {
    // The network is told of shapes that the rules complete, which stand on feet that are learned.
    let shards = Shards { name: COMPLETION, first_seed: FIRST_SEED, made_with: of_beliefs(&[COMPLETION]) };
    shards.plan(folder, first, scenes)
}

/// Writes the shards that are missing; how many objects are in them.
pub fn write_completion(plan: &ShardPlan) -> Result<usize, Failure> {
    plan.write(completion_samples, shard_of)
}

/// The bytes of a shard: `cells` (what was seen of each, in steps of 1/127), `objects` (what is known of each object as a whole) and `filled` (thirds of each
/// cell's slabs).
fn shard_of(samples: &[CompletionSample], metadata: HashMap<String, String>) -> Result<Vec<u8>, SafeTensorError> {
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
    safetensors::serialize(tensors, Some(metadata))
}

#[cfg(test)]
mod tests {
    use safetensors::SafeTensors;

    use super::*;

    #[test]
    fn a_shard_has_what_was_seen_of_each_object_and_what_it_fills() {
        let folder = tempfile::tempdir().unwrap();
        let objects = write_completion(&plan_completion(folder.path(), 60, 1).unwrap()).unwrap();
        let bytes = std::fs::read(folder.path().join("completion-0000060-0000061.safetensors")).unwrap();
        let shard = SafeTensors::deserialize(&bytes).unwrap();
        let shapes = ["cells", "objects", "filled"].map(|name| shard.tensor(name).unwrap().shape().to_vec());
        assert_eq!(shapes, [vec![objects, SIDE, SIDE, OF_CELL], vec![objects, OF_OBJECT], vec![objects, SIDE, SIDE, SLABS]]);
        let filled = shard.tensor("filled").unwrap().data().to_vec();
        assert!(objects > 0 && filled.iter().all(|thirds| *thirds <= 3) && filled.contains(&3) && filled.contains(&0));
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        assert_eq!(header.metadata().as_ref().unwrap()["made_with"], of_beliefs(&[COMPLETION]));
        assert_ne!(of_beliefs(&[COMPLETION]), of_beliefs(&[]), "what is trained on the shards is left out");
    }
}
