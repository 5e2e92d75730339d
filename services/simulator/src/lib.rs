//! The stand-in world: objects, physics, a depth camera, and a simulated Panda.
//!
//! ```
//! use repose_simulator::cell::{CellSettings, cell_of_seed};
//!
//! let scene = cell_of_seed(1, &CellSettings::default()).unwrap();
//! assert!((3..=6).contains(&scene.objects.len()));
//! ```
//!
//! [`scene`] makes settled scenes from seeds, [`render`] shows them, [`repose_sensor`] adds the faults of a depth camera, [`generate`] writes
//! training data, [`statistics`] and [`sheet`] describe it, [`release`] simulates dropping an object, and [`trials`] records the outcomes for
//! training. [`cell_world`] is the running cell with its robot; [`run`] serves it.

pub mod arrange;
pub mod cell;
pub mod cell_world;
pub mod config;
pub mod contact;
pub mod convert;
pub mod endpoints;
pub mod furniture;
pub mod generate;
pub mod objects;
pub mod physics;
pub mod release;
pub mod render;
pub mod robot;
pub mod scene;
pub mod sheet;
pub mod statistics;
pub mod trials;
pub mod viewpoint;
pub mod views;
pub mod worker;

use std::sync::Arc;

use repose_proto::Service;
use repose_runtime::{RuntimeError, Session, Shutdown};

pub use config::SimulatorConfig;
pub use worker::Worker;

/// Why the simulator could not run.
#[derive(Debug, thiserror::Error)]
pub enum SimulatorError {
    /// A field is out of range.
    #[error("[simulator] {field}: {message}")]
    Config {
        /// Which.
        field: &'static str,
        /// What was expected, and what came.
        message: String,
    },
    /// The first seed gave no scene.
    #[error(transparent)]
    NoScene(#[from] scene::NoScene),
    /// The thread of the world could not be started.
    #[error("starting the world's thread: {0}")]
    Thread(#[from] std::io::Error),
    /// The network refused.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The world's thread has panicked.
    #[error("the world has ended: its thread panicked, and has said why on standard error")]
    Ended,
}

/// Runs the cell until `shutdown`: frames and robot states out, commands and stops in, `reset` and `truth` answered.
///
/// # Errors
/// [`SimulatorError`] when the configuration is out of range, the seed gives no scene, the network refuses, or the world has ended: who started
/// this may start it again, while a cell without a world would look alive and never move.
pub async fn run(session: Session, config: SimulatorConfig, shutdown: Shutdown) -> Result<(), SimulatorError> {
    let worker = Arc::new(Worker::start(&config)?);
    // Aborted when this function returns, whatever the reason.
    let mut tasks = tokio::task::JoinSet::new();
    endpoints::connect(&session, &config, &worker, &mut tasks).await?;
    let handler = Arc::new(endpoints::Endpoints::new(worker.clone()));
    tokio::select! {
        biased;
        served = session.serve(Service::Simulator, handler, shutdown) => Ok(served?),
        () = worker.ended() => Err(SimulatorError::Ended),
    }
}
