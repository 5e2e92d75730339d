//! Files that are replaced at once.

use std::fs::File;
use std::io::Write;
use std::path::Path;

/// Writes a file beside its place and renames it, so that no reader meets half of one, and no interruption, not even a power cut, leaves
/// half of one. Makes its folder.
///
/// # Errors
/// The system's; the file that was there stays.
pub fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder)?;
    }
    // A name of its own, beside files that differ in their endings only and beside what another process writes to the same place.
    let mut beside = path.as_os_str().to_owned();
    beside.push(format!(".{}.tmp", std::process::id()));
    let written = write_through(Path::new(&beside), bytes).and_then(|()| std::fs::rename(&beside, path));
    if written.is_err() {
        // Part of a file is of use to nobody; that the rest could not be written is what the caller hears of.
        drop(std::fs::remove_file(&beside));
    }
    written
}

/// Writes a file and waits until the disk has it: the disk may learn of a new name before it has what is behind it.
fn write_through(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_and_nothing_is_left_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new").join("weights.bin");
        write_whole(&path, b"one").unwrap();
        write_whole(&path, b"two").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"two");
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
        assert!(write_whole(&path.join("below a file"), b"three").is_err());
    }

    #[test]
    fn what_another_process_has_begun_in_the_same_place_is_left_to_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("dataset.json");
        let others = folder.path().join("dataset.json.0.tmp");
        std::fs::write(&others, b"hal").unwrap();
        // Whatever the others call theirs: nothing but the file itself is replaced.
        std::fs::create_dir(folder.path().join("dataset.json.tmp")).unwrap();
        write_whole(&path, b"whole").unwrap();
        assert_eq!((std::fs::read(&path).unwrap(), std::fs::read(&others).unwrap()), (b"whole".to_vec(), b"hal".to_vec()));
    }

    #[test]
    fn what_cannot_be_put_in_its_place_is_not_left_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("taken");
        std::fs::create_dir(&path).unwrap();
        assert!(write_whole(&path, b"one").is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
