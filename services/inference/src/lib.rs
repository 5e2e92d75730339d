//! Inference: scenes held by id, and batched scoring of candidates with the learned prior, relation predictor, discriminator and outcome
//! network.
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use repose_inference::{HeldScene, InferenceConfig, engine_of};
//! use repose_proto::scoring::{RealismBy, ScoreRequest};
//!
//! # fn f(scene: repose_proto::Scene) -> Result<(), Box<dyn std::error::Error>> {
//! let engine = engine_of(&InferenceConfig::default())?; // the weights that come with the program
//! let held = HeldScene::new(scene.id(), Arc::new(scene));
//! let request = ScoreRequest {
//!     scene: repose_proto::SceneRef { scene_id: held.scene_id().to_owned() },
//!     query: 2,
//!     anchors: vec![3],
//!     view_yaw_rad: 0.0,
//!     realism: true,
//!     realism_by: RealismBy::Outcome,
//!     relations: true,
//!     candidates: vec![[0.1, 0.2, 0.05, 0.0]], // where the query's centroid goes in the world, metres, and its turn, radians
//! };
//! let reply = engine.score(&request, &held)?;
//! println!("stays with probability {}, relations to object 3: {:?}", reply.realism[0], reply.relations[0]);
//! # Ok(()) }
//! ```
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
mod wire_error;
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
    /// The networks failed on a trial scene.
    #[error("trying the weights: {0}")]
    Trial(#[from] engine::ServingError),
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
    for forecast in engine.misfit_forecasts() {
        tracing::warn!(
            weights_hash = engine.weights_hash(),
            forecast,
            "fitted with another outcome network: the variant `best` is less sure; `repose train --network stability` and `success` fit anew"
        );
    }
    Ok(engine)
}

/// The same off the threads that serve the network.
async fn loaded(config: InferenceConfig) -> Result<Engine, InferenceError> {
    let engine = tokio::task::spawn_blocking(move || engine_of(&config)).await;
    engine.map_err(|e| RuntimeError::System { operation: "loading the weights".to_owned(), source: std::io::Error::other(e) })?
}

/// Serves until `shutdown`.
///
/// # Errors
/// [`InferenceError`].
pub async fn run(session: Session, config: InferenceConfig, shutdown: Shutdown) -> Result<(), InferenceError> {
    config.validate()?;
    // Looked at before it is read: what replaces it meanwhile is then seen as new.
    let version = weights_file::Version::of(&config);
    let engine = loaded(config.clone()).await?;
    let worker = Arc::new(worker::Worker::start(engine, &config, session.cell_shares())?);
    let _watch = weights_file::watch(&worker, &config, version);
    session.serve(Service::Inference, Arc::new(endpoints::Endpoints::new(worker)), shutdown).await?;
    Ok(())
}
