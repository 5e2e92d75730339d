//! Why training stopped.

use std::path::PathBuf;

/// Errors of a training run.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A shard could not be read.
    #[error(transparent)]
    Data(#[from] repose_dataset::ReadError),
    /// There is no training data.
    #[error("{folder}: no view of a {split} scene in which an object can be seen beside another")]
    Empty {
        /// The data folder.
        folder: PathBuf,
        /// The split that is empty.
        split: &'static str,
    },
    /// There are views, but no outcomes of releases in them.
    #[error(
        "{folder}: no outcomes of releases in {split} scenes; `repose generate --releases` writes them, also beside shards that are there"
    )]
    NoOutcomes {
        /// The data folder.
        folder: PathBuf,
        /// The split that has none.
        split: &'static str,
    },
    /// A setting that no run can have.
    #[error("{field}: {message}")]
    Setting {
        /// The setting.
        field: &'static str,
        /// What was expected and what came.
        message: String,
    },
    /// The run needs weights to start from.
    #[error("start: expected weights to start from: {0}")]
    NoStart(&'static str),
    /// A file to start from cannot be read.
    #[error("{path}: {source}")]
    StartFile {
        /// The setting that names it.
        field: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file to start from holds no weights.
    #[error("{path}: {source}")]
    StartWeights {
        /// The setting that names it.
        field: &'static str,
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: repose_networks::WeightsError,
    },
    /// The checkpoint beside the weights file belongs to a run that began differently.
    #[error("{checkpoint} belongs to a run with {theirs}, but this run has {ours}: remove it, or write to another file")]
    OtherRun {
        /// The setting that differs.
        field: &'static str,
        /// The checkpoint.
        checkpoint: PathBuf,
        /// What the setting was.
        theirs: String,
        /// What it is now.
        ours: String,
    },
    /// The checkpoint cannot be read.
    #[error("{path}: {source}")]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: repose_networks::WeightsError,
    },
    /// Weights do not fit each other, or could not be put into a file.
    #[error(transparent)]
    Weights(#[from] repose_networks::WeightsError),
    /// Weights whose mean is taken must have the same tensors in the same shapes.
    #[error("{path}: {parameter} is missing or has another shape")]
    Mean {
        /// The weights that do not fit.
        path: PathBuf,
        /// The tensor that does not fit.
        parameter: String,
    },
    /// There is no CUDA device, or the program was built without the `cuda` feature.
    #[error(transparent)]
    Cuda(candle_core::Error),
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
    /// What was trained is no longer a number, though the loss still was one; the last checkpoint is kept.
    #[error("step {step}: {parameter} is not finite")]
    NotFinite {
        /// Steps done.
        step: u64,
        /// The first parameter or running statistic of which this is true.
        parameter: String,
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

impl TrainError {
    /// The setting at fault; `None` where no setting is.
    pub fn field(&self) -> Option<&'static str> {
        match self {
            Self::Data(_) | Self::Empty { .. } | Self::NoOutcomes { .. } => Some("data"),
            Self::NoStart(_) => Some("start"),
            Self::Setting { field, .. } => Some(field),
            Self::StartFile { field, .. } | Self::StartWeights { field, .. } | Self::OtherRun { field, .. } => Some(field),
            Self::Mean { .. } => Some("mean_with"),
            Self::Cuda(_) => Some("device"),
            Self::Checkpoint { .. }
            | Self::Weights(_)
            | Self::Tensors(_)
            | Self::Diverged { .. }
            | Self::NotFinite { .. }
            | Self::Io { .. } => None,
        }
    }
}
