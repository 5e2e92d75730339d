//! Recordings of a cell: made while it runs, looked at in other people's viewers, played, and asked again.
//!
//! A recording is one or more MCAP files. They hold every message as it was on the wire, on a topic that is its key, to play and to replay; and
//! beside them Foxglove's messages, to look at. [`record`] makes one of a running cell, [`play`] gives the cell back in time, [`replay`] asks the recorded
//! requests again and compares the answers.
//!
//! [`file`](mod@file) is the container, [`look`] what is drawn, [`calls`] the calls in a recording, [`difference`] two answers side by side; none of them knows the
//! network.

mod asked_for;
pub mod calls;
mod copies;
pub mod difference;
pub mod file;
mod heard;
pub mod look;
mod lost;
mod outages;
pub mod play;
pub mod record;
pub mod replay;
pub mod settings;
mod writer;

use std::path::PathBuf;

use repose_proto::CallError;
use repose_runtime::RuntimeError;

pub use settings::RecordSettings;
pub use writer::Summary;

/// Why a recording could not be made or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// A file could not be written or read.
    #[error("{}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// A file is no recording, or not one of ours.
    #[error("{}: {reason}", path.display())]
    Content {
        /// Which.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A setting that cannot be used.
    #[error("{field}: {message}")]
    Setting {
        /// Which.
        field: &'static str,
        /// What was expected, and what came.
        message: String,
    },
    /// What the cell answered.
    #[error(transparent)]
    Call(#[from] CallError),
    /// The network refused.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
}
