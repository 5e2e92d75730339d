//! What is wrong with each camera's frames, so that the log says it as it begins and as it ends. A camera that is covered for a weekend, with somebody
//! looking through it, would otherwise fill the log with the same line several times a second.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use repose_proto::{CallError, ErrorCode};

/// The code and the field of an error: what else is said of a frame, as the number of its readings, is another with each.
type Fault = (ErrorCode, Option<String>);

/// Why the newest frame of each camera gave no scene.
#[derive(Debug, Default)]
pub struct CameraFaults(Mutex<BTreeMap<String, Fault>>);

impl CameraFaults {
    fn of_cameras(&self) -> MutexGuard<'_, BTreeMap<String, Fault>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A frame gave no scene; whether the one before it did, or failed for another reason. `camera` is one of a bounded number of names.
    pub fn begins(&self, camera: String, error: &CallError) -> bool {
        let fault = (error.code, error.field.clone());
        self.of_cameras().insert(camera, fault.clone()).is_none_or(|before| before != fault)
    }

    /// A frame gave a scene; whether the one before it gave none.
    pub fn ends(&self, camera: &str) -> bool {
        self.of_cameras().remove(camera).is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_said_as_it_begins_and_ends_and_not_with_every_frame() {
        let faults = CameraFaults::default();
        let begins = |camera: &str, field, readings: usize| {
            faults.begins(camera.to_owned(), &CallError::invalid(field, format!("none of {readings} readings is left")))
        };
        assert!(begins("front", "depth", 7) && !begins("front", "depth", 8) && begins("side", "depth", 8));
        assert!(begins("front", "labels", 8) && !begins("front", "labels", 9));
        assert!(faults.ends("front") && !faults.ends("front") && begins("front", "labels", 9));
    }
}
