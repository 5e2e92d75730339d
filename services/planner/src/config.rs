//! The service's configuration, section `[planner]`.

use std::path::PathBuf;

use repose_runtime::RuntimeError;
use serde::Deserialize;

use crate::learned::stability::Stability;

/// Configuration of a planner worker. Unknown fields are refused.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlannerConfig {
    /// A file of `repose train --network stability` in place of the one that comes with the program: to go with weights of one's own.
    pub stability: Option<PathBuf>,
    /// Threads that search; each has one request and waits while inference scores. Raising it keeps inference busier; results do not
    /// depend on it.
    pub threads: usize,
    /// Requests that may wait for a thread; the next is refused at once. Raising it lets callers wait longer instead.
    pub queue_capacity: usize,
    /// The most prepared scenes kept; the least recently used go first. Raising it saves preparing a scene again, at some 20 MB each.
    pub scenes: usize,
    /// How long perception may take to send a scene that is not here, milliseconds.
    pub scene_timeout_ms: u64,
    /// Time kept back from a request's deadline to send the answer, milliseconds. Raising it makes late searches end earlier, as
    /// `partial`; at 0 some end as `deadline_exceeded`.
    pub reply_reserve_ms: u64,
}

impl Default for PlannerConfig {
    fn default() -> Self {
        Self { stability: None, threads: 4, queue_capacity: 64, scenes: 8, scene_timeout_ms: 2000, reply_reserve_ms: 60 }
    }
}

/// The stability that the configuration names, or the one that comes with the program.
///
/// # Errors
/// [`RuntimeError::Config`] when the file cannot be read or is none.
pub fn stability_of(config: &PlannerConfig) -> Result<Stability, RuntimeError> {
    let Some(path) = &config.stability else { return Ok(Stability::embedded().clone()) };
    let bad = |e: &dyn std::fmt::Display| RuntimeError::Config {
        section: "planner".to_owned(),
        file: None,
        message: format!("stability: {}: {e}", path.display()),
    };
    let text = std::fs::read_to_string(path).map_err(|e| bad(&e))?;
    Stability::from_json(&text).map_err(|e| bad(&e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_left_out_have_their_defaults_and_unknown_ones_are_refused() {
        let config: PlannerConfig = serde_json::from_str(r#"{"threads": 2}"#).unwrap();
        assert_eq!(config, PlannerConfig { threads: 2, ..PlannerConfig::default() });
        assert!(serde_json::from_str::<PlannerConfig>(r#"{"thread": 2}"#).unwrap_err().to_string().contains("unknown field"));
    }

    #[test]
    fn a_stability_file_that_is_none_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("stability.json");
        let named = PlannerConfig { stability: Some(file.clone()), ..PlannerConfig::default() };
        let refused = |config: &PlannerConfig| stability_of(config).unwrap_err().to_string();
        assert!(refused(&named).contains("stability"), "a missing file");
        std::fs::write(&file, "{}").unwrap();
        assert!(refused(&named).contains("[planner]"), "another file");
        std::fs::write(&file, serde_json::to_string(Stability::embedded()).unwrap()).unwrap();
        assert_eq!(stability_of(&named).unwrap(), *Stability::embedded());
        assert_eq!(stability_of(&PlannerConfig::default()).unwrap(), *Stability::embedded());
    }
}
