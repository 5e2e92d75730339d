//! Inference: scenes held by id, and batched scoring of candidates with the learned prior, relation predictor and discriminator.
//!
//! The domain is synchronous: [`engine::Engine`] answers on [`held_scene::HeldScene`]s, in a service and in-process alike.
//! [`run`] is the service.

pub mod config;
pub mod endpoints;
pub mod engine;
pub mod held_scene;
pub mod mixture;
pub mod scoring;
pub mod weights_file;
pub mod worker;

use std::sync::Arc;

use repose_networks::Models;
use repose_proto::Service;
use repose_runtime::{RuntimeError, Session, Shutdown};

pub use config::InferenceConfig;
pub use engine::Engine;
pub use held_scene::HeldScene;

/// Why the service could not run.
#[derive(Debug, thiserror::Error)]
pub enum InferenceError {
    /// The weights file cannot be read.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: std::path::PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The weights do not fit the networks.
    #[error(transparent)]
    Weights(#[from] repose_networks::WeightsError),
    /// The networks gave no answer, or no numbers, when they were tried.
    #[error("trying the weights: {0}")]
    Trial(#[from] engine::TrialError),
    /// The network or the threads failed.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
}

/// The engine of a configuration, warm.
///
/// # Errors
/// [`InferenceError`] when the weights cannot be read or do not fit.
pub fn engine_of(config: &InferenceConfig) -> Result<Engine, InferenceError> {
    let models = match &config.weights {
        Some(path) => Models::load(&std::fs::read(path).map_err(|source| InferenceError::File { path: path.clone(), source })?)?,
        None => Models::embedded()?,
    };
    let engine = Engine::new(models, config.actual_threads());
    engine.warm_up()?;
    Ok(engine)
}

/// Serves until `shutdown`.
///
/// # Errors
/// [`InferenceError`].
pub async fn run(session: Session, config: InferenceConfig, shutdown: Shutdown) -> Result<(), InferenceError> {
    // Looked at before it is read: what replaces it meanwhile is then seen as new.
    let version = weights_file::Version::of(&config);
    let first = config.clone();
    let engine = tokio::task::spawn_blocking(move || engine_of(&first)).await;
    let engine =
        engine.map_err(|e| RuntimeError::System { operation: "loading the weights".to_owned(), source: std::io::Error::other(e) })??;
    let worker = Arc::new(worker::Worker::start(engine, &config)?);
    let _watch = weights_file::watch(&worker, &config, version);
    session.serve(Service::Inference, Arc::new(endpoints::Endpoints::new(worker)), shutdown).await?;
    Ok(())
}
