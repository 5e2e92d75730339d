//! Why training stopped.

use std::path::PathBuf;

/// Errors of a training run.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A shard could not be read.
    #[error(transparent)]
    Data(#[from] repose_dataset::ReadError),
    /// There is nothing to train on.
    #[error("{folder}: no view of a {split} scene in which an object can be seen beside another")]
    Empty {
        /// The data folder.
        folder: PathBuf,
        /// The split that is empty.
        split: &'static str,
    },
    /// The encoders that the relation predictor reads are not there.
    #[error("start: the relation predictor is trained on encoders that are there already, and {}", match .0 {
        Some(path) => format!("{} is not", path.display()),
        None => "no weights were given".to_owned(),
    })]
    NoStart(Option<PathBuf>),
    /// Start weights could not be used.
    #[error(transparent)]
    Weights(#[from] repose_networks::WeightsError),
    /// A mean of weights needs the same values in the same shapes.
    #[error("{path}: {parameter} is missing or has another shape")]
    Mean {
        /// The weights that do not fit.
        path: PathBuf,
        /// What does not.
        parameter: String,
    },
    /// There is no CUDA device, or the program was built without the `cuda` feature.
    #[error("device: {0}")]
    Cuda(#[source] candle_core::Error),
    /// A tensor operation failed.
    #[error("tensors: {0}")]
    Tensors(#[from] candle_core::Error),
    /// The loss is no longer a number; the last checkpoint is kept.
    #[error("step {step}: the loss is {loss}")]
    Diverged {
        /// The step.
        step: u64,
        /// What the loss was.
        loss: f64,
    },
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}
