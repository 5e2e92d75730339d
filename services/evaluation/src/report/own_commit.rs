//! The commit of the program that runs: what its figures are of.

use std::path::Path;
use std::process::{Command, Stdio};

/// What a commit that files differ from ends in.
pub const DIRTY: &str = "-dirty";
/// The commit of a program of which nobody knows what it was built from.
pub const UNKNOWN: &str = "unknown";

/// The commit of this program: the one that is checked out in the working directory, if the program was built from that checkout as it is now. It
/// ends in [`DIRTY`] where files other than `ledger`, from which nothing is built, differ from the commit, and is [`UNKNOWN`] where the program was
/// built from other files, or where it cannot be told from which.
pub fn own_commit(ledger: &Path) -> String {
    let here = Path::new(".");
    let (Some(head), Some(top)) = (git(here, &["rev-parse", "HEAD"]), git(here, &["rev-parse", "--show-toplevel"])) else {
        return UNKNOWN.to_owned();
    };
    // What is checked out says nothing of a program that was built before it was, or somewhere else.
    let is_of_checkout = std::env::current_exe().and_then(|program| is_built_from(&program, Path::new(&top)));
    if !is_of_checkout.unwrap_or(false) {
        return UNKNOWN.to_owned();
    }
    format!("{head}{}", if differs(here, ledger) { DIRTY } else { "" })
}

/// Whether files of a checkout differ from its commit. The ledger does as soon as a run has begun.
fn differs(checkout: &Path, ledger: &Path) -> bool {
    let without_ledger = format!(":(top,exclude){}", ledger.display());
    let changes = git(checkout, &["status", "--porcelain", "--untracked-files=no", "--", ":/", &without_ledger]);
    changes.is_none_or(|changes| !changes.is_empty())
}

/// What git says in a folder; none where it cannot, or is not there.
fn git(folder: &Path, arguments: &[&str]) -> Option<String> {
    let mut command = Command::new("git");
    // Within a hook these name another checkout than the folder's.
    for variable in ["GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"] {
        command.env_remove(variable);
    }
    let said = command.current_dir(folder).args(arguments).stderr(Stdio::null()).output().ok()?;
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

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::path::PathBuf;
    use std::time::{Duration, UNIX_EPOCH};

    use super::*;

    #[test]
    fn a_run_that_is_written_down_does_not_make_the_code_another() {
        let checkout = tempfile::tempdir().expect("a folder");
        let [ledger, code] = ["final.jsonl", "code.rs"].map(|name| checkout.path().join(name));
        [&ledger, &code].into_iter().for_each(|file| std::fs::write(file, "\n").expect("written"));
        let author = ["-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false"];
        let commit = [&author[..], &["commit", "--quiet", "--message", "first"]].concat();
        for arguments in [&["init", "--quiet"][..], &["add", "--all"], &commit[..]] {
            // Where git is not at hand, no block is claimed either.
            let Some(_) = git(checkout.path(), arguments) else { return };
        }
        let is_other = |checkout: &Path| differs(checkout, Path::new("final.jsonl"));
        assert!(!is_other(checkout.path()));
        std::fs::write(&ledger, "{}\n").expect("written");
        assert!(!is_other(checkout.path()), "an interrupted run goes on");
        std::fs::write(&code, "other\n").expect("written");
        assert!(is_other(checkout.path()));
        assert!(is_other(&checkout.path().join("no/such/folder")), "nobody knows");
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
            file.set_modified(UNIX_EPOCH + Duration::from_secs(after_s)).expect("its time is set");
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
}
