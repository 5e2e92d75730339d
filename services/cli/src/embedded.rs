//! The networks in this process: what `plan`, `relations`, `score` and `evaluate` use instead of inference over the network.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use repose_inference::{Engine, InferenceConfig, engine_of};
use repose_local::{LocalModels, ModelFiles};

use crate::failure::Failure;

/// Which networks a command uses that computes in this process.
#[derive(Debug, Clone, Default, Args)]
pub struct NetworkArgs {
    /// A weights file. Default: the file that REPOSE_INFERENCE__WEIGHTS names, or the program's own weights.
    #[arg(long, value_name = "FILE")]
    pub weights: Option<PathBuf>,
}

impl NetworkArgs {
    /// The models of the files named here, or else in the environment, or else those of the program.
    pub fn models(&self) -> Result<Arc<LocalModels>, Failure> {
        Ok(Arc::new(LocalModels::load(&ModelFiles { weights: self.weights.clone() })?))
    }
}

/// The networks of a file, or those that come with the program, one thread a request.
pub fn engine(weights: Option<PathBuf>) -> Result<Engine, Failure> {
    let config = InferenceConfig { weights, threads: 1, ..InferenceConfig::default() };
    engine_of(&config).map_err(|e| Failure::bad_input("weights", e))
}
