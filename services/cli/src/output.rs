//! What a command prints: one JSON document on standard output with `--json`, text for people without.

use std::io::{ErrorKind, Write};

use serde::Serialize;

use crate::failure::{CommandResult, Failure};

/// Where a command's result goes.
#[derive(Debug, Clone, Copy)]
pub struct Output {
    /// One JSON document instead of text.
    pub json: bool,
}

impl Output {
    /// Prints `document` as JSON, or `text` for people.
    pub fn print<T: Serialize>(self, document: &T, text: impl FnOnce() -> String) -> CommandResult {
        if self.json { line(&serde_json::to_string_pretty(document).map_err(Failure::other)?) } else { line(&text()) }
    }
}

/// Prints a line. A reader that has gone (`| head`) has read what it wanted.
fn line(text: &str) -> CommandResult {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Failure::other(format!("standard output: {error}"))),
        _ => Ok(()),
    }
}
