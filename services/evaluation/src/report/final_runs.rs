//! The ledger of the `final` split: which block of its scenes was run when, by which code and weights.
//!
//! A figure that is published must come from scenes that nobody has looked at. So every block is run once for each table, its run is written
//! down when it begins, and a block that was run is a validation split from then on. An interrupted run goes on; anything else takes the
//! next block.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::report::own_commit::{DIRTY, UNKNOWN};
use crate::report::written::FileError;

/// One run, a line of the ledger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FinalRun {
    /// Which table: `planner`, `relations`, `discriminator`.
    pub table: String,
    /// The block of the split.
    pub block: u64,
    /// The commit of the code that ran, as [`own_commit`](crate::report::own_commit::own_commit) says it.
    pub commit: String,
    /// What the table was made with: weights, settings.
    pub made_with: Value,
    /// When it began, seconds since the Unix epoch.
    pub begun_s: u64,
}

/// Why a block cannot be run.
#[derive(Debug, thiserror::Error)]
pub enum FinalRunError {
    /// The ledger cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// It was run already, or one before it was not.
    #[error("block {asked} of `final` {why}; the next one for {table} is {next}")]
    Block {
        /// The block asked for.
        asked: u64,
        /// What is wrong with it.
        why: &'static str,
        /// The table.
        table: String,
        /// The block that may be run.
        next: u64,
    },
    /// The code is not the code of any commit.
    #[error("files differ from commit {0}: a run of `final` names the code that made it, so commit first")]
    Dirty(String),
    /// Nobody knows which code it is.
    #[error(
        "the commit of this program is not known, and a run of `final` names it: build the program in a git checkout, and run it there where cargo \
         has put it (target/release/repose, with repose.d beside it)"
    )]
    Unknown,
}

/// The block to run: the one asked for, or the next; writes it down. A run that was begun with the same code and settings goes on.
///
/// # Errors
/// [`FinalRunError`] when the block was run before, one before it was not, the code is not committed or not known, or the ledger cannot be kept.
pub fn claim(ledger: &Path, table: &str, asked: Option<u64>, commit: &str, made_with: &Value) -> Result<u64, FinalRunError> {
    if let Some(clean) = commit.strip_suffix(DIRTY) {
        return Err(FinalRunError::Dirty(clean.to_owned()));
    }
    // Any two codes that are not known would pass for the same one, and the second go on with a block that the first has looked at.
    if commit == UNKNOWN {
        return Err(FinalRunError::Unknown);
    }
    // Who claims at the same time waits, or would take the same block. The lock goes with the file.
    let failed = |e: std::io::Error| FileError::new(ledger, e);
    let mut file = File::options().read(true).append(true).create(true).open(ledger).map_err(failed)?;
    file.lock().map_err(failed)?;
    let mut text = String::new();
    file.read_to_string(&mut text).map_err(failed)?;
    let runs = runs_of(table, &text, ledger)?;
    let next = next_of(&runs);
    let goes_on = |run: &FinalRun| run.commit == commit && run.made_with == *made_with;
    // Without a block asked for, the last run goes on if it can.
    let block = asked.or_else(|| runs.last().filter(|run| goes_on(run)).map(|run| run.block)).unwrap_or(next);
    if runs.iter().any(|run| run.block == block && goes_on(run)) {
        return Ok(block);
    }
    if block != next {
        let why = if block < next { "was run before by other code or settings, and is a validation split now" } else { "is not the next" };
        return Err(FinalRunError::Block { asked: block, why, table: table.to_owned(), next });
    }
    let begun_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let run = FinalRun { table: table.to_owned(), block, commit: commit.to_owned(), made_with: made_with.clone(), begun_s };
    let line = serde_json::to_string(&run).map_err(|e| FileError::new(ledger, e))?;
    // An editor, or a disk that was full, may have left the last line without its end.
    let end = if text.is_empty() || text.ends_with('\n') { "" } else { "\n" };
    append(&mut file, &format!("{end}{line}\n")).map_err(failed)?;
    Ok(block)
}

/// Refuses a block that nothing was published from yet: to look at its scenes would spoil them for that.
///
/// # Errors
/// [`FinalRunError`] when the block was not run for the table, or the ledger cannot be read.
pub fn check_was_run(ledger: &Path, table: &str, block: u64) -> Result<(), FinalRunError> {
    let text = std::fs::read_to_string(ledger).map_err(|e| FileError::new(ledger, e))?;
    let runs = runs_of(table, &text, ledger)?;
    if runs.iter().any(|run| run.block == block) {
        return Ok(());
    }
    Err(FinalRunError::Block {
        asked: block,
        why: "was not run, and is no validation split yet",
        table: table.to_owned(),
        next: next_of(&runs),
    })
}

/// The runs of a table in the text of a ledger.
fn runs_of(table: &str, text: &str, ledger: &Path) -> Result<Vec<FinalRun>, FileError> {
    let runs: Result<Vec<FinalRun>, FileError> =
        text.lines().map(|line| serde_json::from_str(line).map_err(|e| FileError::new(ledger, e))).collect();
    Ok(runs?.into_iter().filter(|run| run.table == table).collect())
}

/// The block that is run next.
fn next_of(runs: &[FinalRun]) -> u64 {
    runs.iter().map(|run| run.block + 1).max().unwrap_or(0)
}

/// Adds to a file all of a text or nothing, and waits until the disk has it: a run whose line a power cut takes away would be run again.
fn append(file: &mut File, text: &str) -> std::io::Result<()> {
    let length = file.metadata()?.len();
    let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_data());
    if written.is_err() {
        // Half a line would damage the ledger; that the whole one could not be written is what the caller hears of.
        drop(file.set_len(length));
    }
    written
}

/// The ledger in a checkout, seen from its top folder.
pub fn ledger() -> PathBuf {
    PathBuf::from("services/evaluation/record/final.jsonl")
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_block_is_run_once_and_an_interrupted_run_goes_on() {
        let folder = tempfile::tempdir().expect("a folder");
        let ledger = folder.path().join("final.jsonl");
        let (old, new) = (json!({"weights_hash": "a"}), json!({"weights_hash": "b"}));
        assert_eq!(claim(&ledger, "planner", None, "c1", &old).expect("the first"), 0);
        assert_eq!(claim(&ledger, "planner", None, "c1", &old).expect("it goes on"), 0);
        assert_eq!(claim(&ledger, "relations", None, "c1", &old).expect("another table's first"), 0);
        assert_eq!(claim(&ledger, "planner", None, "c1", &new).expect("other weights take the next"), 1);
        assert_eq!(claim(&ledger, "planner", None, "c2", &new).expect("so does other code"), 2);
        let refused = |block| claim(&ledger, "planner", Some(block), "c3", &new).expect_err("not the next").to_string();
        assert!(refused(1).contains("validation split now") && refused(1).contains("planner is 3"), "{}", refused(1));
        assert!(refused(7).contains("is not the next"));
        assert_eq!(std::fs::read_to_string(&ledger).expect("a file").lines().count(), 4);
        assert!(check_was_run(&ledger, "planner", 2).is_ok(), "a block that was run may be looked at");
        let not_yet = [("planner", 3), ("relations", 1)]
            .map(|(table, block)| check_was_run(&ledger, table, block).expect_err("nor others").to_string());
        assert!(not_yet[0].contains("planner is 3") && not_yet[1].contains("relations is 1"), "{not_yet:?}");
        let dirty = claim(&ledger, "planner", None, "c3-dirty", &new).expect_err("what made it has no name").to_string();
        assert!(dirty.contains("c3") && dirty.contains("commit first"), "{dirty}");
    }

    #[test]
    fn two_that_claim_at_once_take_two_blocks() {
        let folder = tempfile::tempdir().expect("a folder");
        let ledger = folder.path().join("final.jsonl");
        const RUNS: usize = 8;
        let together = std::sync::Barrier::new(RUNS);
        let claimed = |k: usize| {
            together.wait();
            claim(&ledger, "planner", None, "c", &json!({"variants": [k]})).expect("a block")
        };
        let mut blocks: Vec<u64> = std::thread::scope(|scope| {
            let claimed = &claimed;
            let runs: Vec<_> = (0..RUNS).map(|k| scope.spawn(move || claimed(k))).collect();
            runs.into_iter().map(|run| run.join().expect("it ends")).collect()
        });
        blocks.sort_unstable();
        assert_eq!(blocks, (0..RUNS as u64).collect::<Vec<_>>());
    }

    #[test]
    fn code_of_no_known_commit_takes_no_block() {
        let folder = tempfile::tempdir().expect("a folder");
        let ledger = folder.path().join("final.jsonl");
        for asked in [None, Some(0)] {
            let refused = claim(&ledger, "planner", asked, UNKNOWN, &json!({})).expect_err("nobody knows what made it");
            assert!(matches!(refused, FinalRunError::Unknown), "{refused}");
        }
        assert!(!ledger.exists(), "no block is spent");
    }

    #[test]
    fn a_last_line_without_its_end_is_a_run_like_any_other() {
        let folder = tempfile::tempdir().expect("a folder");
        let ledger = folder.path().join("final.jsonl");
        claim(&ledger, "planner", None, "c", &json!({})).expect("the first");
        let text = std::fs::read_to_string(&ledger).expect("a file");
        std::fs::write(&ledger, text.trim_end()).expect("written");
        for block in 1..3 {
            let made_with = json!({"variants": [block]});
            assert_eq!(claim(&ledger, "planner", None, "c", &made_with).expect("the next"), block);
        }
    }

    #[test]
    fn a_damaged_ledger_is_an_error() {
        let folder = tempfile::tempdir().expect("a folder");
        let ledger = folder.path().join("final.jsonl");
        std::fs::write(&ledger, "{}\n").expect("written");
        assert!(claim(&ledger, "planner", None, "c", &json!({})).is_err_and(|e| e.to_string().contains("final.jsonl")));
    }
}
