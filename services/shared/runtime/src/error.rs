//! What can go wrong outside a call: configuration and the network. Inside a call everything is a `CallError` of `proto`.

use std::path::PathBuf;

/// A failure of the runtime.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// A configuration file or an environment variable that cannot be used.
    #[error("configuration section [{section}]{}: {message}", file.as_ref().map(|f| format!(" of {}", f.display())).unwrap_or_default())]
    Config {
        /// The section at fault.
        section: String,
        /// The file, where there is one.
        file: Option<PathBuf>,
        /// What was expected and what came; names the field.
        message: String,
    },
    /// The network refused an operation.
    #[error("{operation}: {message}")]
    Transport {
        /// What was tried.
        operation: String,
        /// What the network said.
        message: String,
    },
    /// The operating system refused something.
    #[error("{operation}: {source}")]
    System {
        /// What was tried.
        operation: String,
        /// What it said.
        source: std::io::Error,
    },
}

impl RuntimeError {
    pub(crate) fn transport(operation: impl Into<String>, message: impl std::fmt::Display) -> Self {
        Self::Transport { operation: operation.into(), message: message.to_string() }
    }
}

impl From<RuntimeError> for repose_proto::CallError {
    fn from(error: RuntimeError) -> Self {
        Self::new(repose_proto::ErrorCode::Unavailable, error.to_string())
    }
}
