//! The service's configuration, section `[inference]`.

use std::path::PathBuf;

use serde::Deserialize;

/// Configuration of an inference worker. Unknown fields are refused.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InferenceConfig {
    /// A weights file in place of the ones that come with the program.
    pub weights: Option<PathBuf>,
    /// Threads that score; 0 takes every core. Results do not depend on it.
    pub threads: usize,
    /// Requests that may wait; the next is refused at once. Raising it lets callers wait longer instead.
    pub queue_capacity: usize,
    /// Requests whose candidates are scored together. Raising it helps many small requests and delays the first of them.
    pub max_batch: usize,
    /// Candidates that such requests may have together; a request with more is scored alone. Raising it helps many small requests, and whoever
    /// comes next waits longer: 400 take two cores about a second by the paper's discriminator, and a third of that by the outcome network.
    pub max_batch_candidates: usize,
    /// How long a request waits for others to be scored with, milliseconds; 0 scores what waits already. Raising it fills batches when many
    /// ask, and makes every lone request later by as much.
    pub max_wait_ms: u64,
    /// How often the weights file is looked at, milliseconds: when it has changed, the new weights are loaded, tried, and served from then on
    /// without a restart. 0 never looks.
    pub weights_check_ms: u64,
    /// Most scenes held. Raising it lets more scenes be planned on without being sent again, at tens of MB each.
    pub scenes: usize,
    /// Most bytes of those scenes, roughly. The least recently used go first.
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
    /// The threads to use.
    pub fn actual_threads(&self) -> usize {
        match self.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
        }
    }
}
