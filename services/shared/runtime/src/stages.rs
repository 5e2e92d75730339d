//! How long each stage of a call took, for the reply that ends it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Milliseconds by stage of one call; clones share them.
#[derive(Debug, Clone, Default)]
pub struct Stages(Arc<Mutex<BTreeMap<String, f64>>>);

impl Stages {
    /// Adds to the time of a stage, milliseconds.
    pub fn add(&self, name: &str, ms: f64) {
        let mut stages = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *stages.entry(name.to_owned()).or_insert(0.0) += ms;
    }

    /// What was counted so far, which starts anew.
    pub(crate) fn take(&self) -> BTreeMap<String, f64> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
