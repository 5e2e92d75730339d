//! What the tests of several commands share.

use clap::{Args, Parser};

/// A command line of one command's arguments.
#[derive(Parser)]
pub struct Line<A: Args> {
    /// The arguments.
    #[command(flatten)]
    pub args: A,
}
