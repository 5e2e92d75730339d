//! Shards of objects that networks are trained on in Python: one file for some scenes each, whole ones kept.
//!
//! Each says what its objects were seen with, as one hash. A folder with shards that were made with something else is refused: a network that learned from
//! both would be right for neither.

use std::cmp::Reverse;
use std::collections::HashMap;
use std::fmt::Display;
use std::fs::File;
use std::io::{BufReader, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use repose_dataset::{Split, write_whole};
use safetensors::SafeTensorError;
use serde::Deserialize;

use crate::failure::Failure;
use crate::progress::Progress;
use crate::values::SceneNumbers;

/// Scenes whose objects are in one shard. Whole ones begin at its multiples: so those of runs that begin anywhere fit together.
const SCENES_PER_SHARD: u64 = 60;
/// The field of a shard's metadata that says what it was made with.
const MADE_WITH: &str = "made_with";

/// What the shards of one network are of.
#[derive(Debug, Clone)]
pub struct Shards {
    /// What their names begin with, and the option that names their folder.
    pub name: &'static str,
    /// The seed of the first scene.
    pub first_seed: u64,
    /// A hash of everything learned that their objects are seen with.
    pub made_with: String,
}

/// Shards that a folder has and will have. Nothing stands in the way of making those that are missing.
#[derive(Debug)]
pub struct ShardPlan {
    /// The folder.
    pub folder: PathBuf,
    shards: Shards,
    /// The scenes of the shards that are there.
    there: Vec<Range<u64>>,
    /// The scenes of those that will be.
    wanted: Vec<Range<u64>>,
}

impl Shards {
    /// What is to be made for so many scenes from one on to be in a folder. Refused are scenes that there are not, shards that were made with something else, and
    /// scenes that would be in two.
    pub fn plan(self, folder: &Path, first: u64, scenes: u64) -> Result<ShardPlan, Failure> {
        SceneNumbers { split: Split::Train, before: self.first_seed, count_option: "scenes" }.check(first, scenes)?;
        std::fs::create_dir_all(folder).map_err(|e| self.bad(folder, &e))?;
        let there = self.there(folder).map_err(|e| self.bad(folder, &e))?;
        there.iter().try_for_each(|scenes| self.check_made_with(&folder.join(self.name_of(scenes))))?;
        let end = first + scenes;
        let of_block = |block: u64| first.max(block * SCENES_PER_SHARD)..end.min((block + 1) * SCENES_PER_SHARD);
        let asked = (first / SCENES_PER_SHARD..end.div_ceil(SCENES_PER_SHARD)).map(of_block);
        let wanted = widest(there.iter().cloned().chain(asked)).map_err(|both| {
            let [one, other] = both.map(|scenes| self.name_of(&scenes));
            self.bad(folder, &format!("{one} and {other} would have scenes in common: ask for others, or give another folder"))
        })?;
        Ok(ShardPlan { folder: folder.to_owned(), shards: self, there, wanted })
    }

    /// The scenes of the shards of a folder. Other files are left alone.
    fn there(&self, folder: &Path) -> std::io::Result<Vec<Range<u64>>> {
        let mut there = Vec::new();
        for entry in std::fs::read_dir(folder)? {
            there.extend(entry?.file_name().to_str().and_then(|name| self.scenes_of(name)));
        }
        Ok(there)
    }

    /// The name of the shard of some scenes.
    fn name_of(&self, scenes: &Range<u64>) -> String {
        format!("{}-{:07}-{:07}.safetensors", self.name, scenes.start, scenes.end)
    }

    /// The scenes of the shard of that name; none where it is no shard's.
    fn scenes_of(&self, name: &str) -> Option<Range<u64>> {
        let numbers = name.strip_prefix(self.name)?.strip_prefix('-')?.strip_suffix(".safetensors")?;
        let (start, end) = numbers.split_once('-')?;
        let scenes: Range<u64> = start.parse().ok()?..end.parse().ok()?;
        (!scenes.is_empty() && self.name_of(&scenes) == name).then_some(scenes)
    }

    fn check_made_with(&self, shard: &Path) -> Result<(), Failure> {
        let theirs = match made_with(shard).map_err(|e| self.bad(shard, &e))? {
            Some(theirs) if theirs == self.made_with => return Ok(()),
            Some(theirs) => format!("it was made with {theirs}"),
            None => "it does not say what it was made with".to_owned(),
        };
        let (own, option) = (&self.made_with, self.name);
        let expected = format!("expected {own}, a hash of the trees and networks that come with the program");
        Err(self.bad(shard, &format!("{theirs}, {expected}: give another folder as --{option}")))
    }

    fn bad(&self, path: &Path, e: &dyn Display) -> Failure {
        Failure::bad_input(self.name, format!("{}: {e}", path.display()))
    }
}

impl ShardPlan {
    /// Writes the shards that are missing; how many objects are in them.
    pub fn write<T: Send>(
        &self,
        objects_of: impl Fn(u64) -> Vec<T> + Sync,
        shard_of: impl Fn(&[T], HashMap<String, String>) -> Result<Vec<u8>, SafeTensorError>,
    ) -> Result<usize, Failure> {
        let is_missing = |scenes: &&Range<u64>| !self.there.contains(scenes);
        let bar = Progress::new(self.wanted.iter().filter(is_missing).map(|scenes| scenes.end - scenes.start).sum(), "scenes");
        let mut count = 0;
        for scenes in &self.wanted {
            let path = self.path_of(scenes);
            if is_missing(&scenes) {
                let objects: Vec<T> = scenes.clone().into_par_iter().flat_map_iter(&objects_of).collect();
                count += objects.len();
                let metadata = HashMap::from([(MADE_WITH.to_owned(), self.shards.made_with.clone())]);
                let shard = shard_of(&objects, metadata).map_err(Failure::other)?;
                write_whole(&path, &shard).map_err(|e| self.shards.bad(&path, &e))?;
                bar.add(scenes.end - scenes.start);
            }
            // The objects of a shorter one are in this one, too.
            for shorter in self.there.iter().filter(|there| *there != scenes && is_within(there, scenes)).map(|there| self.path_of(there)) {
                std::fs::remove_file(&shorter).map_err(|e| self.shards.bad(&shorter, &e))?;
            }
        }
        bar.finish();
        Ok(count)
    }

    fn path_of(&self, scenes: &Range<u64>) -> PathBuf {
        self.folder.join(self.shards.name_of(scenes))
    }
}

/// Whether all of some scenes are among others.
fn is_within(scenes: &Range<u64>, others: &Range<u64>) -> bool {
    others.start <= scenes.start && scenes.end <= others.end
}

/// The shards that are not within another, by their scenes; two that have only some of their scenes in common are an error.
fn widest(shards: impl Iterator<Item = Range<u64>>) -> Result<Vec<Range<u64>>, [Range<u64>; 2]> {
    let mut shards: Vec<Range<u64>> = shards.collect();
    // Of those that begin together the widest is first.
    shards.sort_by_key(|scenes| (scenes.start, Reverse(scenes.end)));
    let mut widest: Vec<Range<u64>> = Vec::new();
    for scenes in shards {
        match widest.last() {
            Some(before) if is_within(&scenes, before) => {}
            Some(before) if scenes.start < before.end => return Err([before.clone(), scenes]),
            _ => widest.push(scenes),
        }
    }
    Ok(widest)
}

/// What a shard says that it was made with. Only its header is read: there are gigabytes of shards.
fn made_with(shard: &Path) -> std::io::Result<Option<String>> {
    #[derive(Deserialize)]
    struct Header {
        #[serde(rename = "__metadata__", default)]
        metadata: HashMap<String, String>,
    }
    let mut file = File::open(shard)?;
    let mut length = [0; size_of::<u64>()];
    file.read_exact(&mut length)?;
    let mut header: Header = serde_json::from_reader(BufReader::new(file.take(u64::from_le_bytes(length))))?;
    Ok(header.metadata.remove(MADE_WITH))
}

#[cfg(test)]
mod tests {
    use safetensors::tensor::{Dtype, TensorView};

    use super::*;

    fn shards(made_with: &str) -> Shards {
        Shards { name: "things", first_seed: 0, made_with: made_with.to_owned() }
    }

    /// A shard of scenes' numbers.
    fn shard_of(scenes: &[u64], metadata: HashMap<String, String>) -> Result<Vec<u8>, SafeTensorError> {
        let bytes: Vec<u8> = scenes.iter().flat_map(|scene| scene.to_le_bytes()).collect();
        safetensors::serialize([("scenes", TensorView::new(Dtype::U64, vec![scenes.len()], &bytes)?)], Some(metadata))
    }

    /// How many objects are added for so many scenes from one on: each scene has two. What is refused is told by its field and the message.
    fn written(folder: &Path, first: u64, scenes: u64) -> Result<usize, (String, String)> {
        let plan = shards("own").plan(folder, first, scenes);
        plan.and_then(|plan| plan.write(|scene| vec![scene, scene], shard_of)).map_err(|refused| {
            assert_eq!(refused.exit_code(), 2);
            let error = refused.into_error();
            (error.field.unwrap_or_default(), error.message)
        })
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// The scenes of all objects in a folder of shards.
    fn scenes_in(folder: &Path) -> Vec<u64> {
        let of_shard = |name: &String| {
            let bytes = std::fs::read(folder.join(name)).unwrap();
            let shard = safetensors::SafeTensors::deserialize(&bytes).unwrap();
            let scenes = shard.tensor("scenes").unwrap().data();
            scenes.chunks_exact(8).map(|bytes| u64::from_le_bytes(bytes.try_into().unwrap())).collect::<Vec<_>>()
        };
        names(folder).iter().flat_map(of_shard).collect()
    }

    #[test]
    fn a_longer_run_replaces_a_short_last_shard_and_keeps_whole_ones() {
        let folder = tempfile::tempdir().unwrap();
        let written = |scenes| written(folder.path(), 60, scenes);
        assert_eq!(written(1), Ok(2));
        assert_eq!(names(folder.path()), ["things-0000060-0000061.safetensors"]);
        assert_eq!(written(1), Ok(0), "it is there");
        assert_eq!(written(2), Ok(4));
        assert_eq!(names(folder.path()), ["things-0000060-0000062.safetensors"]);
        assert_eq!(written(1), Ok(0), "what is asked for is in the longer one");
        assert_eq!(scenes_in(folder.path()), [60, 60, 61, 61]);
        assert_eq!(written(61), Ok(122), "the next shard begins, and the first becomes whole");
        assert_eq!(names(folder.path()), ["things-0000060-0000120.safetensors", "things-0000120-0000121.safetensors"]);
    }

    #[test]
    fn a_short_shard_that_a_killed_run_left_beside_the_longer_one_goes() {
        let folder = tempfile::tempdir().unwrap();
        let short = folder.path().join("things-0000060-0000062.safetensors");
        written(folder.path(), 60, 2).unwrap();
        let bytes = std::fs::read(&short).unwrap();
        written(folder.path(), 60, 60).unwrap();
        std::fs::write(&short, bytes).unwrap();
        assert_eq!(written(folder.path(), 60, 2), Ok(0));
        assert_eq!(names(folder.path()), ["things-0000060-0000120.safetensors"]);
    }

    #[test]
    fn the_longer_shard_is_told_by_its_number_and_not_by_its_name() {
        let folder = tempfile::tempdir().unwrap();
        written(folder.path(), 9_999_960, 10).unwrap();
        assert_eq!(written(folder.path(), 9_999_960, 60), Ok(120));
        assert_eq!(names(folder.path()), ["things-9999960-10000020.safetensors"]);
        assert_eq!(written(folder.path(), 9_999_960, 60), Ok(0));
    }

    #[test]
    fn files_that_are_named_like_no_shard_are_left_alone_and_stand_for_none() {
        let folder = tempfile::tempdir().unwrap();
        let others =
            ["things-0000060-backup", "things-0000060-0000120-copy", "things-60-120", "things-0000120-0000060", "others-0000060-0000120"];
        for name in others {
            std::fs::write(folder.path().join(name).with_extension("safetensors"), "of somebody").unwrap();
        }
        assert_eq!(written(folder.path(), 60, 60), Ok(120));
        assert_eq!(names(folder.path()).len(), others.len() + 1);
    }

    #[test]
    fn no_scene_is_in_two_shards_wherever_runs_begin() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(written(folder.path(), 3600, 60), Ok(120));
        assert_eq!(written(folder.path(), 3659, 2), Ok(2), "the first of them is there");
        assert_eq!(written(folder.path(), 3700, 10), Ok(20));
        let before = names(folder.path());
        let (field, message) = written(folder.path(), 3705, 60).unwrap_err();
        let both = ["things-0003700-0003710", "things-0003705-0003720", "another folder"];
        assert!(field == "things" && both.iter().all(|told| message.contains(told)), "{field}: {message}");
        assert_eq!(names(folder.path()), before, "nothing was made");
        written(folder.path(), 3590, 200).unwrap();
        let scenes = scenes_in(folder.path());
        assert!(scenes.chunks_exact(2).map(|object| object[0]).eq(3590..3790), "{scenes:?}");
    }

    #[test]
    fn a_folder_of_shards_that_others_made_or_nobody_knows_who_is_refused_before_any_is_made() {
        let folder = tempfile::tempdir().unwrap();
        let theirs = |metadata: HashMap<String, String>| {
            std::fs::write(folder.path().join("things-0000000-0000001.safetensors"), shard_of(&[0], metadata).unwrap()).unwrap();
            let refused = written(folder.path(), 60, 1).unwrap_err();
            assert_eq!(names(folder.path()).len(), 1);
            refused
        };
        let (field, message) = theirs(HashMap::from([(MADE_WITH.to_owned(), "old".to_owned())]));
        let told = ["things-0000000-0000001", "made with old", "expected own", "another folder as --things"];
        assert!(field == "things" && told.iter().all(|told| message.contains(told)), "{field}: {message}");
        let (field, message) = theirs(HashMap::new());
        assert!(
            field == "things" && message.contains("does not say") && message.contains("another folder as --things"),
            "{field}: {message}"
        );
        std::fs::write(folder.path().join("things-0000000-0000001.safetensors"), "no shard").unwrap();
        assert!(written(folder.path(), 60, 1).is_err_and(|(_, message)| message.contains("things-0000000-0000001")));
    }

    #[test]
    fn more_scenes_than_there_are_are_blamed_on_the_option_that_asks_for_them() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |first, scenes| {
            let shards = Shards { first_seed: 950_000_000, ..shards("own") };
            let error = shards.plan(folder.path(), first, scenes).unwrap_err().into_error();
            (error.field.unwrap_or_default(), error.message)
        };
        let (field, message) = refused(0, 50_000_001);
        assert!(field == "scenes" && message.contains("50000000 scenes") && !message.contains("950000000"), "{field}: {message}");
        let (field, message) = refused(49_999_999, 2);
        assert!(field == "first" && message.contains("number 49999999 on"), "{field}: {message}");
    }
}
