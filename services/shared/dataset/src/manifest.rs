//! `dataset.json`: how a folder's shards were made, so that shards made in another way never join them.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{whole::write_whole, writer::FORMAT};

/// The file's name.
pub const MANIFEST_FILE: &str = "dataset.json";

/// What all shards of a folder have in common.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The shards' format.
    pub format: String,
    /// The program that made them, with its version.
    pub generator: String,
    /// What they were made with, as the generator says it.
    pub settings: serde_json::Value,
}

/// Why shards cannot go into a folder.
#[derive(Debug, thiserror::Error)]
pub enum ManifestError {
    /// The file system refused.
    #[error("{path}: {source}")]
    Io {
        /// What was being read or written.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is no manifest.
    #[error("{path}: {reason}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The folder's shards, or a file of outcomes, were made in another way.
    #[error("{path}: the existing data was made with other settings; use another folder, or the same settings. {}", summary(differences))]
    Differs {
        /// The folder's manifest, or the file of outcomes.
        path: PathBuf,
        /// Each field that differs: where it is, what it is there, what was asked for.
        differences: Vec<String>,
    },
}

impl Manifest {
    /// A manifest of this version of the format.
    pub fn new(generator: &str, settings: serde_json::Value) -> Self {
        Self { format: FORMAT.to_owned(), generator: generator.to_owned(), settings }
    }

    /// The folder's manifest, if it has one.
    ///
    /// # Errors
    /// [`ManifestError`] when there is one that cannot be read.
    pub fn read(folder: &Path) -> Result<Option<Self>, ManifestError> {
        let path = folder.join(MANIFEST_FILE);
        match std::fs::read(&path) {
            Ok(bytes) => match serde_json::from_slice(&bytes) {
                Ok(manifest) => Ok(Some(manifest)),
                Err(e) => Err(ManifestError::Malformed { path, reason: e.to_string() }),
            },
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(ManifestError::Io { path, source }),
        }
    }

    /// Makes the folder one of shards made this way (creating both it and its manifest if absent).
    ///
    /// # Errors
    /// [`ManifestError::Differs`] when it is one of shards made in another way.
    pub fn claim(&self, folder: &Path) -> Result<(), ManifestError> {
        let path = folder.join(MANIFEST_FILE);
        let io = |source| ManifestError::Io { path: path.clone(), source };
        let Some(there) = Self::read(folder)? else {
            let text = serde_json::to_string_pretty(self).map_err(|e| io(e.into()))?;
            return write_whole(&path, (text + "\n").as_bytes()).map_err(io);
        };
        let mut differences = Vec::new();
        for (field, here, asked) in [("format", &there.format, &self.format), ("generator", &there.generator, &self.generator)] {
            if here != asked {
                differences.push(format!("{field}: there {here:?}, now {asked:?}"));
            }
        }
        compare("settings", &there.settings, &self.settings, &mut differences);
        if differences.is_empty() { Ok(()) } else { Err(ManifestError::Differs { path, differences }) }
    }
}

/// Collects the leaves in which two documents differ.
pub(crate) fn compare(at: &str, there: &serde_json::Value, now: &serde_json::Value, differences: &mut Vec<String>) {
    use serde_json::Value::{Array, Null, Object};
    match (there, now) {
        (Object(there), Object(now)) => {
            let missing = now.keys().filter(|key| !there.contains_key(*key));
            for key in there.keys().chain(missing) {
                compare(&format!("{at}.{key}"), there.get(key).unwrap_or(&Null), now.get(key).unwrap_or(&Null), differences);
            }
        }
        (Array(there), Array(now)) if there.len() == now.len() => {
            for (k, (there, now)) in there.iter().zip(now).enumerate() {
                compare(&format!("{at}[{k}]"), there, now, differences);
            }
        }
        (Array(there), Array(now)) => {
            let only = |ours: &[serde_json::Value], theirs: &[serde_json::Value]| -> Vec<String> {
                ours.iter().filter(|value| !theirs.contains(value)).map(short).collect()
            };
            let (gone, new) = (only(there, now), only(now, there));
            differences.push(format!("{at}: only there [{}], only now [{}]", listed(&gone), listed(&new)));
        }
        _ if there != now => differences.push(format!("{at}: there {}, now {}", short(there), short(now))),
        _ => {}
    }
}

/// Differences that a message names; who wants all compares the two files.
const NAMED: usize = 4;

fn summary(differences: &[String]) -> String {
    let more = differences.len().saturating_sub(NAMED);
    let named = differences[..differences.len() - more].join("; ");
    if more == 0 { format!("Differs in {named}") } else { format!("Differs in {named}; and {more} more") }
}

fn listed(values: &[String]) -> String {
    let more = values.len().saturating_sub(NAMED);
    let named = values[..values.len() - more].join(", ");
    if more == 0 { named } else { format!("{named}, and {more} more") }
}

/// A value as one short piece of text.
fn short(value: &serde_json::Value) -> String {
    const MOST: usize = 60;
    let text = value.to_string();
    match text.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_folder_takes_more_of_the_same_and_refuses_others_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("new");
        let manifest = Manifest::new("test 1", json!({ "views": 5, "camera": { "width": 320, "sizes": [1, 2] } }));
        manifest.claim(&folder).unwrap();
        manifest.claim(&folder).unwrap();
        assert_eq!(Manifest::read(&folder).unwrap().as_ref(), Some(&manifest));
        let other = Manifest::new("test 2", json!({ "views": 5, "camera": { "width": 640, "sizes": [1, 3] }, "color": true }));
        let ManifestError::Differs { differences, .. } = other.claim(&folder).unwrap_err() else { panic!("refused for another reason") };
        let expected = [
            r#"generator: there "test 1", now "test 2""#,
            "settings.camera.sizes[1]: there 2, now 3",
            "settings.camera.width: there 320, now 640",
            "settings.color: there null, now true",
        ];
        assert_eq!(differences, expected);
    }

    #[test]
    fn a_message_names_a_few_short_differences() {
        let folder = tempfile::tempdir().unwrap();
        let scene: Vec<String> = (0..40).map(|k| format!("setting {k}: {}", "9".repeat(90))).collect();
        Manifest::new("test", json!({ "scene": scene, "views": 5 })).claim(folder.path()).unwrap();
        let error = Manifest::new("test", json!({ "scene": scene[1..], "views": 4 })).claim(folder.path()).unwrap_err().to_string();
        assert!(error.contains("only there [\"setting 0: 9") && error.contains("views: there 5, now 4"), "{error}");
        assert!(error.len() < 400, "{error}");
    }

    #[test]
    fn a_file_that_is_no_manifest_is_an_error_with_its_path() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(MANIFEST_FILE), "{\"format\": 3").unwrap();
        let error = Manifest::read(folder.path()).unwrap_err().to_string();
        assert!(error.contains(MANIFEST_FILE), "{error}");
    }
}
