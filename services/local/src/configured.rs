//! The services' sections of the configuration as they read them from the environment: `REPOSE_{SECTION}__{FIELD}`.

use repose_perception::{PerceptionConfig, Settings};
use repose_planner::PlannerConfig;
use repose_planner::config::Robots;
use repose_proto::CallError;
use repose_runtime::load_config;
use serde::de::DeserializeOwned;

/// A section, over its defaults.
///
/// # Errors
/// `invalid_argument` on `config` that names the field.
pub fn section<T: DeserializeOwned>(name: &str) -> Result<T, CallError> {
    load_config(name, None).map_err(refused)
}

/// How frames become scenes.
///
/// # Errors
/// As [`section`].
pub fn segmentation() -> Result<Settings, CallError> {
    let config: PerceptionConfig = section("perception")?;
    config.validate()?;
    Ok(config.segmentation)
}

/// Where the cell's robots stand.
///
/// # Errors
/// As [`section`].
pub fn robots() -> Result<Robots, CallError> {
    Robots::of(&section::<PlannerConfig>("planner")?).map_err(refused)
}

pub(crate) fn refused(error: impl std::fmt::Display) -> CallError {
    CallError::invalid("config", error.to_string())
}
