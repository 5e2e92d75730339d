//! The records of `evaluate planner` on disk: one line a scene, appended as it ends, so that a table survives an interruption.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::report::written::FileError;
use crate::scenes::planner_scene::{SceneRecord, SceneSet};

/// The records of a table.
pub struct Records {
    /// All of them, in the order in which they ended.
    pub all: Vec<SceneRecord>,
    file: Option<(PathBuf, File)>,
}

impl Records {
    /// Those that a folder holds, if any; `head` says what they are of.
    ///
    /// # Errors
    /// When the folder cannot be written, or holds records of something else.
    pub fn open(folder: Option<&Path>, head: &Value) -> Result<Self, FileError> {
        let Some(folder) = folder else { return Ok(Self { all: Vec::new(), file: None }) };
        let path = folder.join("scenes.jsonl");
        let failed = |e: &dyn std::fmt::Display| FileError::new(&path, e);
        std::fs::create_dir_all(folder).map_err(|e| failed(&e))?;
        let mut all = Vec::new();
        let mut whole_bytes = 0;
        if path.exists() {
            let mut lines = BufReader::new(File::open(&path).map_err(|e| failed(&e))?);
            // As bytes: a line may have been cut off within a character.
            let mut line = Vec::new();
            while lines.read_until(b'\n', &mut line).map_err(|e| failed(&e))? > 0 && line.ends_with(b"\n") {
                if whole_bytes == 0 {
                    let there: Value = serde_json::from_slice(&line).map_err(|e| failed(&e))?;
                    if there != *head {
                        return Err(failed(&format!(
                            "holds scenes of other settings ({}); take another folder, or the same settings",
                            differences(&there, head)
                        )));
                    }
                } else {
                    all.push(serde_json::from_slice(&line).map_err(|e| failed(&e))?);
                }
                whole_bytes += line.len() as u64;
                line.clear();
            }
        }
        let mut file = File::options().create(true).append(true).open(&path).map_err(|e| failed(&e))?;
        // A line without its end was being written when the program was stopped: that scene is tried again.
        file.set_len(whole_bytes).map_err(|e| failed(&e))?;
        if whole_bytes == 0 {
            writeln!(file, "{head}").map_err(|e| failed(&e))?;
        }
        Ok(Self { all, file: Some((path, file)) })
    }

    /// Adds a record.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn add(&mut self, record: SceneRecord) -> Result<(), FileError> {
        if let Some((path, file)) = &mut self.file {
            let line = serde_json::to_string(&record).map_err(|e| FileError::new(path, e))?;
            writeln!(file, "{line}").map_err(|e| FileError::new(path, e))?;
        }
        self.all.push(record);
        Ok(())
    }

    /// The records of the given sets, in the order of sets and slots; then those of other sets.
    pub fn in_order(&self, sets: &[SceneSet]) -> Vec<SceneRecord> {
        let mut sorted = self.all.clone();
        let place = |r: &SceneRecord| sets.iter().position(|s| s.name == r.set).unwrap_or(sets.len());
        sorted.sort_by(|a, b| place(a).cmp(&place(b)).then_with(|| a.set.cmp(&b.set)).then(a.slot.cmp(&b.slot)));
        sorted
    }
}

/// Which settings differ, and what they are in each: `split: "validation" there, "test" here`.
fn differences(there: &Value, here: &Value) -> String {
    let keys: BTreeSet<&String> = [there, here].into_iter().filter_map(Value::as_object).flat_map(|settings| settings.keys()).collect();
    let differing = keys.into_iter().filter(|key| there.get(*key) != here.get(*key));
    differing.map(|key| format!("{key}: {} there, {} here", there[key], here[key])).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::planner_scene::ScriptTrial;
    use crate::scenes::problem::ProblemSettings;
    use repose_proto::{GoalTerm, Relation};
    use repose_simulator::scene::SceneKind;

    fn record(set: &str, slot: u64) -> SceneRecord {
        let goal = GoalTerm { relation: Relation::Behind, anchor: 2, holds: true };
        SceneRecord {
            set: set.to_owned(),
            slot,
            seed: slot,
            kind: SceneKind::Shelf,
            query: 1,
            goal,
            true_supports: 1,
            whole_based: true,
            stands_alone: true,
            true_refusals: Vec::new(),
            script: ScriptTrial { release: None },
            trials: Vec::new(),
        }
    }

    #[test]
    fn a_line_that_was_cut_off_is_written_again_and_other_settings_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let head = serde_json::json!({"split": "test"});
        let mut records = Records::open(Some(folder.path()), &head).unwrap_or_else(|e| panic!("{e:?}"));
        for slot in [1, 0] {
            records.add(record("a", slot)).unwrap_or_else(|e| panic!("{e:?}"));
        }
        drop(records);
        let path = folder.path().join("scenes.jsonl");
        let whole = std::fs::read(&path).expect("a file");
        // Within a character of two bytes.
        std::fs::write(&path, [whole, b"{\"set\": \"\xc3".to_vec()].concat()).expect("written");
        let mut again = Records::open(Some(folder.path()), &head).unwrap_or_else(|e| panic!("{e:?}"));
        again.add(record("b", 0)).unwrap_or_else(|e| panic!("{e:?}"));
        let set = SceneSet { name: "b".to_owned(), kinds: vec![SceneKind::Shelf], problem: ProblemSettings::default() };
        let order: Vec<(String, u64)> = again.in_order(&[set]).into_iter().map(|r| (r.set, r.slot)).collect();
        assert_eq!(order, [("b".to_owned(), 0), ("a".to_owned(), 0), ("a".to_owned(), 1)]);
        assert_eq!(std::fs::read_to_string(&path).expect("a file").lines().count(), 4);
        let refused =
            Records::open(Some(folder.path()), &serde_json::json!({"split": "validation"})).err().expect("other settings").to_string();
        assert!(refused.contains("split: \"test\" there, \"validation\" here"), "{refused}");
    }
}
