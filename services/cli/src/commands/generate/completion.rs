//! Shards that the network which completes shapes is trained on, by `scripts/train_completion.py`.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use rayon::prelude::*;
use repose_dataset::{Split, write_whole};
use repose_evaluation::scenes::completion_samples::{CompletionSample, FIRST_SEED, completion_samples};
use repose_networks::completion::{CHANNELS, SIDE, SLABS};
use safetensors::tensor::{Dtype, View};

use crate::failure::Failure;
use crate::progress::Progress;
use crate::values::check_scenes;

/// Scenes whose objects are in one shard.
const SCENES_PER_SHARD: u64 = 60;
/// Numbers of a cell that differ from cell to cell; the others are the object's.
const OF_CELL: usize = CHANNELS - OF_OBJECT;
const OF_OBJECT: usize = 5;

/// Writes the shards that are missing; how many objects are in them.
pub fn write_completion(folder: &Path, first: u64, scenes: u64) -> Result<usize, Failure> {
    check_scenes(Split::Train, FIRST_SEED.saturating_add(first), scenes)?;
    let bad = |path: &Path, e: &dyn std::fmt::Display| Failure::bad_input("completion", format!("{}: {e}", path.display()));
    std::fs::create_dir_all(folder).map_err(|e| bad(folder, &e))?;
    let bar = Progress::new(scenes, "scenes");
    let mut objects = 0;
    for start in (first..first + scenes).step_by(SCENES_PER_SHARD as usize) {
        let end = (start + SCENES_PER_SHARD).min(first + scenes);
        let path = folder.join(format!("completion-{start:07}-{end:07}.safetensors"));
        if !path.exists() {
            let samples: Vec<CompletionSample> = (start..end).into_par_iter().flat_map_iter(completion_samples).collect();
            objects += samples.len();
            let shard = safetensors::serialize(tensors_of(&samples), None::<HashMap<String, String>>).map_err(Failure::other)?;
            write_whole(&path, &shard).map_err(|e| bad(&path, &e))?;
        }
        bar.set(end - first);
    }
    bar.finish();
    Ok(objects)
}

/// Some numbers of every object of a shard.
struct Numbers {
    kind: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl View for Numbers {
    fn dtype(&self) -> Dtype {
        self.kind
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }

    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

/// `cells` (what was seen of each, in steps of 1/127), `objects` (what is known of each object as a whole) and `filled` (thirds of each cell's slabs).
fn tensors_of(samples: &[CompletionSample]) -> Vec<(&'static str, Numbers)> {
    let count = samples.len();
    let in_steps = |value: &f32| (value * 127.0).round() as i8 as u8;
    let cells = samples.iter().flat_map(|s| s.seen.iter().flat_map(|cell| cell[..OF_CELL].iter().map(in_steps))).collect();
    let objects = samples.iter().flat_map(|s| s.seen[0][OF_CELL..].iter().flat_map(|value| value.to_le_bytes())).collect();
    let filled = samples.iter().flat_map(|s| s.filled.as_flattened().iter().copied()).collect();
    let grid = |depth: usize| vec![count, SIDE, SIDE, depth];
    vec![
        ("cells", Numbers { kind: Dtype::I8, shape: grid(OF_CELL), bytes: cells }),
        ("objects", Numbers { kind: Dtype::F32, shape: vec![count, OF_OBJECT], bytes: objects }),
        ("filled", Numbers { kind: Dtype::U8, shape: grid(SLABS), bytes: filled }),
    ]
}
