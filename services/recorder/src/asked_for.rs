//! The scenes that somebody asks about while a recording is made: which have been fetched, for which of its files, and which could not be.

use std::collections::{BTreeMap, BTreeSet};

use repose_proto::ErrorCode;

use crate::lost::LostMessages;

/// Ids of scenes that are remembered as fetched, and as lost; then all are forgotten and may be fetched again.
const REMEMBERED: usize = 4096;

/// What is known of the scenes that are asked for.
#[derive(Default)]
pub struct AskedFor {
    /// Scenes that were fetched already, or are being fetched, with the file that was open then.
    files: BTreeMap<String, usize>,
    /// Scenes that could not be fetched, and are counted as lost.
    missing: BTreeSet<String>,
    lost: LostMessages,
}

impl AskedFor {
    /// Nothing yet; scenes that do not come are counted in `lost`.
    pub fn counting(lost: LostMessages) -> Self {
        Self { lost, ..Self::default() }
    }

    /// Takes note that somebody asks about a scene while a file is open; which file was, where somebody has before.
    pub fn again(&mut self, scene_id: &str, file: usize) -> Option<usize> {
        if self.files.len() >= REMEMBERED {
            self.files.clear();
        }
        self.files.insert(scene_id.to_owned(), file)
    }

    /// Takes note that a scene has come: if it was lost before, it is not.
    pub fn came(&mut self, scene_id: &str) {
        if self.missing.remove(scene_id) {
            self.lost.found("scenes");
        }
    }

    /// Takes note that a scene could not be fetched: it is lost, and tried again when it is asked about next. One that nobody has is not lost here,
    /// and stays noted: whoever asked about it may have sent it along, and then it is in the recording with the call.
    pub fn failed(&mut self, scene_id: &str, code: ErrorCode) {
        if code == ErrorCode::NotFound {
            return;
        }
        self.files.remove(scene_id);
        if self.missing.len() >= REMEMBERED {
            self.missing.clear();
        }
        if self.missing.insert(scene_id.to_owned()) {
            self.lost.add("scenes", 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_is_fetched_again_for_each_file_in_which_somebody_asks_about_it() {
        let mut asked_for = AskedFor::default();
        let files = [0, 0, 0, 1, 1, 3];
        let fetched = files.map(|file| asked_for.again("one", file) != Some(file));
        assert_eq!(fetched, [true, false, false, true, false, true]);
        assert_eq!(asked_for.again("another", 3), None, "nobody has before");
    }

    #[test]
    fn a_scene_that_did_not_come_is_fetched_again_when_it_is_asked_about_next_and_one_that_nobody_has_is_not() {
        let mut asked_for = AskedFor::default();
        for (scene, code, next) in [("busy", ErrorCode::ResourceExhausted, None), ("forgotten", ErrorCode::NotFound, Some(0))] {
            asked_for.again(scene, 0);
            asked_for.failed(scene, code);
            assert_eq!(asked_for.again(scene, 0), next, "{scene}");
        }
    }

    #[test]
    fn a_scene_that_cannot_be_fetched_is_lost_until_it_comes_after_all() {
        let lost = LostMessages::default();
        let mut asked_for = AskedFor::counting(lost.clone());
        let counted = || lost.by_kind().get("scenes").copied();
        // Perception is away. That nobody has a scene is no loss: it may be in a call.
        for (scene, code) in [("one", ErrorCode::Unavailable), ("one", ErrorCode::DeadlineExceeded), ("two", ErrorCode::Unavailable)] {
            asked_for.failed(scene, code);
        }
        asked_for.failed("three", ErrorCode::NotFound);
        assert_eq!(counted(), Some(2));
        for scene in ["one", "one", "three", "two"] {
            asked_for.came(scene);
        }
        assert_eq!(counted(), None);
        (0..3 * REMEMBERED).for_each(|scene| asked_for.failed(&scene.to_string(), ErrorCode::Unavailable));
        assert!(counted() == Some(3 * REMEMBERED as u64) && asked_for.missing.len() <= REMEMBERED);
    }

    #[test]
    fn what_is_remembered_of_scenes_is_bounded() {
        let mut asked_for = AskedFor::default();
        for scene in 0..3 * REMEMBERED {
            asked_for.again(&scene.to_string(), 0);
        }
        assert!(asked_for.files.len() <= REMEMBERED);
    }
}
