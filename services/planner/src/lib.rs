//! The planner: where can an object be set down so that a goal holds and it stays?
//!
//! The domain is pure and synchronous: [`plan()`] searches on a [`PreparedScene`] (Algorithm 1 of the paper, `search`), asking learned
//! models through the [`PlacementModels`] port, or none for the `geometric` variant. `settings` says what each variant is made of.
//! Around it is the service ([`run`]): it fetches scenes from perception, searches on its own threads, and asks inference for scores.

pub mod answers;
pub mod belief;
pub mod checks;
pub mod config;
pub mod endpoints;
pub mod judge;
pub mod learned;
pub mod plan;
pub mod remote_models;
pub mod scene;
pub mod scene_cache;
pub mod search;
pub mod settings;
pub mod worker;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use repose_proto::Service;
use repose_runtime::{RuntimeError, Session, Shutdown};

pub use config::{PlannerConfig, stability_of};
pub use learned::models::{NoModels, PlacementModels};
pub use plan::{PlanReport, SearchStep, plan, plan_with_report};
pub use scene::prepared::PreparedScene;
pub use search::stop::StopReason;

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
