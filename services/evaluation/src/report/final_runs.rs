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

use crate::report::written::FileError;

/// One run, a line of the ledger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FinalRun {
    /// Which table: `planner`, `relations`, `discriminator`.
    pub table: String,
    /// The block of the split.
    pub block: u64,
    /// The commit of the code that ran, as [`commit`] says it.
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
        "the commit of this program is not known: a run of `final` names the code that made it, so build it in a checkout, and run what cargo has \
         built (target/release/repose, with its list repose.d beside it) there, with git at hand"
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
    let runs: Result<Vec<FinalRun>, FileError> =
        text.lines().map(|line| serde_json::from_str(line).map_err(|e| FileError::new(ledger, e))).collect();
    let runs: Vec<FinalRun> = runs?.into_iter().filter(|run| run.table == table).collect();
    let next = runs.iter().map(|run| run.block + 1).max().unwrap_or(0);
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
    writeln!(file, "{line}").map_err(failed)?;
    Ok(block)
}

/// What a commit that files differ from ends in.
const DIRTY: &str = "-dirty";
/// The commit of a program of which nobody knows what it was built from.
const UNKNOWN: &str = "unknown";

/// The commit of this program: the one that is checked out in the working directory, where the program was built from that checkout as it is now;
/// with `-dirty` where files differ from it, and `unknown` where the program is of other files, or nobody can tell of which.
pub fn commit() -> String {
    let here = Path::new(".");
    let (Some(head), Some(top)) = (git(here, &["rev-parse", "HEAD"]), git(here, &["rev-parse", "--show-toplevel"])) else {
        return UNKNOWN.to_owned();
    };
    // What is checked out says nothing of a program that was built before it was, or somewhere else.
    let is_of_checkout = std::env::current_exe().and_then(|program| is_built_from(&program, Path::new(&top)));
    if !is_of_checkout.unwrap_or(false) {
        return UNKNOWN.to_owned();
    }
    format!("{head}{}", if differs(here) { DIRTY } else { "" })
}

/// Whether files of a checkout differ from its commit. The ledger does as soon as a run has begun, and nothing is built from it.
fn differs(checkout: &Path) -> bool {
    let without_ledger = format!(":(top,exclude){LEDGER}");
    let changes = git(checkout, &["status", "--porcelain", "--untracked-files=no", "--", ":/", &without_ledger]);
    changes.is_none_or(|changes| !changes.is_empty())
}

/// What git says in a folder; none where it cannot, or is not there.
fn git(folder: &Path, arguments: &[&str]) -> Option<String> {
    let mut command = std::process::Command::new("git");
    // Within a hook these name another checkout than the folder's.
    for variable in ["GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"] {
        command.env_remove(variable);
    }
    let said = command.current_dir(folder).args(arguments).stderr(std::process::Stdio::null()).output().ok()?;
    said.status.success().then(|| String::from_utf8_lossy(&said.stdout).trim().to_owned())
}

/// Whether a program was built from files of a checkout that have stayed as they were. Cargo lists what it has built a program from beside it, in
/// `repose.d` for `repose`, and goes by the times of the same files to tell whether it has to be built again.
///
/// # Errors
/// When there is no such list, or a file in it is not there.
fn is_built_from(program: &Path, checkout: &Path) -> std::io::Result<bool> {
    let list = std::fs::read_to_string(program.with_extension("d"))?;
    let (built, checkout) = (std::fs::metadata(program)?.modified()?, checkout.canonicalize()?);
    let (_, files) = list.lines().next().and_then(|line| line.split_once(": ")).unwrap_or_default();
    // A space in a name stands behind a backslash; no name has a zero.
    let files = files.replace("\\ ", "\0");
    let mut count = 0;
    for file in files.split(' ').filter(|file| !file.is_empty()) {
        let file = checkout.join(file.replace('\0', " ")).canonicalize()?;
        if !file.starts_with(&checkout) || file.metadata()?.modified()? > built {
            return Ok(false);
        }
        count += 1;
    }
    Ok(count > 0)
}

/// Where the ledger lies in a checkout.
const LEDGER: &str = "services/evaluation/record/final.jsonl";

/// The ledger in a checkout, seen from its top folder.
pub fn ledger() -> PathBuf {
    PathBuf::from(LEDGER)
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
        let dirty = claim(&ledger, "planner", None, "c3-dirty", &new).expect_err("what made it has no name").to_string();
        assert!(dirty.contains("c3") && dirty.contains("commit first"), "{dirty}");
    }

    #[test]
    fn a_run_that_is_written_down_does_not_make_the_code_another() {
        let checkout = tempfile::tempdir().expect("a folder");
        let ledger = checkout.path().join(LEDGER);
        std::fs::create_dir_all(ledger.parent().expect("a folder")).expect("made");
        let code = checkout.path().join("code.rs");
        [&ledger, &code].into_iter().for_each(|file| std::fs::write(file, "\n").expect("written"));
        let author = ["-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false"];
        let commit = [&author[..], &["commit", "--quiet", "--message", "first"]].concat();
        for arguments in [&["init", "--quiet"][..], &["add", "--all"], &commit[..]] {
            // Where git is not at hand, no block is claimed either.
            let Some(_) = git(checkout.path(), arguments) else { return };
        }
        assert!(!differs(checkout.path()));
        std::fs::write(&ledger, "{}\n").expect("written");
        assert!(!differs(checkout.path()), "an interrupted run goes on");
        std::fs::write(&code, "other\n").expect("written");
        assert!(differs(checkout.path()));
        assert!(differs(&checkout.path().join("no/such/folder")), "nobody knows");
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
    fn a_program_is_of_a_checkout_while_what_it_was_built_from_stays_as_it_was() {
        let folder = tempfile::tempdir().expect("a folder");
        let [checkout, elsewhere] = ["check out", "elsewhere"].map(|name| folder.path().join(name));
        let program = folder.path().join("target").join("repose");
        let sources = [checkout.join("src/main.rs"), checkout.join("src/lib.rs")];
        for file in sources.iter().chain([&program, &elsewhere.join("lib.rs")]) {
            std::fs::create_dir_all(file.parent().expect("a folder")).expect("made");
            std::fs::write(file, "").expect("written");
        }
        let is_of = |checkout: &Path| is_built_from(&program, checkout).ok();
        assert_eq!(is_of(&checkout), None, "nobody knows what it was built from");
        let list = |files: &[PathBuf]| {
            let files: Vec<String> = files.iter().map(|file| file.display().to_string().replace(' ', "\\ ")).collect();
            std::fs::write(program.with_extension("d"), format!("{}: {}\n", program.display(), files.join(" "))).expect("written");
        };
        list(&[]);
        assert_eq!(is_of(&checkout), Some(false));
        list(&sources);
        let written_at = |file: &Path, after_s: u64| {
            let file = File::options().write(true).open(file).expect("a file");
            file.set_modified(UNIX_EPOCH + std::time::Duration::from_secs(after_s)).expect("its time is set");
        };
        written_at(&program, 2000);
        sources.iter().for_each(|source| written_at(source, 1000));
        assert_eq!((is_of(&checkout), is_of(&elsewhere)), (Some(true), Some(false)));
        written_at(&sources[1], 3000);
        assert_eq!(is_of(&checkout), Some(false), "another commit was checked out since");
        written_at(&sources[1], 1000);
        list(&[sources[0].clone(), elsewhere.join("lib.rs")]);
        assert_eq!(is_of(&checkout), Some(false), "it was built somewhere else");
        list(&[sources[0].clone(), checkout.join("src/gone.rs")]);
        assert_eq!(is_of(&checkout), None);
    }

    #[test]
    fn a_damaged_ledger_is_an_error() {
        let folder = tempfile::tempdir().expect("a folder");
        let ledger = folder.path().join("final.jsonl");
        std::fs::write(&ledger, "{}\n").expect("written");
        assert!(claim(&ledger, "planner", None, "c", &json!({})).is_err_and(|e| e.to_string().contains("final.jsonl")));
    }
}
