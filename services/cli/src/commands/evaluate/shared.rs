//! What the tables of `repose evaluate` share: their arguments, an engine for many threads, scenes of a user's meshes.

use std::path::{Path, PathBuf};

use clap::Args;
use repose_dataset::Split;
use repose_evaluation::report::final_runs::{check_was_run, claim, ledger};
use repose_evaluation::report::own_commit::own_commit;
use repose_evaluation::report::written::{FileError, can_write};
use repose_inference::Engine;
use repose_simulator::objects::{MeshLibrary, MeshSettings, ObjectSource};
use repose_simulator::scene::SceneSettings;
use serde_json::Value;

use crate::embedded::engine;
use crate::failure::{CommandResult, Failure};
use crate::values::{parse_table_split, threads};

/// What every table of the networks and the planner is told.
#[derive(Debug, Args)]
pub struct TableArgs {
    /// The split: validation; test (a second validation set by now); or final, for published figures: each block of it is run once, in a clean
    /// checkout by the program that cargo built of it, and recorded in services/evaluation/record/final.jsonl.
    #[arg(long, default_value = "validation", value_parser = parse_table_split)]
    pub split: Split,
    /// The block of `final`. Default: the next one, or the one that an interrupted run of the same code and settings had started. With `--split
    /// validation`, in place of its own scenes, those of a block that was run before: they are validation scenes since then.
    #[arg(long, value_name = "N")]
    pub block: Option<u64>,
    /// A weights file. Default: the program's own weights.
    #[arg(long, value_name = "FILE")]
    pub weights: Option<PathBuf>,
    /// Threads. Default: one per core. The table does not depend on it.
    #[arg(long)]
    pub threads: Option<usize>,
}

impl TableArgs {
    /// The first scene, counted from the split's first seed: the block's, which is written down here when it begins.
    pub fn first(&self, table: &str, made_with: &Value) -> Result<SceneRange, Failure> {
        self.first_by(&ledger(), table, made_with)
    }

    /// The same by the ledger in a file.
    fn first_by(&self, ledger: &Path, table: &str, made_with: &Value) -> Result<SceneRange, Failure> {
        let commit = own_commit(ledger);
        let refused = |e| Failure::bad_input("block", e);
        let block = match (self.split, self.block) {
            (Split::Final, asked) => claim(ledger, table, asked, &commit, made_with).map_err(refused)?,
            (Split::Validation, Some(block)) => check_was_run(ledger, table, block).map(|()| block).map_err(refused)?,
            (_, Some(_)) => {
                return Err(Failure::bad_input("block", "`test` has no blocks, `final` has, and `validation` those of it that were run"));
            }
            (split, None) => return Ok(SceneRange { split, seeds_of: split, first: 0, block: None, commit }),
        };
        Ok(SceneRange { split: self.split, seeds_of: Split::Final, first: block * Split::BLOCK, block: Some(block), commit })
    }

    /// The networks, one thread a request: the tables spread scenes over the cores.
    pub fn engine(&self) -> Result<Engine, Failure> {
        engine(self.weights.clone())
    }

    /// The threads to use.
    pub fn threads(&self) -> usize {
        threads(self.threads)
    }
}

/// The range of scenes that a table is made from.
#[derive(Debug, Clone)]
pub struct SceneRange {
    /// Their split: validation also for those of a block of `final` that was run before.
    pub split: Split,
    /// The split among whose seeds theirs are.
    pub seeds_of: Split,
    /// The first of them, counted from that split's first seed.
    pub first: u64,
    /// The block of `final`.
    pub block: Option<u64>,
    /// The commit of the code that makes the table; `unknown` where the program is not of the checkout that it runs in.
    pub commit: String,
}

impl SceneRange {
    /// What a report says of them beside `made_with`.
    pub fn named(&self, made_with: &Value) -> Value {
        let mut named = made_with.clone();
        (named["split"], named["block"], named["commit"]) = (self.split.name().into(), self.block.into(), self.commit.clone().into());
        named
    }
}

/// Refuses parts of a table beyond its last slot: they would be of other slots' seeds, and further on of those of the next block of `final`, which
/// would have been looked at before it is run.
pub fn check_slots(first: u64, count: usize, slots: u64) -> CommandResult {
    if first.checked_add(count as u64).is_some_and(|end| end <= slots) {
        return Ok(());
    }
    Err(Failure::bad_input("first", format!("a table has at most {slots} of each kind, too few for {count} from number {first} on")))
}

/// Refuses a folder to which the report of a table cannot be written: after hours of making it that would be too late to say.
pub fn can_report(folder: Option<&Path>, table: &str) -> CommandResult {
    folder.map_or(Ok(()), |folder| can_write(&folder.join(format!("{table}.json")))).map_err(Failure::from)
}

/// Tells of a table whether or not its files could be written: a disk that fills up takes the files, and not what came of hours.
pub fn told(written: Result<(), FileError>, tell: impl FnOnce() -> CommandResult) -> CommandResult {
    tell()?;
    written.map_err(|failure| {
        tracing::error!(%failure, "a file of this table is missing");
        Failure::NotAchieved
    })
}

/// The name of a folder of meshes, as reports have it: where it lies says nothing about them.
pub fn folder_name(folder: Option<&Path>) -> Option<String> {
    Some(folder?.file_name()?.to_string_lossy().into_owned())
}

/// Makes scenes of a folder's meshes only.
pub fn only_meshes(scene: &mut SceneSettings, folder: &Path) -> CommandResult {
    let library = MeshLibrary::load(folder, &MeshSettings::default()).map_err(|e| Failure::bad_input("objects", e))?;
    scene.arrange.source = ObjectSource::meshes(library);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_told_of_though_its_report_cannot_be_written() {
        let mut is_told = false;
        let ended = told(Err(FileError::new(Path::new("relations.json"), "no space left on device")), || {
            is_told = true;
            Ok(())
        });
        assert!(is_told && ended.is_err_and(|failed| failed.exit_code() == 1));
    }

    #[test]
    fn only_final_and_validation_have_blocks() {
        let folder = tempfile::tempdir().expect("a folder");
        let ledger = folder.path().join("final.jsonl");
        claim(&ledger, "planner", None, "a commit", &Value::Null).expect("block 0");
        let first = |split: Split, block: Option<u64>, table: &str| {
            TableArgs { split, block, weights: None, threads: None }.first_by(&ledger, table, &Value::Null)
        };
        for (split, block, table) in [(Split::Test, 0, "planner"), (Split::Validation, 1, "planner"), (Split::Validation, 0, "relations")] {
            let refused = first(split, Some(block), table).expect_err("no such block");
            assert_eq!(
                (refused.exit_code(), refused.error().and_then(|e| e.field.as_deref())),
                (2, Some("block")),
                "{split:?} {block} {table}"
            );
        }
        let whole = first(Split::Validation, None, "planner").unwrap_or_else(|e| panic!("{e:?}"));
        assert_eq!((whole.seeds_of, whole.first, whole.block), (Split::Validation, 0, None));
        let of_block = first(Split::Validation, Some(0), "planner").unwrap_or_else(|e| panic!("{e:?}"));
        assert_eq!((of_block.seeds_of, of_block.first), (Split::Final, 0));
        let named = of_block.named(&serde_json::json!({}));
        assert_eq!((named["split"].as_str(), named["block"].as_u64()), (Some("validation"), Some(0)));
    }
}
