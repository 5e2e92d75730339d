//! The service's configuration, section `[inference]`.

use std::path::PathBuf;

use repose_runtime::{RuntimeError, check_counts};
use serde::Deserialize;

/// Configuration of an inference worker. Unknown fields are refused.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InferenceConfig {
    /// A weights file in place of the ones that come with the program.
    pub weights: Option<PathBuf>,
    /// Threads that score; 0 takes every core. Results do not depend on it.
    pub threads: usize,
    /// Requests that may wait; further ones are refused at once. Raising it lets callers wait longer instead.
    pub queue_capacity: usize,
    /// Requests whose candidates are scored together. Raising it helps many small requests and delays the first of them.
    pub max_batch: usize,
    /// Candidates that such requests may have together; a request with more is scored alone. Raising it helps many small requests, and later
    /// requests wait longer: 400 candidates take two cores about a second with the paper's discriminator, and a third of that with the outcome
    /// network (`services/shared/networks/benches/record/scoring.md`).
    pub max_batch_candidates: usize,
    /// How long a request waits for others to share a batch, milliseconds; 0 does not wait. Raising it fills batches under load, and delays
    /// every lone request by as much.
    pub max_wait_ms: u64,
    /// How often the weights file is checked, milliseconds: when it has changed, the new weights are loaded, tried, and served without a restart.
    /// 0 never checks.
    pub weights_check_ms: u64,
    /// Most scenes held. Raising it lets more scenes be used without being sent again, at tens of MB each.
    pub scenes: usize,
    /// Most bytes of those scenes, roughly. The least recently used are dropped first.
    pub scenes_bytes: usize,
}

impl Default for InferenceConfig {
    fn default() -> Self {
        Self {
            weights: None,
            threads: 0,
            queue_capacity: 64,
            max_batch: 16,
            max_batch_candidates: 400,
            max_wait_ms: 0,
            weights_check_ms: 1000,
            scenes: 16,
            scenes_bytes: 1 << 30,
        }
    }
}

impl InferenceConfig {
    /// Checks what the types cannot.
    ///
    /// # Errors
    /// [`RuntimeError::Config`] that names the field.
    pub fn validate(&self) -> Result<(), RuntimeError> {
        check_counts("inference", &[("queue_capacity", self.queue_capacity), ("max_batch", self.max_batch)])
    }

    /// The threads to use.
    pub fn actual_threads(&self) -> usize {
        match self.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_queue_without_places_is_refused_by_name() {
        assert!(InferenceConfig::default().validate().is_ok());
        let refused = InferenceConfig { queue_capacity: 0, ..InferenceConfig::default() }.validate().unwrap_err();
        assert!(refused.to_string().contains("queue_capacity"), "{refused}");
        assert!(InferenceConfig { max_batch: 0, ..InferenceConfig::default() }.validate().is_err());
    }
}
