//! Shards that the network which completes shapes is trained on, by `scripts/train_completion.py`.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use repose_dataset::{Split, write_whole};
use repose_evaluation::scenes::completion_samples::{CompletionSample, FIRST_SEED, completion_samples};
use repose_networks::completion::{CHANNELS, OF_OBJECT, SIDE, SLABS};
use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, TensorView};

use crate::failure::Failure;
use crate::progress::Progress;
use crate::values::check_scenes;

/// Scenes whose objects are in one shard.
const SCENES_PER_SHARD: u64 = 60;
/// Numbers of a cell that differ from cell to cell; the others are the object's.
const OF_CELL: usize = CHANNELS - OF_OBJECT;

/// Writes the shards that are missing; how many objects are in them.
pub fn write_completion(folder: &Path, first: u64, scenes: u64) -> Result<usize, Failure> {
    check_scenes(Split::Train, FIRST_SEED.saturating_add(first), scenes)?;
    let bad = |path: &Path, e: &dyn std::fmt::Display| Failure::bad_input("completion", format!("{}: {e}", path.display()));
    std::fs::create_dir_all(folder).map_err(|e| bad(folder, &e))?;
    let bar = Progress::new(scenes, "scenes");
    let mut objects = 0;
    for start in (first..first + scenes).step_by(SCENES_PER_SHARD as usize) {
        let end = (start + SCENES_PER_SHARD).min(first + scenes);
        let path = folder.join(format!("{}{end:07}.safetensors", name_from(start)));
        let shorter = match others_from(folder, start).map_err(|e| bad(folder, &e))? {
            there if there.iter().any(|there| *there >= path) => None,
            shorter => Some(shorter),
        };
        if let Some(shorter) = shorter {
            let samples: Vec<CompletionSample> = (start..end).into_par_iter().flat_map_iter(completion_samples).collect();
            objects += samples.len();
            let shard = shard_of(&samples).map_err(Failure::other)?;
            write_whole(&path, &shard).map_err(|e| bad(&path, &e))?;
            // The objects of a short last shard are in the longer one, too.
            shorter.iter().try_for_each(|shorter| std::fs::remove_file(shorter).map_err(|e| bad(shorter, &e)))?;
        }
        bar.set(end - first);
    }
    bar.finish();
    Ok(objects)
}

/// How the names of the shards begin whose first scene is that one.
fn name_from(start: u64) -> String {
    format!("completion-{start:07}-")
}

/// The shards of a folder whose first scene is that one: one of fewer scenes has the lesser name.
fn others_from(folder: &Path, start: u64) -> std::io::Result<Vec<PathBuf>> {
    let mut shards = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let is_whole = Path::new(&entry.file_name()).extension().is_some_and(|kind| kind == "safetensors");
        if is_whole && entry.file_name().to_string_lossy().starts_with(&name_from(start)) {
            shards.push(entry.path());
        }
    }
    Ok(shards)
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
    fn a_longer_run_replaces_a_short_last_shard_and_keeps_whole_ones() {
        let folder = tempfile::tempdir().unwrap();
        let names = || {
            let mut names: Vec<String> =
                std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
            names.sort();
            names
        };
        let written = |scenes: u64| write_completion(folder.path(), 60, scenes).unwrap();
        assert!(written(1) > 0);
        assert_eq!(names(), ["completion-0000060-0000061.safetensors"]);
        assert_eq!(written(1), 0, "it is there");
        assert!(written(2) > 0);
        assert_eq!(names(), ["completion-0000060-0000062.safetensors"]);
        assert_eq!(written(1), 0, "what is asked for is in the longer one");
        let shard = std::fs::read(folder.path().join(&names()[0])).unwrap();
        let shard = safetensors::SafeTensors::deserialize(&shard).unwrap();
        let [cells, objects, filled] = ["cells", "objects", "filled"].map(|name| shard.tensor(name).unwrap().shape().to_vec());
        assert_eq!(
            (&cells[1..], &objects[1..], &filled[1..]),
            ([SIDE, SIDE, OF_CELL].as_slice(), [OF_OBJECT].as_slice(), [SIDE, SIDE, SLABS].as_slice())
        );
        assert!(cells[0] > 0 && cells[0] == objects[0] && cells[0] == filled[0]);
        let filled = shard.tensor("filled").unwrap().data().to_vec();
        assert!(filled.iter().all(|thirds| *thirds <= 3) && filled.contains(&3) && filled.contains(&0));
    }
}
