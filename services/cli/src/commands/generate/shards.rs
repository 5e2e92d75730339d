//! Shards of objects that networks are trained on in Python: one file for some scenes each, whole ones kept.

use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use repose_dataset::{Split, write_whole};
use safetensors::SafeTensorError;

use crate::failure::Failure;
use crate::progress::Progress;
use crate::values::check_scenes;

/// Scenes whose objects are in one shard.
const SCENES_PER_SHARD: u64 = 60;

/// What the shards of one network are of.
#[derive(Debug, Clone, Copy)]
pub struct Shards {
    /// What their names begin with, and what errors name.
    pub name: &'static str,
    /// The seed of the first scene.
    pub first_seed: u64,
}

impl Shards {
    /// Writes the shards of some scenes that are missing in a folder; how many objects are in them.
    pub fn write<T: Send>(
        self,
        folder: &Path,
        scenes: Range<u64>,
        objects_of: impl Fn(u64) -> Vec<T> + Sync,
        shard_of: impl Fn(&[T]) -> Result<Vec<u8>, SafeTensorError>,
    ) -> Result<usize, Failure> {
        let bad = |path: &Path, e: &dyn std::fmt::Display| Failure::bad_input(self.name, format!("{}: {e}", path.display()));
        std::fs::create_dir_all(folder).map_err(|e| bad(folder, &e))?;
        let bar = Progress::new(scenes.end - scenes.start, "scenes");
        let mut count = 0;
        for start in scenes.clone().step_by(SCENES_PER_SHARD as usize) {
            let end = (start + SCENES_PER_SHARD).min(scenes.end);
            let path = folder.join(format!("{}{end:07}.safetensors", self.name_from(start)));
            let shorter = match self.others_from(folder, start).map_err(|e| bad(folder, &e))? {
                there if there.iter().any(|there| *there >= path) => None,
                shorter => Some(shorter),
            };
            if let Some(shorter) = shorter {
                let objects: Vec<T> = (start..end).into_par_iter().flat_map_iter(&objects_of).collect();
                count += objects.len();
                let shard = shard_of(&objects).map_err(Failure::other)?;
                write_whole(&path, &shard).map_err(|e| bad(&path, &e))?;
                // The objects of a short last shard are in the longer one, too.
                shorter.iter().try_for_each(|shorter| std::fs::remove_file(shorter).map_err(|e| bad(shorter, &e)))?;
            }
            bar.set(end - scenes.start);
        }
        bar.finish();
        Ok(count)
    }

    /// So many scenes from one on, if there are as many.
    pub fn scenes(self, first: u64, scenes: u64) -> Result<Range<u64>, Failure> {
        check_scenes(Split::Train, self.first_seed.saturating_add(first), scenes)?;
        Ok(first..first + scenes)
    }

    /// How the names of the shards begin whose first scene is that one.
    fn name_from(self, start: u64) -> String {
        format!("{}-{start:07}-", self.name)
    }

    /// The shards of a folder whose first scene is that one: one of fewer scenes has the lesser name.
    fn others_from(self, folder: &Path, start: u64) -> std::io::Result<Vec<PathBuf>> {
        let mut shards = Vec::new();
        for entry in std::fs::read_dir(folder)? {
            let entry = entry?;
            let is_whole = Path::new(&entry.file_name()).extension().is_some_and(|kind| kind == "safetensors");
            if is_whole && entry.file_name().to_string_lossy().starts_with(&self.name_from(start)) {
                shards.push(entry.path());
            }
        }
        Ok(shards)
    }
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
        let shards = Shards { name: "things", first_seed: 0 };
        let bytes_of = |scenes: &[u64]| Ok(scenes.iter().map(|scene| *scene as u8).collect());
        let written = |scenes: u64| shards.write(folder.path(), 60..60 + scenes, |scene| vec![scene, scene], bytes_of).unwrap();
        assert_eq!(written(1), 2);
        assert_eq!(names(), ["things-0000060-0000061.safetensors"]);
        assert_eq!(written(1), 0, "it is there");
        assert_eq!(written(2), 4);
        assert_eq!(names(), ["things-0000060-0000062.safetensors"]);
        assert_eq!(written(1), 0, "what is asked for is in the longer one");
        assert_eq!(std::fs::read(folder.path().join(&names()[0])).unwrap(), [60, 60, 61, 61]);
        assert_eq!(written(61), 122, "the next shard begins, and the first becomes whole");
        assert_eq!(names(), ["things-0000060-0000120.safetensors", "things-0000120-0000121.safetensors"]);
    }
}
