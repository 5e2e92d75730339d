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
    /// Another process serves under the same name.
    #[error(
        "a {service} worker named {worker:?} is alive already: names are unique in a cell (leave [worker] name out, and one is made up)"
    )]
    NameTaken {
        /// The service.
        service: repose_proto::Service,
        /// The name.
        worker: String,
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
        Self::Transport { operation: operation.into(), message: without_source_lines(&message.to_string()) }
    }
}

/// Zenoh says with every error which line of its own source says it (` at /…/orchestrator.rs:123.`): nothing that a user can act on.
pub(crate) fn without_source_lines(message: &str) -> String {
    let mut words: Vec<&str> = Vec::new();
    for word in message.split(' ') {
        if word.contains(".rs:") && words.last() == Some(&"at") {
            words.pop();
        } else {
            words.push(word);
        }
    }
    words.join(" ")
}

impl From<RuntimeError> for repose_proto::CallError {
    fn from(error: RuntimeError) -> Self {
        Self::new(repose_proto::ErrorCode::Unavailable, error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zenohs_source_lines_are_left_out_and_nothing_else_is() {
        let zenoh = "Unable to connect to any of [tcp/127.0.0.1:1] at /a/zenoh-1.10.2/src/net/orchestrator.rs:351. - Caused by refused at /b/c.rs:7.";
        let plain = "Unable to connect to any of [tcp/127.0.0.1:1] - Caused by refused";
        assert_eq!(RuntimeError::transport("opening", zenoh).to_string(), format!("opening: {plain}"));
        assert_eq!(without_source_lines("looked at  /etc/router.json5 in vain"), "looked at  /etc/router.json5 in vain");
    }
}
