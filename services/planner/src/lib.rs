//! The planner: where can an object be set down so that a goal holds and it stays?
//!
//! The domain is pure and synchronous: [`plan()`] searches on a [`Prepared`] scene (Algorithm 1 of the paper, `search`), asking learned
//! models through the [`Models`] port, or none for the `geometric` variant. `settings` says what each variant is made of.
//! Around it is the service ([`run`]): it fetches scenes from perception, searches on its own threads, and asks inference for scores.

pub mod answers;
pub mod boosted_trees;
pub mod cached_scene;
pub mod candidate;
pub mod columns;
pub mod config;
pub mod constraints;
pub mod cost;
pub mod endpoints;
pub mod footing;
pub mod judge;
pub mod judged;
pub mod mixture;
pub mod models;
pub mod modes;
pub mod obstruction;
pub mod plan;
pub mod prepared;
pub mod proposals;
pub mod query;
pub mod ranking;
pub mod remote_models;
pub mod rules;
pub mod scene_settings;
pub mod search;
pub mod settings;
pub mod shape;
pub mod stability;
pub mod standing;
pub mod surrogate;
pub mod unseen;
pub mod view;
pub mod worker;

#[cfg(test)]
mod learned_tests;
#[cfg(test)]
mod plan_tests;
#[cfg(test)]
pub(crate) mod synthetic;

use std::sync::Arc;

use repose_proto::Service;
use repose_runtime::{RuntimeError, Session, Shutdown};

pub use config::PlannerConfig;
pub use models::{Models, NoModels};
pub use plan::{Report, Step, plan, plan_with_report};
pub use prepared::Prepared;
pub use search::Stop;
use stability::Stability;

/// Runs a planner worker until `shutdown`, then drains it.
///
/// # Errors
/// When the configuration names a file that is none, and when the network or the operating system refuses.
pub async fn run(session: Session, config: PlannerConfig, shutdown: Shutdown) -> Result<(), RuntimeError> {
    let stability = Arc::new(stability_of(&config)?);
    let worker = Arc::new(worker::Worker::start(&config)?);
    let perception = session.caller(Service::Perception).await?;
    let inference = session.caller(Service::Inference).await?;
    let endpoints = Arc::new(endpoints::Endpoints::new(worker, perception, inference, stability, &config));
    session.serve(Service::Planner, endpoints, shutdown).await
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
