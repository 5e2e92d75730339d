//! What cameras are called in the metrics: a bounded number of names, because every name is a series that is kept for good.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

/// Stands for the cameras that came when there were enough names.
const OTHER_CAMERAS: &str = "other";

/// The cameras that have a name of their own.
#[derive(Debug)]
pub struct CameraNames {
    most: usize,
    names: Mutex<BTreeSet<String>>,
}

impl CameraNames {
    /// Names for the first `most` cameras.
    pub fn new(most: usize) -> Self {
        Self { most, names: Mutex::default() }
    }

    /// What a camera is called.
    pub fn of(&self, camera: &str) -> String {
        let mut names = self.names.lock().unwrap_or_else(PoisonError::into_inner);
        if !names.contains(camera) {
            if names.len() >= self.most {
                return OTHER_CAMERAS.to_owned();
            }
            names.insert(camera.to_owned());
        }
        camera.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_cameras_keep_their_names_and_the_rest_share_one() {
        let names = CameraNames::new(2);
        let called = ["front", "wrist", "side", "front", "back"].map(|camera| names.of(camera));
        assert_eq!(called, ["front", "wrist", "other", "front", "other"]);
    }
}
