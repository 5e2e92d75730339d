//! What a command prints: one JSON document on standard output with `--json`, text for people without.

use std::io::{ErrorKind, Write};

use repose_proto::CallError;
use serde::Serialize;

use crate::failure::{CommandResult, Failure, sentence};

/// Where a command's result goes.
#[derive(Debug, Clone, Copy)]
pub struct Output {
    /// One JSON document instead of text.
    pub json: bool,
}

impl Output {
    /// Prints `document` as JSON, or `text` for people. What is under way goes on where the reader has gone (`| head`).
    pub fn print<T: Serialize>(self, document: &T, text: impl FnOnce() -> String) -> CommandResult {
        self.print_more(document, text).map(|_is_read| ())
    }

    /// The same, of several; returns whether anybody still reads.
    pub fn print_more<T: Serialize>(self, document: &T, text: impl FnOnce() -> String) -> Result<bool, Failure> {
        if self.json { line(&serde_json::to_string_pretty(document).map_err(Failure::other)?) } else { line(&text()) }
    }

    /// Tells of an error: in words on standard error, and with `--json` in the document. Where nobody reads either, the exit code still tells.
    pub fn print_error(self, error: &CallError) {
        let _unread = writeln!(std::io::stderr(), "error: {}", sentence(error));
        self.print_error_document(error);
    }

    /// The same where the words are said already.
    pub fn print_error_document(self, error: &CallError) {
        if self.json {
            let _unread = line(&serde_json::json!({"error": error}).to_string());
        }
    }
}

/// Prints a line; returns whether somebody reads.
fn line(text: &str) -> Result<bool, Failure> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        Err(error) => Err(Failure::other(format!("standard output: {error}"))),
    }
}
