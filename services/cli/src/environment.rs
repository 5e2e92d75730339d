//! The environment variables that Repose reads: a misspelt one is an error, as a misspelt field of a configuration file is.

use repose_runtime::{RuntimeConfig, SECTIONS};

use crate::failure::Failure;
use crate::services::ServiceConfigs;

/// What begins the names of all of them.
const PREFIX: &str = "REPOSE_";
/// Variables that are no setting of a section.
const PLAIN: [&str; 6] = ["REPOSE_CONNECT", "REPOSE_LISTEN", "REPOSE_CELL", "REPOSE_LOG", "REPOSE_LOG_FORMAT", "REPOSE_DATA"];

/// Refuses settings that no section has, and warns of other variables that nothing reads: an orchestrator may have set them for a service
/// of its own that is called repose.
pub fn check() -> Result<(), Failure> {
    let names = std::env::vars_os().filter_map(|(name, _)| name.into_string().ok());
    let names: Vec<String> = names.filter(|name| name.starts_with(PREFIX)).collect();
    let (settings, others): (Vec<&String>, Vec<&String>) = names.iter().partition(|name| name.contains("__"));
    for name in others.into_iter().filter(|name| !PLAIN.contains(&name.as_str())) {
        tracing::warn!("nothing reads the variable {name}; those that are read are {}, and {PREFIX}SECTION__FIELD", PLAIN.join(", "));
    }
    settings.iter().try_for_each(|name| has_section(name).map_err(|why| Failure::bad_input(name, why)))?;
    if !settings.is_empty() {
        // Every section refuses fields that it does not have. Whether values are good is judged where they are used, with those of a file.
        RuntimeConfig::read(None)?;
        ServiceConfigs::read(None)?;
    }
    Ok(())
}

/// Whether a variable names a section that there is; if not, which there are.
fn has_section(name: &str) -> Result<(), String> {
    let section = name.strip_prefix(PREFIX).and_then(|rest| rest.split_once("__")).map_or("", |(section, _)| section);
    if SECTIONS.iter().any(|known| known.to_uppercase() == section) {
        return Ok(());
    }
    let sections = SECTIONS.map(|section| format!("{PREFIX}{}__…", section.to_uppercase())).join(", ");
    Err(format!("there is no section {:?}; settings are {sections}", section.to_lowercase()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misspelt_section_is_told_which_there_are() {
        assert_eq!(has_section("REPOSE_PLANNER__ROBOT"), Ok(()));
        assert!(has_section("REPOSE_PLANER__ROBOT").is_err_and(|why| why.contains("\"planer\"") && why.contains("REPOSE_PLANNER__")));
    }
}
